"""Runs many episodes at once, in several mazes, and keeps what tables and pictures need.

Every episode has its own stream of random numbers, drawn from seed, maze and its number: which
other episodes run beside it changes nothing. One that is over rests and costs no physics.
"""

import dataclasses
import math
import time
import zlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt32

from eihrl_jax import base, mazes
from eihrl_jax.envs import hierarchy, task
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.evaluation import results
from eihrl_jax.ops import tree
from eihrl_jax.runs import progress as progress_lib

MAX_ROWS = 1024
"""Most episodes that run at once."""

BINS_PER_CELL = 6
"""Bins along a cell's side, in which visits are counted."""

HighPolicy = Callable[[Any, Key[Array, ""]], Int[Array, ""]]
"""From the patch and a key to a direction; a pytree (`jax.tree_util.Partial`) of its parameters."""


@runtime_checkable
class Recordable(Protocol):
    """An environment of decisions that also tells the way, see `envs.hierarchy.Hierarchy`."""

    @property
    def table(self) -> task.MazeTable:
        """Its mazes."""
        ...

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> base.EnvState:
        """Draws a new episode."""
        ...

    def trace(
        self, state: base.EnvState, action: Int[Array, ""]
    ) -> tuple[base.EnvState, hierarchy.Trace]:
        """Follows a direction for one subgoal."""
        ...


class Step(struct.PyTreeNode):
    """One decision of E episodes.

    Attributes:
      obs: bool [E, P, P, C], what the high level saw; None where there is none of ours.
      action: int32 [E].
      trace: the way, with leading axis E.
    """

    obs: Bool[Array, "E P P C"] | None
    action: Int[Array, " E"]
    trace: hierarchy.Trace


@dataclasses.dataclass(frozen=True)
class Rollout:
    """All episodes of one agent in one maze.

    Attributes:
      episodes: their numbers.
      share: see `drawing.heatmap.Visits`.
      recordings: the first episodes of the first seed, to be drawn.
    """

    episodes: results.Episodes
    share: Float[np.ndarray, "rows columns"]
    recordings: list[recording_lib.Recording]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """Which episodes are to be run.

    Attributes:
      mazes: by name.
      seeds: of the random numbers; each runs all episodes anew.
      num_episodes: per maze and seed.
      num_recorded: how many of the first seed's episodes are recorded per maze.
    """

    mazes: dict[str, mazes.Maze]
    seeds: tuple[int, ...]
    num_episodes: int
    num_recorded: int = 0

    @property
    def num_decisions(self) -> int:
        """Most decisions that all episodes can take together."""
        limits = sum(int(maze.num_decisions) for maze in self.mazes.values())
        return limits * len(self.seeds) * self.num_episodes


@dataclasses.dataclass(frozen=True)
class _Batch:
    """Finished episodes that ran together, E of them.

    Attributes:
      rows: int [E, 3], seed, maze and number of each.
      columns: arrays [E] by field of `results.Episodes`.
      recordings: by row of the batch.
    """

    rows: Int[np.ndarray, "E 3"]
    columns: dict[str, np.ndarray]
    recordings: dict[int, recording_lib.Recording]


@dataclasses.dataclass(frozen=True)
class _Programs:
    """Compiled functions for batches of one size.

    Attributes:
      reset: from environments' keys and mazes to first states.
      decide: from high level, states, high levels' keys and the decision's number to the states
        after it, and what was decided.
    """

    reset: Callable[..., Any]
    decide: Callable[..., Any]


