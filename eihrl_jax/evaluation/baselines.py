"""Baselines as environments of decisions, so that they are evaluated beside ours."""

import dataclasses
import json
from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, Key, PyTree

from eihrl_jax import base, mazes
from eihrl_jax.baselines import interface
from eihrl_jax.baselines.world import World
from eihrl_jax.config import codec, presets
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import goal_maze, hierarchy, task
from eihrl_jax.evaluation import metas
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.runs import policies


class BaselineMazeState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      nav: where it stands, its `decisions` counted as ours are.
      state: of the maze, control step by control step.
      carry: of the baseline.
    """

    nav: task.Navigation
    state: goal_maze.EnvState
    carry: PyTree[Array]


EnvState: TypeAlias = base.EnvState[BaselineMazeState, None]


@dataclasses.dataclass(frozen=True)
class BaselineMaze:
    """A maze in which a baseline acts; a decision is as many control steps as one of ours.

    Attributes:
      env: the maze.
      baseline: what acts.
      policy: parameters of its networks by name.
    """

    env: goal_maze.GoalMaze
    baseline: interface.Actor
    policy: dict[str, base.Params]

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> EnvState:
        """Draws a new episode, in a given maze or in any; the key is consumed."""
        return self._outer(self.env.reset(key, maze), self.baseline.start(), jnp.float32(0.0))

    def trace(self, state: EnvState, action: Int[Array, ""]) -> tuple[EnvState, hierarchy.Trace]:
        """Lets the baseline act for as long as one of our subgoals takes; `action` is ignored."""
        del action  # A baseline brings its own upper level.

        def advance(
            loop: tuple[goal_maze.EnvState, PyTree[Array]], _: None
        ) -> tuple[tuple[goal_maze.EnvState, PyTree[Array]], hierarchy.Trace]:
            before, carry = loop
            ctrl, carry = self.baseline.act(self.policy, carry, before.obs)
            after = self.env.step(before, ctrl)

            # An episode that is over rests; its steps are marked and left out of what is drawn.
            qpos = after.inner.physics.qpos
            is_fallen = body_lib.is_fallen(qpos, self.env.robot)
            step = hierarchy.Trace(qpos=qpos, is_fallen=is_fallen, is_running=~before.is_over)
            return (after, carry), step

        # As long as one of our subgoals, so that decisions count the same time for both.
        start = state.inner.state, state.inner.carry
        num_steps = self.env.robot.steps_per_subgoal
        (inner, carry), trace = jax.lax.scan(advance, start, length=num_steps)
        # The metric sums over the episode: the difference is what these steps were paid.
        paid = inner.metrics["return"] - state.metrics["return"]
        return self._outer(inner, carry, paid), trace

    def _outer(
        self, state: goal_maze.EnvState, carry: PyTree[Array], reward: Float[Array, ""]
    ) -> EnvState:
        """Returns a state of the maze as one between two decisions."""
        decisions = state.metrics["decisions"].astype(jnp.int32)
        nav = state.inner.nav.replace(decisions=decisions)
        inner = BaselineMazeState(nav=nav, state=state, carry=carry)

        # No observation: what the baseline sees is in the maze's own state.
        outcome = base.Outcome(reward, state.terminated, state.truncated)
        return base.EnvState.of(
            inner=inner, obs=None, outcome=outcome, metrics=state.metrics, key=state.key
        )


def is_baseline(name: str) -> bool:
    """Returns whether a name or a folder is a trained baseline's."""
    return policies.kind_of(name) == "baseline"


def load(
    name: str, engine: engine_lib.Engine, stacked: mazes.Maze, *, reward: base.Reward = "sparse"
) -> BaselineMaze:
    """Loads a baseline into some mazes.

    Args:
      name: shipped name, run folder or policy folder.
      engine: moves the robot, which must be the one that it was trained with.
      stacked: mazes with a leading axis.
      reward: "sparse" or "dense".

    Raises:
      base.UserError: there is none, it is damaged, or another robot's.
    """
    path = policies.find(name, "baseline")
    policy, meta = policies.load(path, kind="baseline", robot=engine.robot.name)
    told = metas.read(meta, metas.Baseline, path)

    # Through the codec, so that what a stranger's file says is checked like a config.
    text = json.dumps(policies.entry(meta, "config", path), default=str)
    options = codec.from_json(type(presets.BASELINES[told.method]), text, source=str(path))

    env = goal_maze.GoalMaze(engine, stacked, reward=reward)
    steps = int(env.table.mazes.num_decisions.max())
    # Sizes of networks follow from the arena in which it was trained, not from these mazes.
    baseline = interface.make(World(env, engine.model.nu, told.side_xy, steps), options)
    metas.check_params(policy, lambda: baseline.policy(baseline.init(jax.random.key(0))), path)
    return BaselineMaze(env, baseline, policy)
