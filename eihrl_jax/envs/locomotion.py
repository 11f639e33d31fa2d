"""The low level's task: walk one cell in the direction of the subgoal, which changes every k steps.

Paper, Sec. 2 (eq. 1) and Sec. 3.2. An observation keeps its parts apart, because a stored step can
be looked at again as if another direction had been asked for (`relabel`); `low_obs` makes the
network's input of it.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import low_obs
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import rotations, tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import walls
from eihrl_jax.robots import robot as robot_lib

METRICS = ("step_x", "step_y", "switched", "along", "lateral", "fell", "broke_down")
"""What `Locomotion` tells about each step, see there."""


class LocomotionState(struct.PyTreeNode):
    """Inner state of `Locomotion`: physics, room, subgoal and time.

    Attributes:
      physics: the robot's state.
      room: int32, index of the room it is in.
      subgoal_xy: float32 [2], where the torso was when the subgoal was given, units.
      direction: int32, the subgoal.
      step: int32, control steps since the episode's start.
    """

    physics: engine_lib.PhysicsState
    room: Int[Array, ""]
    subgoal_xy: Float[Array, "2"]
    direction: Int[Array, ""]
    step: Int[Array, ""]


class Experience(struct.PyTreeNode):
    """One stored control step, from which the reward of any direction can be computed.

    Attributes:
      obs: before the step.
      ctrl: float32 [nu], controls in [-1, 1].
      step_xy: float32 [2], the torso's movement, units.
      terminated: the robot fell, or the simulation broke down.
      is_switch: a new subgoal was given after the step; `next_obs` is already of that one.
      next_obs: after the step.
    """

    obs: low_obs.LowObs
    ctrl: Float[Array, " nu"]
    step_xy: Float[Array, "2"]
    terminated: Bool[Array, ""]
    is_switch: Bool[Array, ""]
    next_obs: low_obs.LowObs


def is_fallen(qpos: Float[Array, " nq"], robot: robot_lib.Robot) -> Bool[Array, ""]:
    """Tells whether the torso has left its healthy heights or points downwards."""
    if robot.healthy_z is None:
        return jnp.zeros((), bool)
    low, high = robot.healthy_z
    up_z = 1.0 - 2.0 * (jnp.square(qpos[4]) + jnp.square(qpos[5]))
    return (qpos[2] < low) | (qpos[2] > high) | (up_z < 0.0)


def reward(
    displacement_xy: Float[Array, "2"],
    step_xy: Float[Array, "2"],
    time_left: Float[Array, ""],
    direction: Int[Array, ""],
    terminated: Bool[Array, ""],
    options: low_config.LowReward,
    steps_per_subgoal: int,
) -> Float[Array, ""]:
    """Computes the intrinsic reward of one control step.

    With default options it is eq. 1, alpha * cos<g, d> * |d| = alpha * (g . d) for a step d, in the
    form that has no singularity at d = 0.

    Args:
      displacement_xy: float32 [2], movement since the subgoal was given, before the step, units.
      step_xy: float32 [2], the step's movement, units.
      time_left: float32, fraction of the subgoal's steps that was left before the step.
      direction: int32, the subgoal that was to be followed.
      terminated: the step ended in a fall or a breakdown.
      options: scale, prices of drift and falls, and whether a full cell is enough.
      steps_per_subgoal: control steps per subgoal.

    Source: paper, eq. 1.
    Differs from the paper: drift, stop and falls are options, off in preset `paper`.
    """

    def potential(xy: Float[Array, "2"], left: Float[Array, ""]) -> Float[Array, ""]:
        along, lateral = rotations.to_direction_frame(xy, direction)
        enough = base.CELL * (1.0 - left) if options.is_paced else base.CELL
        beyond = jnp.maximum(along - enough, 0.0)
        along += (options.beyond_cell - 1.0) * beyond
        return along - options.lateral_weight * jnp.abs(lateral)

    after = potential(displacement_xy + step_xy, time_left - 1.0 / steps_per_subgoal)
    gain = after - potential(displacement_xy, time_left)
    return options.scale * gain - options.fall_cost * terminated.astype(jnp.float32)


def experience(
    before: base.EnvState, ctrl: Float[Array, " nu"], after: base.EnvState
) -> Experience:
    """Returns what is to be stored of a step, given the environment before and after it.

    `after` may already be reset: its final observation and its metrics are still of the step.
    """
    return Experience(
        obs=before.obs,
        ctrl=ctrl,
        step_xy=jnp.stack([after.metrics["step_x"], after.metrics["step_y"]]),
        terminated=after.terminated,
        is_switch=after.metrics["switched"] > 0,
        next_obs=after.final_obs,
    )


def relabel(experience: Experience, direction: Int[Array, ""]) -> Experience:
    """Returns a stored step as if `direction` had been asked for; physics doesn't depend on it."""
    next_direction = jnp.where(
        experience.is_switch, experience.next_obs.direction, direction
    ).astype(jnp.int32)
    return experience.replace(
        obs=experience.obs.replace(direction=direction),
        next_obs=experience.next_obs.replace(direction=next_direction),
    )