class Runner:
    """Runs the planned episodes in one environment, for one high level after another.

    High levels that differ in their parameters alone share what is compiled.
    """

    def __init__(self, env: Recordable, plan: Plan):
        """Compiles nothing yet.

        Args:
          env: environment of the plan's mazes, in their order.
          plan: which episodes.
        """
        self._env = env
        self._plan = plan
        self._rows = np.array(
            [
                (seed, maze, episode)
                for seed in plan.seeds
                for maze in range(len(plan.mazes))
                for episode in range(plan.num_episodes)
            ]
        )
        num_batches = math.ceil(len(self._rows) / MAX_ROWS)
        # All batches have one size, so that nothing is compiled twice; the last may run on in vain.
        self._size = math.ceil(len(self._rows) / num_batches)
        self._reset: Callable[..., Any] | None = None
        self._compiled: dict[Any, _Programs] = {}

    def run(
        self, high_policy: HighPolicy, progress: progress_lib.Progress
    ) -> tuple[dict[str, Rollout], float]:
        """Runs the episodes.

        Args:
          high_policy: chooses the directions.
          progress: is told the decisions spent; those that an episode did not need count as spent.

        Returns:
          What happened in each maze, and the seconds that it took, compiling left out.
        """
        rows, size, plan = self._rows, self._size, self._plan
        loop = _Loop(self._env, plan, high_policy, self._programs(high_policy, progress), progress)
        start = time.monotonic()
        batches = [loop.run(rows[i : i + size], size) for i in range(0, len(rows), size)]
        seconds = time.monotonic() - start
        found = {
            name: _rollout(batches, loop.visits[i], plan, i) for i, name in enumerate(plan.mazes)
        }
        return found, seconds

    def _programs(self, high_policy: HighPolicy, progress: progress_lib.Progress) -> _Programs:
        """Returns what is compiled for high levels like this one."""
        leaves, structure = jax.tree.flatten(high_policy)
        kind = (structure, *((leaf.shape, leaf.dtype) for leaf in leaves))
        if kind not in self._compiled:
            with progress.compiling("episodes"):
                self._compiled[kind] = self._compile(high_policy)
        return self._compiled[kind]

    def _compile(self, high_policy: HighPolicy) -> _Programs:
        keys = jax.vmap(jax.random.key)(jnp.zeros(self._size, jnp.uint32))
        index = jnp.zeros(self._size, jnp.int32)
        reset = jax.jit(jax.vmap(self._env.reset))
        if self._reset is None:  # the same whoever chooses
            self._reset = reset.lower(keys, index).compile()
        states = jax.eval_shape(reset, keys, index)
        decide = jax.jit(self._decide).lower(high_policy, states, keys, jnp.int32(0))
        return _Programs(self._reset, decide.compile())

    def _decide(
        self,
        high_policy: HighPolicy,
        states: base.EnvState,
        keys: Key[Array, " E"],
        t: Int[Array, ""],
    ) -> tuple[base.EnvState, Step]:
        """Makes decision `t` of every episode that is not over."""

        def decide(state: base.EnvState, key: Key[Array, ""]) -> tuple[base.EnvState, Step]:
            action = high_policy(state.obs, jax.random.fold_in(key, t))
            following, trace = self._env.trace(state, action)
            is_over = state.terminated | state.truncated
            kept = tree.where(is_over, state, following)
            return kept, Step(obs=state.obs, action=action, trace=trace)

        return jax.vmap(decide)(states, keys)


class _Loop:
    """The loop around one high level's decisions.

    Attributes:
      visits: int [rows, columns] of each maze, in how many of its episodes the torso was in each
        bin; a maze's own bins begin at the top left.
    """

    def __init__(
        self,
        env: Recordable,
        plan: Plan,
        high_policy: HighPolicy,
        programs: _Programs,
        progress: progress_lib.Progress,
    ):
        self._env = env
        self._plan = plan
        self._high_policy = high_policy
        self._programs = programs
        self._progress = progress
        self._spent = 0
        self._solved: list[np.ndarray] = []
        self.visits = np.zeros((len(plan.mazes), *_bins(env)), np.int32)

    def run(self, rows: Int[np.ndarray, "E 3"], size: int) -> _Batch:
        """Runs episodes to their ends, in a batch filled up to `size`."""
        padded = np.concatenate([rows, rows[:1].repeat(size - len(rows), 0)])
        env_keys, high_keys = _streams(padded, list(self._plan.mazes))
        index = jnp.asarray(padded[:, 1], jnp.int32)
        states = self._programs.reset(env_keys, index)
        limit = self._env.table.mazes.num_decisions[index][: len(rows)]
        is_recorded = (rows[:, 0] == self._plan.seeds[0]) & (rows[:, 2] < self._plan.num_recorded)
        recorded = np.flatnonzero(is_recorded)
        history: list[Step] = []
        was_there = np.zeros((len(rows), *_bins(self._env)), bool)
        is_over = np.zeros(len(rows), bool)
        while not is_over.all():
            t = jnp.int32(len(history))
            states, step = self._programs.decide(self._high_policy, states, high_keys, t)
            _mark(was_there, step.trace)
            history.append(jax.tree.map(lambda leaf: np.asarray(leaf)[recorded], step))
            is_over = np.asarray(states.terminated | states.truncated)[: len(rows)]
            self._report(states, limit, is_over)
        self._spent += int(limit.sum())
        columns = _columns(states, len(rows))
        self._solved.append(np.asarray(states.metrics["success"])[: len(rows)])
        recordings = {
            row: _recording(self._env, self._plan, states, history, row, i)
            for i, row in enumerate(recorded.tolist())
        }
        for maze in np.unique(rows[:, 1]):
            self.visits[maze] += was_there[rows[:, 1] == maze].sum(0, np.int32)
        return _Batch(rows, columns, recordings)

    def _report(
        self, states: base.EnvState, limit: Int[Array, " E"], is_over: Bool[np.ndarray, " E"]
    ) -> None:
        """Tells how far the batch is, and the success so far of all its episodes."""
        decisions = np.asarray(states.inner.nav.decisions)[: len(is_over)]
        spent = self._spent + int(np.where(is_over, limit, decisions).sum())
        success = np.asarray(states.metrics["success"])[: len(is_over)]
        self._progress.update(spent, {"success": np.concatenate([*self._solved, success]).mean()})


