"""What a robot's body does in an environment: it is put somewhere, moves among walls, may fall."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import walls
from eihrl_jax.robots import robot as robot_lib


def draw_pose(
    engine: engine_lib.Engine, xy: Float[Array, "2"], key: Key[Array, ""]
) -> engine_lib.PhysicsState:
    """Returns the standing robot at `xy`, turned at random, its joints a little off."""
    robot, model = engine.robot, engine.model
    yaw_key, qpos_key, qvel_key = jax.random.split(key, 3)

    stand = jnp.asarray(model.key_qpos[0], jnp.float32)
    noise = jax.random.uniform(qpos_key, stand.shape, minval=-1.0, maxval=1.0)
    qpos = (stand + robot.qpos_noise * noise).at[:2].set(xy)
    qvel = robot.qvel_noise * jax.random.normal(qvel_key, (model.nv,))

    # A root that can turn gets a heading instead of noise; a free one stands upright.
    yaw = jax.random.uniform(yaw_key, (), minval=-jnp.pi, maxval=jnp.pi)
    if robot.root == "free":
        zero = jnp.zeros_like(yaw)
        upright = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
        qpos = qpos.at[2].set(stand[2]).at[3:7].set(upright)
    elif robot.root == "planar":
        qpos = qpos.at[2].set(yaw)
    return engine_lib.reset(qpos, qvel)


def facing_east(physics: engine_lib.PhysicsState) -> engine_lib.PhysicsState:
    """Returns a robot on a free root turned upright towards x+, the rest of it as it was."""
    return physics.replace(qpos=physics.qpos.at[3:7].set(jnp.array([1.0, 0.0, 0.0, 0.0])))


def move(
    engine: engine_lib.Engine,
    physics: engine_lib.PhysicsState,
    ctrl: Float[Array, " nu"],
    maze: maze_lib.Maze,
    is_running: Bool[Array, ""] | bool = True,
) -> tuple[engine_lib.PhysicsState, Bool[Array, ""]]:
    """Advances a robot in a maze by one control step; one that isn't running rests.

    Returns:
      The robot's state, and whether its simulation broke down, which leaves the state as it was.
    """
    # Only the nearest walls are bodies of the engine, whatever the size of the maze.
    near = walls.nearby(maze, physics.qpos[:2], engine.robot.num_walls)
    return advance(engine, physics, ctrl, near, is_running)


def advance(
    engine: engine_lib.Engine,
    physics: engine_lib.PhysicsState,
    ctrl: Float[Array, " nu"],
    walls_xy: Float[Array, "W 2"],
    is_running: Bool[Array, ""] | bool = True,
) -> tuple[engine_lib.PhysicsState, Bool[Array, ""]]:
    """Advances a robot among walls at `walls_xy`, units; see `move`."""
    stepped = engine.step(physics, ctrl, walls_xy, is_running)
    # Controls too: an engine may clip infinite ones, and then nothing else would show.
    numbers = jnp.concatenate([stepped.qpos, stepped.qvel, ctrl])
    is_broken = is_running & ~jnp.isfinite(numbers).all()
    return tree.where(is_broken, physics, stepped), is_broken


def is_fallen(qpos: Float[Array, " nq"], robot: robot_lib.Robot) -> Bool[Array, ""]:
    """Returns whether the torso has left its healthy heights or points downwards."""
    if robot.healthy_z is None:
        return jnp.zeros((), bool)
    low, high = robot.healthy_z
    # The z component of the torso's own z axis, from its quaternion.
    up_z = 1.0 - 2.0 * (jnp.square(qpos[4]) + jnp.square(qpos[5]))
    return (qpos[2] < low) | (qpos[2] > high) | (up_z < 0.0)