def restart(
    experience: Experience, direction: Int[Array, ""], robot: robot_lib.Robot
) -> Experience:
    """Returns a stored step as if `direction` had been asked for just before it.

    Unlike those of `relabel`, such steps are what the robot meets: nobody has come far sideways.
    """
    k, zero = robot.steps_per_subgoal, jnp.zeros(2)
    obs, next_obs = experience.obs, experience.next_obs
    return experience.replace(
        is_switch=jnp.zeros((), bool),
        obs=obs.replace(direction=direction, displacement_xy=zero, time_left=jnp.float32(1.0)),
        next_obs=next_obs.replace(
            direction=direction,
            displacement_xy=experience.step_xy,
            time_left=jnp.float32((k - 1) / k),
        ),
    )


def transition(
    experience: Experience,
    robot: robot_lib.Robot,
    input_options: low_config.LowInput,
    reward_options: low_config.LowReward,
    gamma: float,
) -> base.Transition:
    """Returns a stored step as the learner sees it: features, action, reward, discount."""
    obs = experience.obs
    return base.Transition(
        obs=low_obs.features(obs, robot, input_options),
        action=low_obs.action_from_ctrl(experience.ctrl, obs, robot, input_options),
        reward=reward(
            obs.displacement_xy,
            experience.step_xy,
            obs.time_left,
            obs.direction,
            experience.terminated,
            reward_options,
            robot.steps_per_subgoal,
        ),
        discount=gamma * (1.0 - experience.terminated.astype(jnp.float32)),
        next_obs=low_obs.features(experience.next_obs, robot, input_options),
    )


class Locomotion:
    """A robot in rooms, following directions that change at random every k control steps.

    Observation: `low_obs.LowObs`. Action: controls [nu] in [-1, 1]. Reward: see `reward`.
    Terminates when the robot falls, if that ends episodes, or the simulation breaks down; truncated
    after `episode_steps` control steps. Reset: a random room and start, random yaw, noise on joints
    and velocities.

    Metrics, per step: `step_x` and `step_y`, the torso's movement in units; `switched` 1 where a
    subgoal has just ended, then `along` and `lateral` hold its displacement in units; `fell` 1
    where the robot has just fallen, `broke_down` 1 where the simulation did.
    """

    def __init__(
        self,
        engine: engine_lib.Engine,
        rooms: maze_lib.Maze,
        *,
        reward_options: low_config.LowReward,
        episode_steps: int = 500,
        ends_at_fall: bool = True,
    ):
        """Builds the environment.

        Args:
          engine: steps the robot.
          rooms: mazes with a leading axis M; one is drawn at each reset.
          reward_options: the intrinsic reward.
          episode_steps: control steps per episode.
          ends_at_fall: whether a fall terminates; else the robot may get up again.
        """
        self.robot = engine.robot
        self._engine = engine
        self._rooms = rooms
        self._reward_options = reward_options
        self._episode_steps = episode_steps
        self._ends_at_fall = ends_at_fall

    def reset(self, key: Key[Array, ""]) -> base.EnvState:
        """Draws a room, a start, a posture and a first subgoal."""
        key, room_key, start_key, pose_key, direction_key = jax.random.split(key, 5)
        room = jax.random.randint(room_key, (), 0, self._rooms.wall.shape[0])
        start_xy = maze_lib.draw_start(self.room(room), start_key)
        inner = LocomotionState(
            physics=draw_pose(self._engine, start_xy, pose_key),
            room=room,
            subgoal_xy=start_xy,
            direction=jax.random.randint(direction_key, (), 0, base.NUM_DIRECTIONS),
            step=jnp.int32(0),
        )
        obs = self._observe(inner)
        zero, no = jnp.float32(0.0), jnp.zeros((), bool)
        metrics: dict[str, Array] = {name: zero for name in METRICS}
        return base.EnvState(
            inner=inner,
            obs=obs,
            final_obs=obs,
            reward=zero,
            terminated=no,
            truncated=no,
            metrics=metrics,
            key=key,
        )

    def step(self, state: base.EnvState, action: Float[Array, " nu"]) -> base.EnvState:
        """Advances one control step; gives a new subgoal where the old one's time is up."""
        inner: LocomotionState = state.inner
        key, direction_key = jax.random.split(state.key)
        before_xy = inner.physics.qpos[:2]
        room, always = self.room(inner.room), jnp.ones((), bool)
        physics, is_broken = move(self._engine, inner.physics, action, room, always)

        displacement_xy = physics.qpos[:2] - inner.subgoal_xy
        along, lateral = rotations.to_direction_frame(displacement_xy, inner.direction)
        step = inner.step + 1
        is_switch = step % self.robot.steps_per_subgoal == 0
        drawn = jax.random.randint(direction_key, (), 0, base.NUM_DIRECTIONS)
        is_down = is_fallen(physics.qpos, self.robot)
        fell = is_down & (self._ends_at_fall | ~is_fallen(inner.physics.qpos, self.robot))
        terminated = (is_down & self._ends_at_fall) | is_broken
        new_inner = inner.replace(
            physics=physics,
            subgoal_xy=jnp.where(is_switch, physics.qpos[:2], inner.subgoal_xy),
            direction=jnp.where(is_switch, drawn, inner.direction),
            step=step,
        )
        obs = self._observe(new_inner)
        step_xy = physics.qpos[:2] - before_xy
        gain = reward(
            before_xy - inner.subgoal_xy,
            step_xy,
            state.obs.time_left,
            inner.direction,
            terminated,
            self._reward_options,
            self.robot.steps_per_subgoal,
        )
        switched = (is_switch & ~terminated).astype(jnp.float32)
        return base.EnvState(
            inner=new_inner,
            obs=obs,
            final_obs=obs,
            reward=gain,
            terminated=terminated,
            truncated=(step >= self._episode_steps) & ~terminated,
            metrics={
                "step_x": step_xy[0],
                "step_y": step_xy[1],
                "switched": switched,
                "along": switched * along,
                "lateral": switched * lateral,
                "fell": fell.astype(jnp.float32),
                "broke_down": is_broken.astype(jnp.float32),
            },
            key=key,
        )

    def room(self, index: Int[Array, ""]) -> maze_lib.Maze:
        """Returns one of the rooms."""
        return jax.tree.map(lambda leaf: leaf[index], self._rooms)

    def _observe(self, inner: LocomotionState) -> low_obs.LowObs:
        steps_left = self.robot.steps_per_subgoal - inner.step % self.robot.steps_per_subgoal
        return low_obs.observe(
            inner.physics, inner.subgoal_xy, steps_left, inner.direction, self.robot
        )


