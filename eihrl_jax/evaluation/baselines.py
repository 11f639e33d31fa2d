"""Baselines as systems that are evaluated beside ours: a decision of theirs is k steps long."""

import dataclasses
import json
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base, mazes
from eihrl_jax.baselines import interface
from eihrl_jax.config import codec, presets
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import goal_maze, hierarchy, task
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.runs import checkpoint, policies


class BaselineWalk(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      nav: where it stands, its `decisions` counted as ours are.
      state: of the maze.
      carry: what the baseline remembers.
    """

    nav: task.Navigation
    state: base.EnvState
    carry: Any


@dataclasses.dataclass(frozen=True)
class BaselineMaze:
    """A robot that a baseline walks; a decision is as many control steps as one of ours.

    Attributes:
      env: the maze.
      table: the same mazes with their time limits in decisions.
      baseline: what acts.
      policy: its parameters.
    """

    env: goal_maze.GoalMaze
    table: task.MazeTable
    baseline: interface.Baseline
    policy: dict[str, Any]

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> base.EnvState:
        """Draws a new episode, in a given maze or in any; the key is consumed."""
        return self._outer(self.env.reset(key, maze), self.baseline.start(), jnp.float32(0.0))

    def trace(
        self, state: base.EnvState, action: Int[Array, ""]
    ) -> tuple[base.EnvState, hierarchy.Trace]:
        """Walks on for as long as one of our subgoals takes; the action means nothing."""
        del action
        walk: BaselineWalk = state.inner
        next_key, _ = jax.random.split(walk.state.key)  # Acting draws nothing.

        def advance(
            loop: tuple[base.EnvState, Any], _: None
        ) -> tuple[tuple[base.EnvState, Any], hierarchy.Trace]:
            inner, carry = loop
            is_running = ~(inner.terminated | inner.truncated)
            ctrl, carry = self.baseline.act(self.policy, carry, inner.obs)
            inner = self.env.step(inner, ctrl)
            qpos = inner.inner.physics.qpos
            is_fallen = body_lib.is_fallen(qpos, self.env.robot)
            step = hierarchy.Trace(qpos=qpos, is_fallen=is_fallen, is_running=is_running)
            return (inner, carry), step

        start = walk.state.replace(key=next_key), walk.carry
        (inner, carry), trace = jax.lax.scan(
            advance, start, length=self.env.robot.steps_per_subgoal
        )
        paid = inner.metrics["return"] - state.metrics["return"]
        return self._outer(inner, carry, paid), trace

    def _outer(self, inner: base.EnvState, carry: Any, reward: Float[Array, ""]) -> base.EnvState:
        decisions = inner.metrics["decisions"].astype(jnp.int32)
        nav = inner.inner.nav.replace(decisions=decisions)
        walk = BaselineWalk(nav=nav, state=inner, carry=carry)
        return inner.replace(inner=walk, obs=None, final_obs=None, reward=reward)


def is_baseline(name: str) -> bool:
    """Tells whether a name or a folder is a trained baseline's."""
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
    method = policies.entry(meta, "method", path)
    if method not in presets.BASELINES:
        raise base.UserError(f"{path}: unknown method {method!r}")
    text = json.dumps(policies.entry(meta, "config", path), default=str)
    options = codec.from_json(type(presets.BASELINES[method]), text, source=str(path))
    env = goal_maze.GoalMaze(engine, stacked, reward=reward)
    width, height = policies.entry(meta, "side_xy", path)
    steps = int(env.table.mazes.num_decisions.max())
    baseline = interface.make(env, engine.model.nu, (width, height), steps, options)
    expected = jax.eval_shape(lambda key: baseline.policy(baseline.init(key)), jax.random.key(0))
    checkpoint.check_same(path, policy, expected)
    return BaselineMaze(env, task.prepare(stacked), baseline, policy)
