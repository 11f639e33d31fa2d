"""HIGL's planner: a graph of landmarks, measured by the controller's values, leads to the goal.

Kim et al. 2021, Landmark-guided subgoal generation in hierarchical reinforcement learning, Sec. 4.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from eihrl_jax.baselines.actor_critic import ActorCriticState
from eihrl_jax.baselines.higl import novelty, td3
from eihrl_jax.config import higl as config_lib
from eihrl_jax.ops import landmarks as ops

_PLACES_AT_ONCE = 16
"""Places that are planned for together; divides the batches of most options."""


class Graph(struct.PyTreeNode):
    """Landmarks and the ways between them. L landmarks.

    Attributes:
      obs: float32 [L, F], what was seen there; its first two entries are x and y, units.
      is_valid: bool [L], whether it is one.
      paths: float32 [L, L], values of the best ways, about minus their lengths.
    """

    obs: Float[Array, "L F"]
    is_valid: Bool[Array, " L"]
    paths: Float[Array, "L L"]


@dataclasses.dataclass(frozen=True)
class Planner:
    """The functions of the planner; holds no state.

    Attributes:
      level: the lower level, whose values measure distances.
      controller: what it has learned.
      options: sizes and numbers.
    """

    level: td3.Td3
    controller: ActorCriticState
    options: config_lib.Landmarks

    def graph(
        self,
        pool: Float[Array, "P F"],
        novel: novelty.NoveltyState,
    ) -> Graph:
        """Chooses landmarks and finds the ways between them.

        Args:
          pool: what was seen in stored steps.
          novel: the most novel places.
        """
        # Kim et al. 2021, Sec. 4.1 and 4.2: landmarks that cover what was visited, and novel ones,
        # of which there may not be as many yet as there is room for.
        num_coverage = self.options.num_coverage
        spread = ops.farthest_points(pool[:, :2], num_coverage)
        obs = jnp.concatenate([pool[spread], novel.obs])
        is_valid = jnp.concatenate([jnp.ones(num_coverage, bool), jnp.isfinite(novel.score)])

        # Every landmark is a target of every other one; cuts leave the near ones.
        targets = jnp.broadcast_to(obs[None, :, :2], (obs.shape[0], *obs[:, :2].shape))
        values = self._values(obs, targets)
        both = is_valid[:, None] & is_valid[None]
        values = jnp.where(both, values, ops.UNREACHABLE)
        edges = ops.cut_edges(values, self.options.cutoff, jnp.arange(obs.shape[0]))
        paths = ops.soft_paths(edges, self.options.heat, self.options.rounds)
        return Graph(obs=obs, is_valid=is_valid, paths=paths)

    def ways(self, graph: Graph, goal_xy: Float[Array, "B 2"]) -> Float[Array, "B L"]:
        """Returns the value of the best way from each landmark to each goal.

        Each distinct goal is measured once: a maze's few goals come again and again.

        Args:
          graph: the landmarks.
          goal_xy: goals, units.
        """
        num_landmarks = graph.obs.shape[0]
        goals, index = jnp.unique(goal_xy, axis=0, size=goal_xy.shape[0], return_inverse=True)

        def measure(number: Int[Array, ""], ways: Float[Array, "B L"]) -> Float[Array, "B L"]:
            targets = jnp.broadcast_to(goals[number], (num_landmarks, 1, 2))
            values = self._values(graph.obs, targets)
            values = jnp.where(graph.is_valid[:, None], values, ops.UNREACHABLE)
            edges = ops.cut_edges(values, self.options.cutoff)
            # Joined once, at last; in the released code the goal takes part in every doubling.
            joined = ops.soft_join(graph.paths, edges, self.options.heat)
            return ways.at[number].set(joined[:, 0])

        # `unique` fills its list up to a fixed size: only the distinct goals are measured.
        nothing = jnp.zeros((goal_xy.shape[0], num_landmarks))
        return jax.lax.fori_loop(0, index.max() + 1, measure, nothing)[index]

    def plan(
        self,
        graph: Graph,
        obs: Float[Array, "B F"],
        goal_xy: Float[Array, "B 2"],
        ways: Float[Array, "B L"],
    ) -> Float[Array, "B 2"]:
        """Returns where to go from each place on the way to its goal: a landmark, or the goal.

        Args:
          graph: the landmarks.
          obs: what is seen at the places.
          goal_xy: each place's goal, units.
          ways: from each landmark to the place's goal, see `ways`.
        """
        # The first landmark is one of the nearest ones, so that few values have to be computed.
        xy, landmark_xy = obs[:, :2], graph.obs[:, :2]
        apart = jnp.square(landmark_xy[None] - xy[:, None]).sum(-1)
        apart = jnp.where(graph.is_valid[None], apart, jnp.inf)
        num_first = min(self.options.num_first, landmark_xy.shape[0])
        near = jax.lax.top_k(-apart, num_first)[1]

        targets = jnp.concatenate([landmark_xy[near], goal_xy[:, None]], axis=1)
        first = self._values(obs, targets)
        cut = first + jnp.where(first < self.options.cutoff, ops.UNREACHABLE, 0.0)

        # The best path to the goal begins with the landmark of the best score.
        score = cut[:, :-1] + jnp.take_along_axis(ways, near, axis=1)
        # Where there are few landmarks, some of the nearest places are none.
        score = jnp.where(graph.is_valid[near], score, -jnp.inf)
        best = jnp.argmax(score, axis=1, keepdims=True)
        chosen = landmark_xy[jnp.take_along_axis(near, best, axis=1)[:, 0]]

        # A goal beyond the cutoff isn't near, whatever `near` is: its value has been cut.
        is_near = cut[:, -1] > self.options.near
        return jnp.where(is_near[:, None], goal_xy, chosen)

    def lead(
        self,
        novel: novelty.NoveltyState,
        pools: Float[Array, "G P F"],
        obs: Float[Array, "U B F"],
        goal_xy: Float[Array, "U B 2"],
    ) -> Float[Array, "U B 2"]:
        """Does for U batches what `plan` does for one, with a graph for every U / G of them.

        Args:
          novel: the most novel places.
          pools: what was seen in stored steps, for each graph.
          obs: what is seen at the places.
          goal_xy: each place's goal, units.
        """

        def lead_with(xs: tuple[Array, Array, Array]) -> Float[Array, "V B 2"]:
            pool, obs, goal_xy = xs
            graph = self.graph(pool, novel)
            ways = self.ways(graph, goal_xy.reshape(-1, 2))

            # A few at a time: what the targets of all places need at once leaves the caches.
            places = obs.reshape(-1, obs.shape[-1]), goal_xy.reshape(-1, 2), ways
            size = math.gcd(ways.shape[0], _PLACES_AT_ONCE)
            places = jax.tree.map(lambda leaf: leaf.reshape(-1, size, leaf.shape[-1]), places)
            planned = jax.lax.map(lambda xs: self.plan(graph, *xs), places)
            return planned.reshape(goal_xy.shape)

        shared = jax.tree.map(
            lambda leaf: leaf.reshape(pools.shape[0], -1, *leaf.shape[1:]), (obs, goal_xy)
        )
        return jax.lax.map(lead_with, (pools, *shared)).reshape(goal_xy.shape)

    def _values(
        self,
        obs: Float[Array, "B F"],
        target_xy: Float[Array, "B T 2"],
    ) -> Float[Array, "B T"]:
        """Returns the value of going from each place to each of its targets, at most 0."""
        left = target_xy - obs[:, None, :2]
        seen = jnp.broadcast_to(obs[:, None], (*left.shape[:2], obs.shape[-1]))
        features = controller_features(seen, left)
        action = self.level.act(self.controller.actor.params, features)
        values = self.level.values(self.controller.critics.params, features, action)
        # Critics may promise more than 0, but no way is shorter than none.
        return jnp.minimum(values.min(0), 0.0)


def controller_features(
    seen: Float[Array, "*B F"], left: Float[Array, "*B 2"]
) -> Float[Array, "*B F"]:
    """Returns the controller's input: the displacement left takes the place of x and y."""
    return jnp.concatenate([seen[..., 2:], left], axis=-1)
