"""HIGL's ant maze, the U of HIRO with cells of four units: for comparison with published figures.

Observation and action: those of `goal_maze`. Coordinates are those of our mazes (see `base`), in
which HIGL's origin, the middle of the start cell, lies at `START_XY`.
Reward: sparse, 0 within `RADIUS` of the goal, else -1; or dense, minus the distance to the goal.
End of an episode: truncated after 500 control steps; where `ends_at_goal`, as in the evaluation,
terminated within `RADIUS` of the goal; terminated by a simulation that breaks down.
Reset: the ant stands in the middle of the start cell, facing east (released: up to 0.1 off); the
goal is drawn uniformly from a square that holds the maze's inside, walls included, or is the far
end of the U.

Source: Kim et al. 2021, Appendix; Nachum et al. 2018.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import wrappers
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import walls

CELL = 4.0  # units
TEXT = "#####\n#1..#\n###.#\n#S..#\n#####\n"
START_XY = (1.5 * CELL, -3.5 * CELL)
GOALS = (-2.0, 10.0)
"""Least and greatest x and y of goals in training, from `START_XY`."""

FAR_XY = (0.0, 8.0)
"""The goal of the evaluation, from `START_XY`."""

RADIUS = 2.5  # units
EPISODE_STEPS = 500  # control steps


class UMazeState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      physics: the ant.
      goal_xy: float32 [2], units.
      has_arrived: whether it has been at the goal.
      has_fallen: whether it has lain on the ground.
      is_broken: whether its simulation has broken down.
      total_reward: float32, rewards of the episode so far.
      step: int32, control steps so far.
    """

    physics: engine_lib.PhysicsState
    goal_xy: Float[Array, "2"]
    has_arrived: Bool[Array, ""]
    has_fallen: Bool[Array, ""]
    is_broken: Bool[Array, ""]
    total_reward: Float[Array, ""]
    step: Int[Array, ""]


EnvState: TypeAlias = base.EnvState[UMazeState, base.GoalObs]


class UMaze:
    """The maze, see the module.

    Metrics, so far in the episode: `success` has been at the goal, control `steps`, `return`, and 0
    or 1 for `fell` and `broke_down`.
    """

    side_xy = (20, 20)

    def __init__(
        self,
        engine: engine_lib.Engine,
        maze: maze_lib.Maze,
        *,
        reward: base.Reward = "sparse",
        is_evaluation: bool = False,
    ):
        """Takes what moves the ant.

        Args:
          engine: with walls of `CELL` units.
          maze: of `TEXT`.
          reward: see the module.
          is_evaluation: whether the goal is the far one, and ends the episode.
        """
        self.robot = engine.robot
        self._engine = engine
        self._maze = maze
        self._reward: base.Reward = reward
        self._is_evaluation = is_evaluation

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Draws a new episode; the key is consumed."""
        next_key, goal_key, pose_key = jax.random.split(key, 3)
        start_xy = jnp.array(START_XY)
        # Walls included, so that some goals can't be reached.
        drawn = jax.random.uniform(goal_key, (2,), minval=GOALS[0], maxval=GOALS[1])

        physics = body_lib.draw_pose(self._engine, start_xy, pose_key)
        no = jnp.zeros((), bool)
        inner = UMazeState(
            physics=body_lib.facing_east(physics),
            goal_xy=start_xy + (jnp.array(FAR_XY) if self._is_evaluation else drawn),
            has_arrived=no,
            has_fallen=no,
            is_broken=no,
            total_reward=jnp.float32(0.0),
            step=jnp.int32(0),
        )
        return _state(inner, base.Outcome.of_reset(), next_key)

    def step(self, state: EnvState, action: Float[Array, " nu"]) -> EnvState:
        """Advances one control step; after the end nothing moves, and the reward is 0."""
        inner = state.inner
        # The maze's functions count in our cells, which are smaller.
        scale = CELL / base.CELL
        own_xy = inner.physics.qpos[:2] / scale
        walls_xy = scale * walls.nearby(self._maze, own_xy, self.robot.num_walls)
        physics, is_broken = body_lib.advance(
            self._engine, inner.physics, action, walls_xy, ~state.is_over
        )

        distance = jnp.sqrt(jnp.square(physics.qpos[:2] - inner.goal_xy).sum())
        is_there = distance <= RADIUS
        reward = -distance if self._reward == "dense" else jnp.where(is_there, 0.0, -1.0)
        terminated = is_broken | (is_there & self._is_evaluation)
        step = inner.step + 1
        outcome = base.Outcome.of_step(reward, terminated, step >= EPISODE_STEPS)

        inner = UMazeState(
            physics=physics,
            goal_xy=inner.goal_xy,
            has_arrived=inner.has_arrived | is_there,
            has_fallen=inner.has_fallen | body_lib.is_fallen(physics.qpos, self.robot),
            is_broken=is_broken,
            total_reward=inner.total_reward + reward,
            step=step,
        )
        return wrappers.rest_if_over(state, _state(inner, outcome, state.key))


def _state(inner: UMazeState, outcome: base.Outcome, key: Key[Array, ""]) -> EnvState:
    """Puts together what `reset` and `step` return."""
    steps = inner.step.astype(jnp.float32)
    obs = base.GoalObs(
        xy=inner.physics.qpos[:2],
        proprioception=inner.physics.proprioception,
        goal_xy=inner.goal_xy,
        time=steps / base.TIME_UNIT,
    )

    metrics = {
        "success": inner.has_arrived,
        "steps": steps,
        "return": inner.total_reward,
        "fell": inner.has_fallen,
        "broke_down": inner.is_broken,
    }
    return base.EnvState.of(inner=inner, obs=obs, outcome=outcome, metrics=metrics, key=key)
