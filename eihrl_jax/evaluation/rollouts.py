"""Runs many episodes at once, in several mazes, and keeps what tables and pictures need.

Every episode has its own stream of random numbers, derived from the seed, the maze and the
episode's number, so its result doesn't depend on which episodes run beside it. Physics isn't
computed for an episode that is over.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Hashable
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base, mazes
from eihrl_jax.envs import hierarchy, raster
from eihrl_jax.evaluation import lanes as lanes_lib
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.evaluation import results, streams
from eihrl_jax.evaluation import whereabouts as whereabouts_lib
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.mazes import paths
from eihrl_jax.ops import tree
from eihrl_jax.runs import progress as progress_lib

MAX_ROWS = 1024
"""Most episodes that run at once."""

MAX_BYTES = 2**30
"""Most bytes that these episodes' states take, in huge mazes most of an evaluation's memory;
recordings may take half as much again."""

_MIN_TIMES_RECORDED = 4
"""The recorded episodes run first, for a preview, where there are at least this many times as many
episodes in all. A batch of their own costs as many more decisions as the longest of them takes."""

HighPolicy: TypeAlias = Callable[[raster.Picture | None, Key[Array, ""]], Int[Array, ""]]
"""From the patch and a key to a direction; a pytree (`jax.tree_util.Partial`) of its parameters."""


@runtime_checkable
class Recordable(Protocol):
    """An environment whose step is a decision, and which can also return the decision's path.

    `envs.hierarchy.Hierarchy` is one. Its inner states have `nav`, an `envs.task.Navigation`.
    """

    def reset(self, key: Key[Array, ""], maze: Int[Array, ""] | None = None) -> base.EnvState:
        """Draws a new episode."""
        ...

    def trace(
        self, state: base.EnvState, action: Int[Array, ""]
    ) -> tuple[base.EnvState, hierarchy.Trace]:
        """Follows a direction for one subgoal."""
        ...


@dataclasses.dataclass(frozen=True)
class Rollout:
    """All episodes of one agent in one maze.

    Attributes:
      episodes: their numbers.
      share: float [R * b, C * b], b = `whereabouts.BINS_PER_CELL`, share of the episodes in which
        the torso was in a bin at least once, in [0, 1]; row 0 is the north.
      recordings: the first episodes of the first seed, for pictures.
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
      num_recorded: how many of the first seed's episodes are recorded per maze, fewer where they
        would take too much memory.
      recorded: the mazes in which they are; None: in all.
    """

    mazes: dict[str, mazes.Maze]
    seeds: tuple[int, ...]
    num_episodes: int
    num_recorded: int = 0
    recorded: tuple[str, ...] | None = None

    @property
    def rows(self) -> Int[np.ndarray, "N 3"]:
        """Seed, index of the maze and number of every episode."""
        shape = (len(self.seeds), len(self.mazes), self.num_episodes)
        seed, maze, episode = np.indices(shape).reshape(3, -1)
        return np.stack([np.array(self.seeds)[seed], maze, episode], 1)

    @property
    def limits(self) -> Int[np.ndarray, " M"]:
        """Most decisions that an episode can take, by maze."""
        return np.array([int(maze.num_decisions) for maze in self.mazes.values()])

    @property
    def num_decisions(self) -> int:
        """Most decisions that all episodes can take together."""
        return int(self.limits.sum()) * len(self.seeds) * self.num_episodes


class _Batch(NamedTuple):
    """Finished episodes that ran together.

    Attributes:
      rows: int [E, 3], seed, index of the maze and number of each.
      episodes: their numbers.
      visits: int [M, rows, columns], in how many episodes of each maze the torso was in each bin.
      recordings: by maze.
    """

    rows: Int[np.ndarray, "E 3"]
    episodes: results.Episodes
    visits: Int[np.ndarray, "M rows columns"]
    recordings: list[list[recording_lib.Recording]]


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
        # Jitted, each is traced once, for its shapes and for the programs that it is part of.
        self._reset_one, self._trace = jax.jit(env.reset), jax.jit(env.trace)
        self._plan, self._rows, self._mazes = plan, plan.rows, list(plan.mazes.values())
        self._bins = whereabouts_lib.BINS_PER_CELL * np.max([m.wall.shape for m in self._mazes], 0)
        self._is_recorded = np.array([name in (plan.recorded or plan.mazes) for name in plan.mazes])
        self._recorded_each = self._num_recorded_each()
        self._num_recorded = int(self._is_recorded.sum()) * self._recorded_each
        # All batches have one size, so that nothing is compiled twice; the last is filled up.
        num_batches = math.ceil(len(self._rows) / self._max_rows())
        self._size = math.ceil(len(self._rows) / num_batches)
        self._reset = jax.jit(jax.vmap(self._reset_one), compiler_options=base.QUICK_COMPILE)
        self._compiled: dict[Hashable, jax.stages.Compiled] = {}
        self._tours = functools.cache(lambda maze, door: paths.tours(self._mazes[maze], door))

    def _max_rows(self) -> int:
        """Returns how many episodes may run at once."""
        # A state is held twice, before and after the decision.
        each = int(self._bins.prod()) + 2 * tree.num_bytes(self._shapes[0])
        return min(MAX_ROWS, max(1, MAX_BYTES // each))

    def _num_recorded_each(self) -> int:
        """Returns how many episodes are recorded in each of the mazes in which some are."""
        state, trace = self._shapes
        # Pictures are stored as bits.
        seen = 0 if state.obs is None else math.prod(state.obs.shape) // 8
        longest = int(self._plan.limits[self._is_recorded].max(initial=1))
        each = longest * (seen + tree.num_bytes(trace)) * int(self._is_recorded.sum())
        wanted = min(self._plan.num_recorded, self._plan.num_episodes)
        return min(wanted, MAX_BYTES // 2 // max(each, 1))

    @functools.cached_property
    def _shapes(self) -> tuple[base.EnvState, hierarchy.Trace]:
        """Shapes and types of an episode's state and of a decision's trace."""
        state = jax.eval_shape(self._reset_one, jax.random.key(0), jnp.int32(0))
        return jax.eval_shape(self._trace, state, jnp.int32(0))

    def run(
        self,
        high_policy: HighPolicy,
        progress: progress_lib.Progress,
        preview: Callable[[dict[str, Rollout]], None] | None = None,
    ) -> dict[str, Rollout]:
        """Runs the episodes.

        Args:
          high_policy: chooses the directions.
          progress: is told the decisions spent; an episode that is over counts with its limit.
          preview: is called with the recorded episodes as soon as they are over; never, where they
            are a large part of all episodes.

        Returns:
          What happened, by maze.
        """
        decide = functools.partial(self._next, high_policy, progress)
        rows, num_first = self._rows, 0
        recorded = self._recorded(rows)
        is_worth_it = 0 < _MIN_TIMES_RECORDED * len(recorded) <= len(rows)
        if preview and is_worth_it and len(recorded) <= self._size:
            # Each maze's recorded episodes are its first ones, and stay so.
            rows, num_first = np.r_[rows[recorded], np.delete(rows, recorded, 0)], len(recorded)
        limits = self._plan.limits[rows[:, 1]]
        spent, success = np.zeros(len(rows), int), np.zeros(len(rows))

        def report(here: slice, lanes: lanes_lib.Lanes) -> None:
            # An episode that is over counts with its limit, so that the bar reaches 100 %.
            is_real = lanes.rows < here.stop - here.start
            index = here.start + lanes.rows[is_real]
            decisions = np.asarray(lanes.state.inner.nav.decisions)[is_real]
            spent[index] = np.where(lanes.is_running[is_real], decisions, limits[index])
            success[index] = np.asarray(lanes.state.metrics["success"])[is_real]
            progress.update(int(spent.sum()), {"success": success[: here.stop].mean()})

        # One batch after the other, each until its last episode is over.
        batches = []
        edges = [*([0] if num_first else []), *range(num_first, len(rows), self._size), len(rows)]
        for first, end in itertools.pairwise(edges):
            here = slice(first, end)
            batches.append(self._run_batch(decide, rows[here], functools.partial(report, here)))
            if preview and end == num_first:
                with progress.apart():
                    preview(self._by_maze(batches))
        return self._by_maze(batches)

    def _next(
        self,
        high_policy: HighPolicy,
        progress: progress_lib.Progress,
        lanes: lanes_lib.Lanes,
        t: int,
    ) -> tuple[lanes_lib.Lanes, recording_lib.Decision]:
        """Calls the compiled `_decide`, which is compiled for the first policy of each kind."""
        # The structure holds network and options, but no parameters: equal ones share a program.
        kind = jax.tree.structure(high_policy), len(lanes.rows)
        arguments = (high_policy, *lanes[:-1], jnp.int32(t))
        if kind not in self._compiled:
            with progress.compiling("episodes"):
                # Ahead of time: `jit` would compile again at the second call, when the states come
                # back committed to the device of a loaded policy. Bins are marked in place.
                decide = jax.jit(self._decide, donate_argnames="places")
                self._compiled[kind] = decide.lower(*arguments).compile()

        state, places, decision = self._compiled[kind](*arguments)
        return lanes._replace(state=state, places=places), decision

    def _decide(
        self,
        high_policy: HighPolicy,
        state: base.EnvState,
        places: whereabouts_lib.Whereabouts,
        keys: Key[Array, " E"],
        recorded: Int[Array, " R"],
        t: Int[Array, ""],
    ) -> tuple[base.EnvState, whereabouts_lib.Whereabouts, recording_lib.Decision]:
        """Makes decision `t` of every episode that is not over, and picks what is recorded of it.

        Args:
          high_policy: chooses the directions.
          state: of the environments.
          places: where the torsos are, and have been.
          keys: of the episodes' high levels, the same in all decisions; `t` is folded in.
          recorded: rows of the episodes that are recorded.
          t: number of the decision.

        Returns:
          States and places after the decision, and the decisions of the recorded episodes.
        """

        def decide(
            state: base.EnvState, place: whereabouts_lib.Whereabouts, key: Key[Array, ""]
        ) -> tuple[base.EnvState, whereabouts_lib.Whereabouts, recording_lib.Decision]:
            action = high_policy(state.obs, jax.random.fold_in(key, t))
            following, trace = self._trace(state, action)

            # The state of an episode that is over stays while others of its batch go on.
            kept = tree.where(state.is_over, state, following)
            decision = recording_lib.Decision.of(state.obs, action, trace)
            return kept, place.after(trace), decision

        state, places, decision = jax.vmap(decide)(state, places, keys)
        return state, places, jax.tree.map(lambda leaf: leaf[recorded], decision)

    def _run_batch(
        self,
        decide: Callable[[lanes_lib.Lanes, int], tuple[lanes_lib.Lanes, recording_lib.Decision]],
        rows: Int[np.ndarray, "E 3"],
        report: Callable[[lanes_lib.Lanes], None],
    ) -> _Batch:
        """Runs episodes to their ends."""
        whole = lanes = self._begin(rows)
        longest = int(self._plan.limits[rows[:, 1]].max())
        history: list[recording_lib.Decision] = []
        while lanes.is_running.any():
            if lanes.is_thin(longest - len(history)):
                whole = whole.put_back(lanes)
                lanes = lanes.thinned()
            lanes, decision = decide(lanes, len(history))
            # To the host at once, so that the device holds one decision's record only.
            history.append(jax.device_get(decision))
            report(lanes)

        return self._finish(rows, whole.put_back(lanes), history)

    def _begin(self, rows: Int[np.ndarray, "_ 3"]) -> lanes_lib.Lanes:
        """Returns a batch at its start."""
        # A short batch is padded with copies of rows that are over; `_finish` leaves them out.
        padded = np.resize(rows, (self._size, 3))
        env_keys, high_keys = streams.streams(padded, list(self._plan.mazes))
        state = self._reset(env_keys, jnp.asarray(padded[:, 1], jnp.int32))
        is_extra = jnp.arange(self._size) >= len(rows)
        state = state.replace(terminated=state.terminated | is_extra)
        places = whereabouts_lib.Whereabouts.at_the_start(self._size, *self._bins.tolist())
        # The same number in every batch, because a compiled program has fixed shapes.
        recorded = np.resize(self._recorded(rows), self._num_recorded)
        recorded = jnp.asarray(recorded, jnp.int32)
        return lanes_lib.Lanes(state, places, high_keys, recorded, np.arange(self._size))

    def _recorded(self, rows: Int[np.ndarray, "E 3"]) -> Int[np.ndarray, " R"]:
        """Returns which rows of a batch are recorded."""
        is_first = (rows[:, 0] == self._plan.seeds[0]) & (rows[:, 2] < self._recorded_each)
        return np.flatnonzero(is_first & self._is_recorded[rows[:, 1]])

    def _finish(
        self,
        rows: Int[np.ndarray, "E 3"],
        lanes: lanes_lib.Lanes,
        history: list[recording_lib.Decision],
    ) -> _Batch:
        """Reads the numbers, visits and recordings of a batch that is over."""
        nav, metrics, places = jax.tree.map(
            lambda leaf: np.asarray(leaf)[: len(rows)],
            (lanes.state.inner.nav, lanes.state.metrics, lanes.places),
        )
        # Oracle movement neither falls nor breaks down, and has no such metrics.
        never = np.zeros(len(rows))
        episodes = results.Episodes(
            visited=nav.visited,
            end_xy=np.asarray(places.xy),
            returns=metrics["return"],
            decisions=nav.decisions,
            has_fallen=metrics.get("fell", never) > 0.0,
            is_unstable=metrics.get("broke_down", never) > 0.0,
            seed=rows[:, 0],
            shortest=self._shortest(rows[:, 1], nav.start_ij, nav.door_ij),
        )

        # Summed per batch: bins of every single episode would pile up in memory.
        was_there = places.was_there
        visits = [was_there[rows[:, 1] == maze].sum(0) for maze in range(len(self._mazes))]

        # Each is cut to the decisions that its episode took, in the maze with the door it had.
        recordings: list[list[recording_lib.Recording]] = [[] for _ in self._mazes]
        decisions = jax.tree.map(lambda *leaves: np.stack(leaves, 1), *history)
        for i, row in enumerate(self._recorded(rows)):
            maze, num = rows[row, 1], nav.decisions[row]
            opened = maze_lib.open_door(self._mazes[maze], jnp.asarray(nav.door_ij[row]))
            own = jax.tree.map(lambda leaf, i=i, num=num: leaf[i, :num], decisions)
            recordings[maze].append(recording_lib.of_episode(opened, own, self._shapes[0].obs))
        return _Batch(rows, episodes, np.stack(visits), recordings)

    def _shortest(
        self,
        maze: Int[np.ndarray, " E"],
        start_ij: Int[np.ndarray, "E 2"],
        door_ij: Int[np.ndarray, "E 2"],
    ) -> Int[np.ndarray, " E"]:
        """Counts the moves of each episode's shortest tour."""
        shortest = np.zeros(len(maze), int)
        for index, own in enumerate(self._mazes):
            doors = np.asarray(own.door)
            for door in np.unique(door_ij[maze == index], axis=0):
                is_here = (maze == index) & (door_ij == door).all(1)
                place = (int(door[0]), int(door[1])) if doors.any() else None
                shortest[is_here] = self._tours(index, place)[tuple(start_ij[is_here].T)]
        return shortest

    def _by_maze(self, batches: list[_Batch]) -> dict[str, Rollout]:
        """Groups the episodes of all batches by maze."""
        all_episodes = [batch.episodes for batch in batches]
        episodes = jax.tree.map(lambda *parts: np.concatenate(parts), *all_episodes)
        maze_of = np.concatenate([batch.rows[:, 1] for batch in batches])
        visits = np.sum([batch.visits for batch in batches], axis=0)

        rollouts = {}
        for index, (name, maze) in enumerate(self._plan.mazes.items()):
            is_here = maze_of == index
            # Smaller mazes are padded to the size of the largest: their extra bins are cut off.
            num_rows, num_columns = (
                whereabouts_lib.BINS_PER_CELL * side for side in maze.wall.shape
            )
            rollouts[name] = Rollout(
                episodes=jax.tree.map(lambda column, here=is_here: column[here], episodes),
                share=visits[index, :num_rows, :num_columns] / max(is_here.sum(), 1),
                recordings=[each for batch in batches for each in batch.recordings[index]],
            )
        return rollouts
