"""Predicts a hierarchy's success in a maze from its robot's measured end points, without physics.

An episode is a Markov chain, whose state is what has been seen of the maze, where the robot is, how
it got there and which goals it has visited. The distribution over states is propagated decision by
decision: the high level gives the probability of each direction, and the measured distribution of
end points that of where it leads to. States that agree in everything that matters for the future
are merged. As long as all remaining ones can be kept, the result is exact. Where they are too many,
those of low probability are resampled, which leaves expectations unbiased.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax import base, mazes
from eihrl_jax.envs import end_points, oracle_maze, subgoals, task
from eihrl_jax.evaluation import end_law, loading
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.ops import rotations
from eihrl_jax.robots import robot as robot_lib

_CHUNK = 128
"""States per call of the compiled step."""

_NUM_OFFSETS = 4
"""Points per axis that stand for the uniform start within a cell."""

_NUM_POSTURES = 4
"""Postures over which probabilities are averaged where the high level sees the robot."""

_ANCHORED_PITCH = base.CELL / 2
"""Side of the squares within which positions are merged if subgoals are anchored, units.

A robot sees the cells that a square of five cells' length around it touches: so all that matters is
on which side of its cell's centre it is, on each axis."""

_FREE_PITCH = base.CELL / 30
"""The same for free subgoals, whose offsets add up."""

