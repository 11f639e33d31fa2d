"""What HIGL learns in a round: the controller, the manager, what is near what, and what is new."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines.higl import adjacency, landmarks, novelty, relabelling, td3
from eihrl_jax.config import higl as config_lib

NUM_SUBGOAL = 2
"""A subgoal is a displacement of the torso in x and y, units."""

_ROWS_AT_ONCE = 32
"""Stored subgoals that are corrected together: what stays in the caches is twice as fast."""


class Learned(struct.PyTreeNode):
    """All that is learned.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      places: what is adjacent to what.
      novelty: the most novel places, and what tells them.
    """

    manager: td3.Td3State
    controller: td3.Td3State
    places: adjacency.AdjacencyState
    novelty: novelty.NoveltyState


class ControlRow(struct.PyTreeNode):
    """A stored control step. F: size of what is seen, A: of the action.

    Attributes:
      obs: float32 [F], before the step; its first two entries are x and y, units.
      subgoal: float32 [2], the displacement that was left before the step, units.
      action: float32 [A].
      reward: float32, minus the distance that is left after the step, units.
      next_obs: float32 [F].
      is_end: whether the episode ended.
      is_running: whether the step counts.
    """

    obs: Float[Array, " F"]
    subgoal: Float[Array, "2"]
    action: Float[Array, " A"]
    reward: Float[Array, ""]
    next_obs: Float[Array, " F"]
    is_end: Bool[Array, ""]
    is_running: Bool[Array, ""]


class Learning:
    """The functions that learn; holds no state."""

    def __init__(
        self,
        num_seen: int,
        num_actions: int,
        side_xy: tuple[int, int],
        options: config_lib.HiglConfig,
    ):
        """Builds networks and optimisers.

        Args:
          num_seen: size F of what both levels see.
          num_actions: size A of the controller's action.
          side_xy: the arena's sides, units.
          options: of the run.

        Raises:
          base.UserError: the arena is too large for a table of adjacent places.
        """
        self.options = options
        self.manager = td3.Td3(num_seen + 2, NUM_SUBGOAL, options.manager)
        self.controller = td3.Td3(num_seen, num_actions, options.controller)
        num_columns, num_rows = side_xy if options.guidance != "none" else (1, 1)
        self._adjacency = adjacency.AdjacencyNetwork(num_rows, num_columns, options.adjacency)
        self._novelty = novelty.Novelty(num_seen, options.landmarks)
        self._planner = landmarks.Planner(self.controller, options.landmarks)

    def init(self, key: Key[Array, ""]) -> Learned:
        """Draws all parameters."""
        manager_key, controller_key, places_key, novelty_key = jax.random.split(key, 4)
        return Learned(
            manager=self.manager.init(manager_key),
            controller=self.controller.init(controller_key),
            places=self._adjacency.init(places_key),
            novelty=self._novelty.init(novelty_key),
        )

    def visit(self, learned: Learned, steps: ControlRow) -> Learned:
        """Notes where N robots were after T control steps in a row; leading axes [T, N]."""
        places, new = learned.places, learned.novelty
        if self.options.guidance != "none":
            path_xy = steps.next_obs[..., :2]
            places = self._adjacency.mark(places, path_xy, steps.is_running, steps.is_end)
        if self.options.guidance == "landmarks":
            obs = steps.next_obs.reshape(-1, steps.next_obs.shape[-1])
            new = self._novelty.visit(new, obs, steps.is_running.reshape(-1))
        return learned.replace(places=places, novelty=new)

    def learn(
        self,
        learned: Learned,
        memory: replay.Replay,
        high_memory: replay.Replay,
        has_landmarks: Bool[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[Learned, dict[str, Float[Array, ""]]]:
        """Updates both levels, and what tells novelty, a round's number of times.

        Args:
          learned: what is learned so far.
          memory: `ControlRow`s.
          high_memory: `relabelling.SubgoalRow`s.
          has_landmarks: whether landmarks lead the manager already.
          key: consumed.

        Returns:
          What is learned now, and means of what the learners tell.
        """
        low_key, high_key, new_key = jax.random.split(key, 3)
        controller, low_metrics = self._learn_controller(learned.controller, memory, low_key)
        learned = learned.replace(controller=controller)
        manager, high_metrics = self._learn_manager(
            learned, memory, high_memory, has_landmarks, high_key
        )
        learned = learned.replace(manager=manager)
        metrics = {f"controller/{name}": value.mean() for name, value in low_metrics.items()}
        metrics |= {f"manager/{name}": value.mean() for name, value in high_metrics.items()}
        if self.options.guidance == "landmarks":
            shape = self.options.num_updates, self.options.controller.batch_size
            obs = replay.sample(memory, shape, new_key).next_obs
            new, losses = jax.lax.scan(self._novelty.update, learned.novelty, obs)
            learned = learned.replace(novelty=new)
            metrics["novelty_loss"] = losses.mean()
        return learned, metrics

    def fit_places(
        self, learned: Learned, is_due: Bool[Array, ""], key: Key[Array, ""]
    ) -> tuple[Learned, Float[Array, ""]]:
        """Fits the adjacency network where that is due; returns the last loss, else NaN."""
        places, loss = jax.lax.cond(
            is_due,
            lambda places: self._adjacency.fit(places, key),
            lambda places: (places, jnp.float32(jnp.nan)),
            learned.places,
        )
        return learned.replace(places=places), loss

    def _learn_controller(
        self, controller: td3.Td3State, memory: replay.Replay, key: Key[Array, ""]
    ) -> tuple[td3.Td3State, dict[str, Float[Array, " U"]]]:
        draw_key, update_key = jax.random.split(key)
        count = self.options.num_updates
        # Drawn at once, outside the loop over updates: XLA would copy the memory into that loop.
        rows = replay.sample(memory, (count, self.options.controller.batch_size), draw_key)

        def body(
            state: td3.Td3State, xs: tuple[ControlRow, Key[Array, ""]]
        ) -> tuple[td3.Td3State, dict[str, Array]]:
            row, key = xs
            weight = row.is_running.astype(jnp.float32)
            return self.controller.update(state, self.control_transition(row), weight, key)

        return jax.lax.scan(body, controller, (rows, jax.random.split(update_key, count)))

    def control_transition(self, row: ControlRow) -> base.Transition:
        """Returns what the controller learns from stored control steps, leading axes any."""
        moved = row.next_obs[..., :2] - row.obs[..., :2]
        ends = row.is_end if self.options.is_limit_terminal else jnp.zeros_like(row.is_end)
        return base.Transition(
            obs=landmarks.controller_features(row.obs, row.subgoal),
            action=row.action,
            reward=row.reward,
            discount=self.options.controller.gamma * (1.0 - ends.astype(jnp.float32)),
            next_obs=landmarks.controller_features(row.next_obs, row.subgoal - moved),
        )

    def _learn_manager(
        self,
        learned: Learned,
        memory: replay.Replay,
        high_memory: replay.Replay,
        has_landmarks: Bool[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[td3.Td3State, dict[str, Float[Array, " U"]]]:
        pool_key, draw_key, update_key = jax.random.split(key, 3)
        count, size = self.options.num_high_updates, self.options.manager.batch_size
        rows = replay.sample(high_memory, (count, size), draw_key)
        pools, graph, ways = None, None, None
        if self.options.guidance == "landmarks":
            num = self.options.landmarks.pool
            if self.options.landmarks.per_update:
                pools = replay.sample(memory, (count, num), pool_key).obs
            else:
                pool = replay.sample(memory, (num,), pool_key).obs
                graph, ways = self._map(learned, pool, rows.goal_xy)

        def body(
            state: td3.Td3State,
            xs: tuple[relabelling.SubgoalRow, Array | None, Array | None, Key[Array, ""]],
        ) -> tuple[td3.Td3State, dict[str, Array]]:
            row, pool, ways, key = xs
            correct_key, noise_key = jax.random.split(key)
            batch = self.subgoal_transition(learned.controller, row, correct_key)
            weight = row.is_running[:, 0].astype(jnp.float32)
            penalty = None
            if self.options.guidance != "none":
                lead = graph, ways
                if pool is not None:
                    lead = self._map(learned, pool, row.goal_xy)
                ahead_xy = self._ahead(learned, *lead, row, has_landmarks)
                penalty = self._penalty(learned.places.params, row.obs[:, 0, :2], ahead_xy)
            return self.manager.update(state, batch, weight, noise_key, penalty)

        keys = jax.random.split(update_key, count)
        return jax.lax.scan(body, learned.manager, (rows, pools, ways, keys))

    def _map(
        self, learned: Learned, pool: Float[Array, "P F"], goal_xy: Float[Array, "*B 2"]
    ) -> tuple[landmarks.Graph, Float[Array, "*B L"]]:
        """Returns the landmarks that are chosen from a pool, and their ways to goals."""
        graph = self._planner.graph(learned.controller, pool, learned.novelty)
        ways = self._planner.ways(learned.controller, graph, goal_xy.reshape(-1, 2))
        return graph, ways.reshape(*goal_xy.shape[:-1], -1)

    def subgoal_transition(
        self, controller: td3.Td3State, row: relabelling.SubgoalRow, key: Key[Array, ""]
    ) -> base.Transition:
        """Returns what the manager learns from a batch of stored subgoals, corrected."""

        def act(seen: Float[Array, "*B F"], left: Float[Array, "*B 2"]) -> Float[Array, "*B A"]:
            features = landmarks.controller_features(seen, left)
            return self.controller.act(controller.actor_params, features)

        def correct(xs: tuple[relabelling.SubgoalRow, Key[Array, ""]]) -> Float[Array, "2"]:
            row, key = xs
            reach, num = self.options.manager.reach, self.options.num_candidates
            return relabelling.correct(row, act, reach, num, key)

        keys = jax.random.split(key, row.reward.shape[0])
        action = jax.lax.map(correct, (row, keys), batch_size=_ROWS_AT_ONCE)
        ends = row.terminated
        if self.options.is_limit_terminal:
            ends = ends | row.truncated
        return base.Transition(
            obs=jnp.concatenate([row.obs[:, 0], row.goal_xy], axis=-1),
            action=action,
            reward=self.options.reward_scale * row.reward,
            discount=self.options.manager.gamma * (1.0 - ends.astype(jnp.float32)),
            next_obs=jnp.concatenate([row.next_obs, row.next_goal_xy], axis=-1),
        )

    def _ahead(
        self,
        learned: Learned,
        graph: landmarks.Graph | None,
        ways: Float[Array, "B L"] | None,
        row: relabelling.SubgoalRow,
        has_landmarks: Bool[Array, ""],
    ) -> Float[Array, "B 2"]:
        """Returns the places that subgoals are held to: a step towards the landmark, or here."""
        here_xy = row.obs[:, 0, :2]
        if graph is None or ways is None:
            return here_xy
        seen, goal_xy = row.obs[:, 0], row.goal_xy
        target_xy = jax.lax.cond(
            has_landmarks,
            lambda: self._planner.plan(learned.controller, graph, seen, goal_xy, ways),
            lambda: here_xy,
        )
        way = target_xy - here_xy
        length = jnp.sqrt(jnp.square(way).sum(-1, keepdims=True))
        step = self.options.landmark_distance * way / jnp.maximum(length, 1e-6)
        return here_xy + step

    def _penalty(
        self, params: Any, here_xy: Float[Array, "B 2"], ahead_xy: Float[Array, "B 2"]
    ) -> td3.Penalty:
        """Returns what holds the manager's subgoals near to the places `ahead_xy`."""

        def penalty(subgoal: Float[Array, "B 2"]) -> Float[Array, ""]:
            excess = self._adjacency.excess(params, ahead_xy, here_xy + subgoal)
            return self.options.guidance_weight * excess.mean()

        return penalty