def _streams(
    rows: Int[np.ndarray, "E 3"], names: list[str]
) -> tuple[Key[Array, " E"], Key[Array, " E"]]:
    """Returns each episode's keys for its environment and for its high level.

    The maze enters by its name, so that it does not matter which others are evaluated.
    """
    hashes = np.array([zlib.crc32(name.encode()) for name in names], np.uint32)

    def stream(
        seed: UInt32[Array, ""], maze: UInt32[Array, ""], episode: UInt32[Array, ""]
    ) -> Key[Array, "2"]:
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), maze), episode)
        return jax.random.split(key)

    columns = (rows[:, 0], hashes[rows[:, 1]], rows[:, 2])
    keys = jax.vmap(stream)(*(jnp.asarray(column, jnp.uint32) for column in columns))
    return keys[:, 0], keys[:, 1]


def _bins(env: Recordable) -> tuple[int, int]:
    """Returns the number of bins along and across the mazes."""
    _, rows, columns = env.table.mazes.wall.shape
    return rows * BINS_PER_CELL, columns * BINS_PER_CELL


def _mark(was_there: Bool[np.ndarray, "E rows columns"], trace: hierarchy.Trace) -> None:
    """Marks the bins in which running episodes are, in place."""
    num, num_rows, num_columns = was_there.shape
    is_running = np.asarray(trace.is_running)[:num]
    xy = np.asarray(trace.qpos)[:num, :, :2][is_running]
    episode = np.nonzero(is_running)[0]
    side = base.CELL / BINS_PER_CELL
    i, j = np.floor(-xy[:, 1] / side).astype(int), np.floor(xy[:, 0] / side).astype(int)
    is_inside = (i >= 0) & (i < num_rows) & (j >= 0) & (j < num_columns)
    was_there[episode[is_inside], i[is_inside], j[is_inside]] = True


def _columns(states: base.EnvState, num: int) -> dict[str, np.ndarray]:
    """Reads the numbers of the first `num` episodes, which are over."""
    never = np.zeros(num)
    metrics = {name: np.asarray(value)[:num] for name, value in states.metrics.items()}
    return {
        "achieved": np.asarray(states.inner.nav.visited)[:num].sum(-1),
        "returns": metrics["return"],
        "decisions": np.asarray(states.inner.nav.decisions)[:num],
        "has_fallen": metrics.get("fell", never) > 0.0,
        "is_unstable": metrics.get("broke_down", never) > 0.0,
    }


def _recording(
    env: Recordable, plan: Plan, states: base.EnvState, history: list[Step], row: int, i: int
) -> recording_lib.Recording:
    """Puts together the recording of one episode: `row` of the batch, `i` of those recorded."""
    nav = jax.tree.map(lambda leaf: leaf[row], states.inner.nav)
    name = list(plan.mazes)[int(nav.maze)]
    rows, columns = plan.mazes[name].wall.shape
    maze = task.drawn_maze(env.table, nav)
    maze = maze.replace(
        **{
            field: getattr(maze, field)[:rows, :columns]
            for field in ("wall", "goal", "start", "door")
        }
    )
    num_decisions = int(nav.decisions)
    steps = [jax.tree.map(lambda leaf: leaf[i], step) for step in history[:num_decisions]]
    is_running = np.concatenate([step.trace.is_running for step in steps])
    decision = np.repeat(np.arange(num_decisions), len(steps[0].trace.is_running))
    is_ours = steps[0].obs is not None
    return recording_lib.Recording(
        maze=maze,
        qpos=np.concatenate([step.trace.qpos for step in steps])[is_running],
        decision=decision[is_running],
        direction=np.array([step.action for step in steps]) if is_ours else None,
        patch=np.array([step.obs for step in steps]) if is_ours else None,
        is_fallen=np.concatenate([step.trace.is_fallen for step in steps])[is_running],
    )


def _rollout(
    batches: list[_Batch], visits: Int[np.ndarray, "rows columns"], plan: Plan, maze: int
) -> Rollout:
    """Collects the episodes of one maze from all batches."""
    rows = np.concatenate([batch.rows for batch in batches])
    is_here = rows[:, 1] == maze
    columns = {
        name: np.concatenate([batch.columns[name] for batch in batches])[is_here]
        for name in batches[0].columns
    }
    num_rows, num_columns = list(plan.mazes.values())[maze].wall.shape
    count = visits[: num_rows * BINS_PER_CELL, : num_columns * BINS_PER_CELL]
    return Rollout(
        episodes=results.Episodes(**columns, seed=rows[is_here, 0]),
        share=count / is_here.sum(),
        recordings=[
            recording
            for batch in batches
            for row, recording in batch.recordings.items()
            if batch.rows[row, 1] == maze
        ],
    )