_FREE_LAW_PITCH = base.CELL / 10
"""Side of the squares within which end points of free subgoals are merged, units."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prediction:
    """An agent's expected performance in one maze.

    Attributes:
      maze: its name.
      success: expected share of the goals that are visited.
      solved: probability that all goals are visited in time.
      decisions: expected number of decisions.
      down: probability that the robot lies on the ground when time is up.
      thinned: expected number of decisions of an episode before which its state was resampled; 0
        if the figures are exact, given the distribution of end points.
      num_states: largest number of states followed at once.
    """

    maze: str
    success: float
    solved: float
    decisions: float
    down: float
    thinned: float
    num_states: int


class _States(NamedTuple):
    """S states of unfinished episodes in one maze, with their probabilities.

    Attributes:
      door_ij: int32 [S, 2], see `task.Navigation`, as the next two.
      visited: bool [S, 9].
      seen: bool [S, H, W]; H = W = 0 without a map.
      xy: float32 [S, 2], position of the torso, units.
      before: int32 [S], the last direction, or `REST` or `DOWN` of `end_points`.
      mass: float64 [S], probability.
    """

    door_ij: Int[np.ndarray, "S 2"]
    visited: Bool[np.ndarray, "S 9"]
    seen: Bool[np.ndarray, "S H W"]
    xy: Float[np.ndarray, "S 2"]
    before: Int[np.ndarray, " S"]
    mass: Float[np.ndarray, " S"]

    def at(self, index: Int[np.ndarray, " s"]) -> "_States":
        """Returns the states of these indices."""
        return _States(*(column[index] for column in self))


class Predictor:
    """Predicts what one agent does in several mazes."""

    def __init__(
        self,
        robot: robot_lib.Robot,
        high: loading.HighLevel,
        chosen: dict[str, mazes.Maze],
        ends: end_points.EndPoints,
        *,
        anchored: bool,
        num_states: int = 4096,
        seed: int = 0,
    ):
        """Prepares the mazes; nothing is compiled yet.

        Args:
          robot: gives the body's size and the postures that the high level may see.
          high: chooses directions.
          chosen: the mazes, by name.
          ends: the robot's measured end points.
          anchored: whether subgoals are anchored, as in `ends`.
          num_states: most states that are followed at once; where there are more, some are
            resampled.
          seed: of the resampling.

        Raises:
          base.UserError: robot and mazes don't fit.
        """
        stacked = mazes.stack(list(chosen.values()))
        view = high.view_in(stacked)
        gait = subgoals.gait(robot, None, base.CELL, base.SIGMA)
        env = loading.oracle_env(robot, stacked, view, gait=gait, anchored=anchored).env
        self._env, self._view, self._chosen = env, view, chosen
        self._high, self._num_states, self._seed = high, num_states, seed

        self._pitch = _ANCHORED_PITCH if anchored else _FREE_PITCH
        self._law = end_law.Law.of(ends, _ANCHORED_PITCH if anchored else _FREE_LAW_PITCH)
        # A map doesn't show the robot's posture.
        num_postures = 1 if view.has_map else _NUM_POSTURES
        bank = len(gait.bank.qpos)
        self._postures = jnp.linspace(0, bank - 1, num_postures).astype(jnp.int32)
        self._look = jax.jit(jax.vmap(self._look_one, in_axes=(None, 0, 0)))
        self._follow = jax.jit(jax.vmap(self._follow_one, in_axes=(None, None, *[0] * 5)))

    def run(self, name: str) -> Prediction:
        """Predicts what happens in one of the mazes."""
        index = list(self._chosen).index(name)
        maze, rng = self._chosen[name], np.random.default_rng(self._seed)
        states = self._starts(index)
        solved = decisions = thinned = 0.0
        most = 0

        for _ in range(int(maze.num_decisions)):
            states, drawn = _thinned(states, self._num_states, rng)
            thinned += drawn
            most = max(most, len(states.mass))
            decisions += float(states.mass.sum())
            states, done = self._advanced(index, states)
            solved += done
            if not len(states.mass):
                break

        # For the states that are left time is up; goals that they have visited count.
        late = float(states.mass @ states.visited.sum(1)) / int(maze.num_goals)
        down = float(states.mass[states.before == end_points.DOWN].sum())
        return Prediction(
            maze=name,
            success=solved + late,
            solved=solved,
            decisions=decisions,
            down=down,
            thinned=thinned,
            num_states=most,
        )

    def _starts(self, index: int) -> _States:
        """Returns the distribution of an episode's first state."""
        table = self._env.table
        num_starts, num_doors = int(table.num_starts[index]), int(table.num_doors[index])
        starts = np.asarray(table.start_ij[index])[:num_starts]
        doors = np.asarray(table.door_ij[index])[:num_doors]
        jitter = float(table.mazes.start_jitter[index])

        # Midpoints of equal intervals on each axis stand for all offsets.
        middles = (2 * np.arange(_NUM_OFFSETS) + 1) / _NUM_OFFSETS - 1
        middles = jitter * middles if jitter else np.zeros(1)
        offsets = np.stack(np.meshgrid(middles, middles), -1).reshape(-1, 2)

        places, door_of, mass = [], [], []
        for door in doors:
            # No start is a goal, see `task.start`.
            free = starts[(starts != door[None]).any(1)]
            centres = np.asarray(jax.vmap(maze_lib.cell_xy)(jnp.asarray(free)))
            places.append((centres[:, None] + offsets[None]).reshape(-1, 2))
            num = len(places[-1])
            door_of.append(np.repeat(door[None], num, 0))
            mass.append(np.full(num, 1.0 / (num_doors * num)))

        num = sum(map(len, mass))
        shape = table.codes.shape[1:] if self._view.has_map else (0, 0)
        states = _States(
            door_ij=np.concatenate(door_of).astype(np.int32),
            visited=np.zeros((num, maze_lib.MAX_GOALS), bool),
            seen=np.zeros((num, *shape), bool),
            xy=np.concatenate(places).astype(np.float32),
            before=np.full(num, end_points.REST, np.int32),
            mass=np.concatenate(mass),
        )
        return self._merged(self._seeing(index, states))

    def _seeing(self, index: int, states: _States) -> _States:
        """Returns states at an episode's beginning, what is in sight added to their maps."""
        if not self._view.has_map:
            return states

        return states._replace(
            seen=np.asarray(self._look(jnp.int32(index), states.door_ij, states.xy))
        )

    def _look_one(
        self, maze: Int[Array, ""], door_ij: Int[Array, "2"], xy: Float[Array, "2"]
    ) -> Bool[Array, "H W"]:
        """Returns which cells are seen at the beginning of an episode."""
        nav = _navigation(maze, door_ij, jnp.zeros(maze_lib.MAX_GOALS, bool), None)
        return jnp.asarray(task.look(self._env.table, nav, xy, self._view).seen)

    def _advanced(self, index: int, states: _States) -> tuple[_States, float]:
        """Returns the states after one more decision, and the probability of being solved by it."""
        solved, parts = 0.0, []
        for first in range(0, len(states.mass), _CHUNK):
            chunk = states.at(np.arange(first, min(first + _CHUNK, len(states.mass))))
            # Padded to one shape, so that one program serves all chunks.
            filled = [np.resize(column, (_CHUNK, *column.shape[1:])) for column in chunk[:-1]]
            successors = jax.device_get(self._follow(self._law, jnp.int32(index), *filled))

            num = int(np.prod(successors[0].shape[1:]))  # successors of each state
            weight, visited, seen, xy, before, is_solved = (
                leaf[: len(chunk.mass)].reshape(len(chunk.mass) * num, *leaf.shape[3:])
                for leaf in successors
            )
            mass = np.repeat(chunk.mass, num) * weight
            solved += float(mass[is_solved].sum())
            door_ij = np.repeat(chunk.door_ij, num, 0)
            goes_on = np.flatnonzero((mass > 0.0) & ~is_solved)
            parts.append(_States(door_ij, visited, seen, xy, before, mass).at(goes_on))

        joined = _States(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        return self._merged(joined) if len(joined.mass) else joined, solved

    def _follow_one(
        self,
        law: end_law.Law,
        maze: Int[Array, ""],
        door_ij: Int[Array, "2"],
        visited: Bool[Array, "9"],
        seen: Bool[Array, "H W"],
        xy: Float[Array, "2"],
        before: Int[Array, ""],
    ) -> tuple[Array, ...]:
        """Returns a state's successors.

        Returns:
          Their probabilities [D, K], and what `_end` returns with leading axes [D, K]: D
          directions, 1 for a deterministic high level, and K end points.
        """
        nav = _navigation(maze, door_ij, visited, seen if self._view.has_map else None)
        probabilities = self._probabilities(nav, xy)
        num_directions = 1 if self._high.is_certain else base.NUM_DIRECTIONS
        directions = jax.lax.top_k(probabilities, num_directions)[1]
        # After standing still or lying, the condition is the same for all directions.
        others = np.repeat([[end_points.REST], [end_points.DOWN]], base.NUM_DIRECTIONS, 1)
        kinds = np.concatenate([end_points.turns(), others])

        def follow(direction: Int[Array, ""]) -> tuple[Array, ...]:
            row = jax.tree.map(lambda table: table[jnp.asarray(kinds)[before, direction]], law)
            end = jax.vmap(self._end, in_axes=(None, None, None, None, 0, 0, 0))
            places = end(nav, xy, before, direction, row.along, row.lateral, row.is_down)
            return probabilities[direction] * row.weight, *places

        return jax.vmap(follow)(directions)

    def _end(
        self,
        nav: task.Navigation,
        xy: Float[Array, "2"],
        before: Int[Array, ""],
        direction: Int[Array, ""],
        along: Float[Array, ""],
        lateral: Float[Array, ""],
        is_down: Bool[Array, ""],
    ) -> tuple[Array, ...]:
        """Returns visited, seen, xy and before after one displacement, and whether it is solved."""
        origin = task.anchor(xy) if self._env.movement.anchored else xy
        way = rotations.to_world_frame(jnp.stack([along, lateral]), direction)
        path_xy = self._env.move(nav, xy, origin + way - xy)
        after, outcome = task.advance(self._env.table, nav, path_xy)
        after = task.look(self._env.table, after, path_xy[-1], self._view)

        stood = jnp.where(before == end_points.DOWN, end_points.REST, direction)
        following = jnp.where(is_down, end_points.DOWN, stood)
        known = jnp.zeros((0, 0), bool) if after.seen is None else after.seen
        return after.visited, known, path_xy[-1], following, outcome.terminated

    def _probabilities(self, nav: task.Navigation, xy: Float[Array, "2"]) -> Float[Array, "4"]:
        """Returns the probability of each direction, averaged over postures."""

        def of_posture(posture: Int[Array, ""]) -> Float[Array, "4"]:
            inner = oracle_maze.OracleMazeState(
                nav=nav, xy=xy, posture=posture, total_reward=jnp.float32(0.0)
            )
            return self._high.probabilities(self._env.observe(inner))

        return jax.vmap(of_posture)(self._postures).mean(0)

    def _merged(self, states: _States) -> _States:
        """Merges states in the same square that agree in all else, at their mean position."""
        squares = np.floor(states.xy / self._pitch).astype(np.int32)
        columns = (
            states.door_ij,
            squares,
            states.before[:, None],
            np.packbits(states.visited, axis=1),
            np.packbits(
                states.seen.reshape(len(states.mass), math.prod(states.seen.shape[1:])), axis=1
            ),
        )
        keys = np.concatenate([np.ascontiguousarray(c).view(np.uint8) for c in columns], axis=1)
        rows = np.ascontiguousarray(keys).view(np.dtype((np.void, keys.shape[1]))).ravel()
        _, first, group = np.unique(rows, return_index=True, return_inverse=True)

        mass = np.bincount(group, states.mass, len(first))
        xy = [np.bincount(group, states.mass * axis, len(first)) / mass for axis in states.xy.T]
        kept = states.at(first)
        return kept._replace(mass=mass, xy=np.stack(xy, -1).astype(np.float32))


def _navigation(
    maze: Int[Array, ""],
    door_ij: Int[Array, "2"],
    visited: Bool[Array, "9"],
    seen: Bool[Array, "H W"] | None,
) -> task.Navigation:
    """Returns the state of an episode's task; decisions are counted elsewhere."""
    zero = jnp.int32(0)
    return task.Navigation(
        maze=maze,
        door_ij=door_ij,
        visited=visited,
        decisions=zero,
        start_ij=jnp.stack([zero, zero]),
        seen=seen,
    )


def _thinned(states: _States, num: int, rng: np.random.Generator) -> tuple[_States, float]:
    """Resamples states so that at most `num` remain; also returns the mass of those resampled.

    States above a threshold stay as they are. Those below are kept with a probability proportional
    to their mass, and then have the threshold's: so expectations stay unbiased.

    Source: Fearnhead and Clifford 2003, "On-line inference for hidden Markov models via particle
      filters", Sec. 3.2.
    """
    mass = states.mass
    if len(mass) <= num:
        return states, 0.0

    # The threshold c at which the sum of min(mass / c, 1) is `num`: the n largest are kept.
    order = np.argsort(-mass)
    rest = np.cumsum(mass[order][::-1])[::-1]  # of each and all smaller ones
    is_below = mass[order] * (num - np.arange(len(mass))) <= rest
    n = int(np.argmax(is_below))
    below, threshold = order[n:], rest[n] / (num - n)

    # Systematic resampling (Kitagawa 1996): evenly spaced marks on the cumulative mass.
    marks = (rng.random() + np.arange(num - n)) * threshold
    ends = np.cumsum(mass[below])
    chosen = below[np.minimum(np.searchsorted(ends, marks, side="right"), len(below) - 1)]
    kept = states.at(np.concatenate([order[:n], chosen]))
    kept.mass[n:] = threshold
    return kept, float(rest[n])
