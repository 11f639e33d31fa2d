"""The robot's body in an environment: start poses, movement among walls, falls."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import rotations, tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import kinematics, posture, walls
from eihrl_jax.robots import robot as robot_lib

MAX_VELOCITY = 1e4
"""Metres or radians per second beyond which a simulation has broken down."""

_NUM_STARTS = 16
"""Postures from which one without a part in a wall is chosen."""

_START_SHIFT = 0.5
"""How far from the middle of its cell a robot is moved to be clear of walls, units."""

_MARGIN = 0.1
"""Units by which noise on joints may make a start posture longer."""


def draw_start(
    engine: engine_lib.Engine,
    maze: maze_lib.Maze,
    xy: Float[Array, "2"],
    key: Key[Array, ""],
    jitter: float,
) -> engine_lib.PhysicsState:
    """Draws a start pose as `draw_pose` does, with no part of the robot in a wall.

    Where there is too little room for the first pose that is drawn, others are tried, turned and
    moved inside the cell; where there is too little for all, the least deep is taken.

    Args:
      engine: the robot's.
      maze: the maze, its door drawn.
      xy: where it is to stand, units.
      key: consumed.
      jitter: how far `xy` may be from the middle of its cell along an axis, units.
    """
    robot, model = engine.robot, engine.model
    extent = posture.farthest(model, model.key_qpos[0]) * robot.units_per_metre + _MARGIN
    if extent + jitter < base.CELL / 2:
        return draw_pose(engine, xy, key)

    keys = jnp.stack([key, *(jax.random.fold_in(key, i) for i in range(1, _NUM_STARTS))])
    shift = jax.random.uniform(key, (_NUM_STARTS, 2), minval=-_START_SHIFT, maxval=_START_SHIFT)
    centre_xy = maze_lib.cell_xy(maze_lib.cell_ij(xy))
    places = (centre_xy[None] + shift).at[0].set(xy)
    poses = jax.vmap(draw_pose, in_axes=(None, 0, 0))(engine, places, keys)

    # The first one of those that are least deep in a wall, which most often is the very first.
    to_capsules = kinematics.capsules(model, robot.units_per_metre)
    depth = jax.vmap(lambda qpos: walls.depth(maze, qpos[:2], to_capsules(qpos)))(poses.qpos)
    chosen = jnp.argmin(jnp.maximum(depth, 0.0))
    return jax.tree.map(lambda leaf: leaf[chosen], poses)


def draw_pose(
    engine: engine_lib.Engine, xy: Float[Array, "2"], key: Key[Array, ""]
) -> engine_lib.PhysicsState:
    """Draws a start pose at `xy`: the start posture with random heading and noise on the joints."""
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
    is_nonsense = ~jnp.isfinite(numbers).all() | (jnp.abs(stepped.qvel) > MAX_VELOCITY).any()
    # Farther, it may have come through a wall that wasn't there yet.
    travel = jnp.abs(stepped.qpos[:2] - physics.qpos[:2]).max()
    is_broken = is_running & (is_nonsense | (travel > engine.robot.max_travel))
    return tree.where(is_broken, physics, stepped), is_broken


def is_fallen(qpos: Float[Array, " nq"], robot: robot_lib.Robot) -> Bool[Array, ""]:
    """Returns whether the torso has left its healthy heights or points downwards."""
    if robot.healthy_z is None:
        return jnp.zeros((), bool)
    low, high = robot.healthy_z
    return (qpos[2] < low) | (qpos[2] > high) | (rotations.up(qpos[3:7]) < 0.0)
