"""A robot in a maze that observes its own position and its goal; a step is a control step.

What learners without a picture know and do: flat DroQ, HIGL, HRAC, HIRO and HESS. The task is that
of the other mazes (`task`), but they know more than ours does: their own position and the goal's.

Observation: `base.GoalObs`. Action: controls in [-1, 1].
Reward: sparse pays 1 for each goal region that the torso enters for the first time; dense pays
1 / (1 + distance to the current goal) per control step, and 1 once all have been visited (paper,
App. D).
End of an episode: terminated by the last goal, with sparse reward, or by a simulation that breaks
down; truncated at the maze's number of decisions times the robot's control steps per subgoal. A
fall ends nothing.
Reset: as in `physics_maze`.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import task, wrappers
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import engine as engine_lib


class GoalMazeState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      nav: where the episode stands; its `decisions` count control steps.
      physics: the robot's state.
      total_reward: float32, rewards of the episode so far.
      has_fallen: whether the robot has lain on the ground.
      is_broken: whether its simulation has broken down.
    """

    nav: task.Navigation
    physics: engine_lib.PhysicsState
    total_reward: Float[Array, ""]
    has_fallen: Bool[Array, ""]
    is_broken: Bool[Array, ""]


EnvState: TypeAlias = base.EnvState[GoalMazeState, base.GoalObs]


class GoalMaze:
    """One maze, or a different one in every episode.

    Metrics, so far in the episode: `success` visited goals / goals, `decisions` control steps /
    control steps per subgoal, control `steps`, `return`, and 0 or 1 for `fell` and `broke_down`.

    Attributes:
      engine: moves the robot.
      robot: which one it is.
      table: the mazes, their time limits in control steps.
    """

    def __init__(
        self,
        engine: engine_lib.Engine,
        mazes: maze_lib.Maze,
        *,
        reward: base.Reward = "sparse",
    ):
        """Prepares the mazes.

        Args:
          engine: moves the robot.
          mazes: one maze, or several with a leading axis of which each episode draws one.
          reward: see the module.

        Raises:
          base.UserError: an unknown reward.
        """
        checks.one_of("reward", reward, base.REWARDS)
        self.robot = engine.robot
        self.engine = engine
        self._reward: base.Reward = reward
        # The task counts each of our steps as a decision.
        most = (2**31 - 1) // self.robot.steps_per_subgoal
        checks.in_range("num_decisions", int(np.max(mazes.num_decisions)), 1, most)
        limit = mazes.num_decisions * self.robot.steps_per_subgoal
        self.table = task.prepare(mazes.replace(num_decisions=limit))
        self._jitter = float(self.table.mazes.start_jitter.max())

    @property
    def side_xy(self) -> tuple[int, int]:
        """The mazes' sides in units, their upper left corner at the origin."""
        num_rows, num_columns = self.table.mazes.wall.shape[-2:]
        return round(num_columns * base.CELL), round(num_rows * base.CELL)

    def reset(
        self,
        key: Key[Array, ""],
        maze: Int[Array, ""] | None = None,
        place: task.Place | None = None,
    ) -> EnvState:
        """Draws a new episode, in a given maze and place or in any; the key is consumed."""
        next_key, start_key, pose_key = jax.random.split(key, 3)
        nav, xy = task.start(self.table, start_key, maze, place)

        no = jnp.zeros((), bool)
        inner = GoalMazeState(
            nav=nav,
            physics=body_lib.draw_start(
                self.engine, task.drawn_maze(self.table, nav), xy, pose_key, self._jitter
            ),
            total_reward=jnp.float32(0.0),
            has_fallen=no,
            is_broken=no,
        )
        return self._state(inner, base.Outcome.of_reset(), next_key)

    def step(self, state: EnvState, action: Float[Array, " nu"]) -> EnvState:
        """Advances one control step; after the end nothing moves, and the reward is 0."""
        inner = state.inner
        maze = task.drawn_maze(self.table, inner.nav)
        physics, is_broken = body_lib.move(self.engine, inner.physics, action, maze, ~state.is_over)

        nav, outcome = task.advance(self.table, inner.nav, physics.qpos[None, :2], self._reward)
        outcome = outcome.terminated_if(is_broken)
        inner = GoalMazeState(
            nav=nav,
            physics=physics,
            total_reward=inner.total_reward + outcome.reward,
            has_fallen=inner.has_fallen | body_lib.is_fallen(physics.qpos, self.robot),
            is_broken=is_broken,
        )
        # The learners of `baselines` go on to the end of a subgoal, past that of the episode.
        return wrappers.rest_if_over(state, self._state(inner, outcome, state.key))

    def observe(self, nav: task.Navigation, physics: engine_lib.PhysicsState) -> base.GoalObs:
        """Returns the observation; the decisions of `nav` count control steps here."""
        xy, success = physics.qpos[:2], task.success(self.table, nav)
        # Once all goals are visited the robot's own place is shown as goal, as the reward has it.
        goal_xy = jnp.where(success == 1.0, xy, task.current_goal_xy(self.table, nav, xy))
        return base.GoalObs(
            xy=xy,
            proprioception=physics.proprioception,
            goal_xy=goal_xy,
            time=nav.decisions.astype(jnp.float32) / base.TIME_UNIT,
        )

    def _state(self, inner: GoalMazeState, outcome: base.Outcome, key: Key[Array, ""]) -> EnvState:
        """Puts together what `reset` and `step` return."""
        steps = inner.nav.decisions.astype(jnp.float32)
        metrics = {
            "success": task.success(self.table, inner.nav),
            "decisions": jnp.ceil(steps / self.robot.steps_per_subgoal),
            "steps": steps,
            "return": inner.total_reward,
            "fell": inner.has_fallen,
            "broke_down": inner.is_broken,
        }
        obs = self.observe(inner.nav, inner.physics)
        return base.EnvState.of(inner=inner, obs=obs, outcome=outcome, metrics=metrics, key=key)
