"""The low level's task: to follow a subgoal, a direction that changes every k control steps.

Paper, Sec. 2 (eq. 1) and Sec. 3.2. `low_reward` has the reward, `experience` what is stored of a
step, and `low_obs` the network's input.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.config import low as low_config
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import low_obs, low_reward, recovery, task
from eihrl_jax.envs import rooms as rooms_lib
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import rotations, tree
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import posture

METRICS: tuple[str, ...] = (
    *("step_x", "step_y", "switched", "along", "lateral"),
    *("upright", "fell", "broke_down"),
)
"""Names of the metrics of `Locomotion`, see there."""


class LocomotionState(struct.PyTreeNode):
    """Inner state of `Locomotion`: physics, room, subgoal and time.

    Attributes:
      physics: the robot's state.
      room: int32, index of the room it is in.
      subgoal_xy: float32 [2], origin of the subgoal, units: where the torso was when it was given,
        or its anchor.
      direction: int32, the subgoal.
      step: int32, control steps since the episode's start.
    """

    physics: engine_lib.PhysicsState
    room: Int[Array, ""]
    subgoal_xy: Float[Array, "2"]
    direction: Int[Array, ""]
    step: Int[Array, ""]


EnvState: TypeAlias = base.EnvState[LocomotionState, low_obs.LowObs]


class Locomotion:
    """A robot in rooms, following directions that change at random every k control steps.

    Observation: `low_obs.LowObs`. Action: controls [nu] in [-1, 1]. Reward: see `low_reward`.
    Terminates when the robot falls, if that ends episodes, or the simulation breaks down; truncated
    after `episode_steps` control steps. Reset: a random room and start, random yaw, noise on joints
    and velocities, or a throw. In corridors only directions without a wall ahead are drawn, and
    subgoals are anchored.

    Metrics, per step: `step_x` and `step_y`, the torso's movement in units; `switched` 1 where a
    subgoal has just ended, then `along` and `lateral` hold its displacement in units; `upright` as
    in `recovery.uprightness`; `fell` 1 where the robot has just fallen, `broke_down` 1 where the
    simulation did.
    """

    def __init__(
        self,
        engine: engine_lib.Engine,
        rooms: rooms_lib.Rooms,
        *,
        reward_options: low_config.LowReward,
        episode_steps: int = 500,
        ends_at_fall: bool = True,
        thrown_share: float = 0.0,
        anchored: bool = False,
    ):
        """Builds the environment.

        Args:
          engine: steps the robot.
          rooms: one is drawn at each reset.
          reward_options: the intrinsic reward.
          episode_steps: control steps per episode.
          ends_at_fall: whether a fall terminates; else the robot may get up again.
          thrown_share: share of the episodes that begin with a throw, see `recovery.thrown`.
          anchored: whether subgoals are measured from the middle of the robot's cell in all rooms,
            see `task.anchor`; in corridors they always are.

        Raises:
          base.UserError: `thrown_share` is above 0 for a robot that can't fall.
        """
        if thrown_share and engine.robot.root != "free":
            raise base.UserError(
                f"thrown_share = {thrown_share} is for robots with root 'free', "
                f"{engine.robot.name!r} has {engine.robot.root!r}"
            )
        self.robot = engine.robot
        self._engine = engine
        self._rooms = rooms
        self._reward_options = reward_options
        self._episode_steps = episode_steps
        self._ends_at_fall = ends_at_fall
        self._thrown_share = thrown_share
        self._anchored = anchored
        self._height = posture.standing_height(engine.model)
        # Known before anything is compiled: without corridors nothing is computed for them.
        self._has_corridors = bool(rooms.is_corridor.any())
        self._start_jitter = float(rooms.mazes.start_jitter.max())

    @classmethod
    def of_config(cls, engine: engine_lib.Engine, config: low_config.LowConfig) -> "Locomotion":
        """Returns the task of a training run.

        Args:
          engine: steps the robot.
          config: the run's options; without rooms it is on open floor.

        Raises:
          base.UserError: `thrown_share` is above 0 for a robot that can't fall.
        """
        floor = rooms_lib.open_floor(start_jitter=config.start_jitter)
        if config.num_rooms:
            floor = rooms_lib.random_rooms(
                config.num_rooms,
                config.seed,
                corridor_share=config.corridor_share,
                start_jitter=config.start_jitter,
            )
        return cls(
            engine,
            floor,
            reward_options=config.reward,
            episode_steps=config.episode_steps,
            ends_at_fall=config.ends_at_fall,
            thrown_share=config.thrown_share,
            anchored=config.anchored,
        )

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Draws a room, a start, a posture and a first subgoal."""
        key, room_key, start_key, pose_key, direction_key = jax.random.split(key, 5)

        room = jax.random.randint(room_key, (), 0, self._rooms.is_corridor.shape[0])
        start_xy = maze_lib.draw_start(self.room(room), start_key)
        physics = body_lib.draw_start(
            self._engine, self.room(room), start_xy, pose_key, self._start_jitter
        )
        if self._thrown_share > 0.0:
            share_key, throw_key = jax.random.split(jax.random.fold_in(pose_key, 1))
            is_thrown = jax.random.bernoulli(share_key, self._thrown_share)
            thrown = recovery.thrown(physics, self.robot, throw_key)
            physics = tree.where(is_thrown, thrown, physics)
        start_xy = physics.qpos[:2]
        # The first subgoal begins here, with all of its steps left.
        inner = LocomotionState(
            physics=physics,
            room=room,
            subgoal_xy=self._origin(room, start_xy),
            direction=self._draw_direction(room, start_xy, direction_key),
            step=jnp.int32(0),
        )
        return base.EnvState.of(
            inner=inner,
            obs=self._observe(inner),
            outcome=base.Outcome.of_reset(),
            metrics={name: jnp.float32(0.0) for name in METRICS},
            key=key,
        )

    def step(self, state: EnvState, action: Float[Array, " nu"]) -> EnvState:
        """Advances one control step; gives a new subgoal where the old one's time is up."""
        inner = state.inner
        before, k = inner.physics, self.robot.steps_per_subgoal
        key, direction_key = jax.random.split(state.key)

        # Always running: `wrappers.AutoReset` begins a new episode at once.
        after, is_broken = body_lib.move(self._engine, before, action, self.room(inner.room))

        was_down, is_down = (body_lib.is_fallen(x.qpos, self.robot) for x in (before, after))
        terminated = (is_down & self._ends_at_fall) | is_broken
        step_xy = after.qpos[:2] - before.qpos[:2]
        upright = recovery.uprightness(after.qpos, self.robot, self._height)
        step = inner.step + 1

        # A subgoal that ends together with its episode for good isn't completed.
        is_switch = step % k == 0
        has_completed = (is_switch & ~terminated).astype(jnp.float32)
        along, lateral = rotations.to_direction_frame(
            after.qpos[:2] - inner.subgoal_xy, inner.direction
        )
        metrics = {
            "step_x": step_xy[0],
            "step_y": step_xy[1],
            "switched": has_completed,
            "along": has_completed * along,
            "lateral": has_completed * lateral,
            "upright": upright,
            # 1 only in the step of the fall, though a robot may lie there for longer.
            "fell": is_down & (self._ends_at_fall | ~was_down),
            "broke_down": is_broken,
        }

        # Drawn in every step and mostly dropped: the random stream doesn't depend on the subgoals.
        drawn = self._draw_direction(inner.room, after.qpos[:2], direction_key)
        origin_xy = self._origin(inner.room, after.qpos[:2])
        inner = inner.replace(
            physics=after,
            subgoal_xy=jnp.where(is_switch, origin_xy, inner.subgoal_xy),
            direction=jnp.where(is_switch, drawn, inner.direction),
            step=step,
        )
        obs = self._observe(inner)

        ended = low_reward.StepOutcome(terminated=terminated, is_switch=is_switch, upright=upright)
        reward = low_reward.reward(state.obs, obs, step_xy, ended, self._reward_options, k)
        outcome = base.Outcome.of_step(reward, terminated, step >= self._episode_steps)
        return base.EnvState.of(inner=inner, obs=obs, outcome=outcome, metrics=metrics, key=key)

    def room(self, index: Int[Array, ""]) -> maze_lib.Maze:
        """Returns one of the rooms."""
        return self._rooms.one(index)

    def is_corridor(self, index: Int[Array, ""]) -> Bool[Array, ""]:
        """Returns whether a room consists of corridors."""
        return self._rooms.is_corridor[index]

    def _origin(self, room: Int[Array, ""], xy: Float[Array, "2"]) -> Float[Array, "2"]:
        """Returns the origin of a subgoal that is given at `xy`, units."""
        if self._anchored:
            return task.anchor(xy)
        if not self._has_corridors:
            return xy
        return jnp.where(self.is_corridor(room), task.anchor(xy), xy)

    def _draw_direction(
        self, room: Int[Array, ""], xy: Float[Array, "2"], key: Key[Array, ""]
    ) -> Int[Array, ""]:
        """Draws a direction uniformly; in corridors only those without a wall in the next cell."""
        drawn = jax.random.randint(key, (), 0, base.NUM_DIRECTIONS)
        if not self._has_corridors:
            return drawn

        ahead_xy = xy[None] + base.CELL * jnp.array(base.DIRECTIONS_XY, jnp.float32)
        is_wall = jax.vmap(maze_lib.is_wall, in_axes=(None, 0))(self.room(room), ahead_xy)
        free = jax.random.categorical(key, jnp.where(is_wall, -jnp.inf, 0.0))
        return jnp.where(self.is_corridor(room), free, drawn).astype(jnp.int32)

    def _observe(self, inner: LocomotionState) -> low_obs.LowObs:
        steps_left = self.robot.steps_per_subgoal - inner.step % self.robot.steps_per_subgoal
        return low_obs.observe(
            inner.physics, inner.subgoal_xy, steps_left, inner.direction, self.robot
        )