def draw_pose(
    engine: engine_lib.Engine, xy: Float[Array, "2"], key: Key[Array, ""]
) -> engine_lib.PhysicsState:
    """Returns the standing robot at `xy`, turned at random, its joints a little off."""
    robot, model = engine.robot, engine.model
    stand = jnp.asarray(model.key_qpos[0], jnp.float32)
    yaw_key, qpos_key, qvel_key = jax.random.split(key, 3)
    yaw = jax.random.uniform(yaw_key, (), minval=-jnp.pi, maxval=jnp.pi)
    noise = jax.random.uniform(qpos_key, stand.shape, minval=-1.0, maxval=1.0)
    qpos = (stand + robot.qpos_noise * noise).at[:2].set(xy)
    if robot.root == "free":
        zero = jnp.zeros_like(yaw)
        upright = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
        qpos = qpos.at[2].set(stand[2]).at[3:7].set(upright)
    elif robot.root == "planar":
        qpos = qpos.at[2].set(yaw)
    qvel = robot.qvel_noise * jax.random.normal(qvel_key, (model.nv,))
    return engine_lib.reset(qpos, qvel)


def move(
    engine: engine_lib.Engine,
    physics: engine_lib.PhysicsState,
    ctrl: Float[Array, " nu"],
    maze: maze_lib.Maze,
    is_running: Bool[Array, ""],
) -> tuple[engine_lib.PhysicsState, Bool[Array, ""]]:
    """Advances a robot in a maze by one control step; one that isn't running rests.

    Returns:
      The robot's state, and whether its simulation broke down, which leaves the state as it was.
    """
    near = walls.nearby(maze, physics.qpos[:2], engine.robot.num_walls)
    return advance(engine, physics, ctrl, near, is_running)


def advance(
    engine: engine_lib.Engine,
    physics: engine_lib.PhysicsState,
    ctrl: Float[Array, " nu"],
    walls_xy: Float[Array, "W 2"],
    is_running: Bool[Array, ""],
) -> tuple[engine_lib.PhysicsState, Bool[Array, ""]]:
    """Does what `move` does, with walls wherever `walls_xy` puts them, units."""
    stepped = engine.step(physics, ctrl, walls_xy, is_running)
    numbers = jnp.concatenate([stepped.qpos, stepped.qvel, ctrl])
    is_broken = is_running & ~jnp.isfinite(numbers).all()
    kept = tree.where(is_broken, physics, stepped)
    return kept, is_broken
