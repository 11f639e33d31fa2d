"""What HIGL learns in a round: controller, manager, adjacency network and novelty."""

import functools

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation, replay
from eihrl_jax.baselines.actor_critic import ActorCriticState, Metrics
from eihrl_jax.baselines.higl import adjacency, landmarks, novelty, relabelling, td3
from eihrl_jax.baselines.world import World
from eihrl_jax.config import higl as config_lib

NUM_SUBGOAL = 2
"""A subgoal is a displacement of the torso in x and y, units."""

_ROWS_AT_ONCE = 4
"""Stored subgoals that are corrected together, by 480 passes: what leaves a core's caches is slow.

By 32 at once they took 2.6 times as long on one core, by 8 1.5 times, one by one 1.04 times.
"""


class Learned(struct.PyTreeNode):
    """All that is learned.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      places: what is adjacent to what.
      novelty: the most novel places, and the networks that measure novelty.
    """

    manager: ActorCriticState
    controller: ActorCriticState
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


class HiglState(struct.PyTreeNode):
    """Everything needed to resume a run. N: number of environments.

    Attributes:
      learned: both levels, what is near what, and what is new.
      low_replay: `ControlRow`s.
      high_replay: `relabelling.SubgoalRow`s.
      envs: environments with leading axis N.
      key: of what comes next.
      num_steps: int32, control steps of all environments so far.
    """

    learned: Learned
    low_replay: replay.Replay
    high_replay: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    num_steps: Int[Array, ""]


class Learning:
    """The functions that learn; holds no state.

    Attributes:
      manager: the upper level.
      controller: the lower level.
    """

    def __init__(self, num_seen: int, world: World, options: config_lib.HiglConfig):
        """Builds networks and optimisers.

        Args:
          num_seen: size F of what both levels see.
          world: where the robots act.
          options: of the run.

        Raises:
          base.UserError: the arena is too large for a table of adjacent places.
        """
        self._options, self._world = options, world
        self.manager = td3.Td3(num_seen + 2, NUM_SUBGOAL, options.manager)
        self.controller = td3.Td3(num_seen, world.num_actions, options.controller)
        # HIRO needs no table: for it the arena is one square, however large it is.
        num_columns, num_rows = world.side_xy if options.guidance != "none" else (1, 1)
        self._adjacency = adjacency.AdjacencyNetwork(num_rows, num_columns, options.adjacency)
        self._novelty = novelty.Novelty(num_seen, options.landmarks)

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
        if self._options.guidance != "none":
            path_xy = steps.next_obs[..., :2]
            places = self._adjacency.mark(places, path_xy, steps.is_running, steps.is_end)
        if self._options.guidance == "landmarks":
            obs = steps.next_obs.reshape(-1, steps.next_obs.shape[-1])
            new = self._novelty.visit(new, obs, steps.is_running.reshape(-1))
        return learned.replace(places=places, novelty=new)

    def learn(self, state: HiglState, key: Key[Array, ""]) -> tuple[Learned, Metrics]:
        """Updates both levels and the novelty network, a round's number of times.

        Returns:
          What is learned now, and means of what the learners tell.
        """
        low_key, high_key, new_key = jax.random.split(key, 3)
        controller, low_metrics = self._learn_controller(state, low_key)
        # The manager learns with the controller of now.
        learned = state.learned.replace(controller=controller)
        manager, high_metrics = self._learn_manager(state.replace(learned=learned), high_key)
        learned = learned.replace(manager=manager)
        metrics = optimisation.means("controller", low_metrics)
        metrics |= optimisation.means("manager", high_metrics)

        if self._options.guidance == "landmarks":
            shape = self._options.num_updates, self._options.controller.batch_size
            # Steps of rest are among them: they are no visits, but novelty is learned from them.
            obs = self._world.draw(state.low_replay, shape, new_key).next_obs
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

    def control_transition(self, row: ControlRow) -> base.Transition:
        """Returns what the controller learns from stored control steps, leading axes any."""
        moved = row.next_obs[..., :2] - row.obs[..., :2]
        # The controller's own task outlasts the episode; in the released code it ends with it.
        ends = row.is_end if self._options.is_limit_terminal else jnp.zeros_like(row.is_end)
        return base.Transition(
            obs=landmarks.controller_features(row.obs, row.subgoal),
            action=row.action,
            reward=row.reward,
            discount=self._options.controller.gamma * (1.0 - ends.astype(jnp.float32)),
            next_obs=landmarks.controller_features(row.next_obs, row.subgoal - moved),
        )

    def subgoal_transition(
        self,
        controller: ActorCriticState,
        row: relabelling.SubgoalRow,
        key: Key[Array, ""],
    ) -> base.Transition:
        """Returns what the manager learns from a batch of stored subgoals, corrected."""

        def act(seen: Float[Array, "*B F"], left: Float[Array, "*B 2"]) -> Float[Array, "*B A"]:
            features = landmarks.controller_features(seen, left)
            return self.controller.act(controller.actor.params, features)

        def correct(xs: tuple[relabelling.SubgoalRow, Key[Array, ""]]) -> Float[Array, "2"]:
            row, key = xs
            reach, num = self._options.manager.reach, self._options.num_candidates
            return relabelling.correct(row, act, reach, num, key)

        # Corrected at every draw: the controller has changed again since the last one.
        keys = jax.random.split(key, row.reward.shape[0])
        one_by_one = functools.partial(jax.lax.map, correct, batch_size=_ROWS_AT_ONCE)
        action = self._world.on_each_device(one_by_one)((row, keys))
        ends = row.terminated | (row.truncated & self._options.is_limit_terminal)
        return base.Transition(
            obs=jnp.concatenate([row.obs[:, 0], row.goal_xy], axis=-1),
            action=action,
            reward=self._options.reward_scale * row.reward,
            discount=self._options.manager.gamma * (1.0 - ends.astype(jnp.float32)),
            next_obs=jnp.concatenate([row.next_obs, row.next_goal_xy], axis=-1),
        )

    def _learn_controller(
        self, state: HiglState, key: Key[Array, ""]
    ) -> tuple[ActorCriticState, dict[str, Float[Array, " U"]]]:
        draw_key, update_key = jax.random.split(key)
        shape = self._options.num_updates, self._options.controller.batch_size
        rows = self._world.draw(state.low_replay, shape, draw_key)

        def update(
            controller: ActorCriticState, row: ControlRow, key: Key[Array, ""]
        ) -> tuple[ActorCriticState, Metrics]:
            weight = row.is_running.astype(jnp.float32)
            return self.controller.update(controller, self.control_transition(row), weight, key)

        return optimisation.loop(update, state.learned.controller, rows, update_key)

    def _learn_manager(
        self, state: HiglState, key: Key[Array, ""]
    ) -> tuple[ActorCriticState, dict[str, Float[Array, " U"]]]:
        pool_key, draw_key, update_key = jax.random.split(key, 3)
        shape = self._options.num_high_updates, self._options.manager.batch_size
        rows = self._world.draw(state.high_replay, shape, draw_key)
        learned, ahead_xy = state.learned, self._ahead(state, rows, pool_key)

        def update(
            manager: ActorCriticState,
            xs: tuple[relabelling.SubgoalRow, Float[Array, "B 2"]],
            key: Key[Array, ""],
        ) -> tuple[ActorCriticState, Metrics]:
            row, ahead_xy = xs
            correct_key, noise_key = jax.random.split(key)
            batch = self.subgoal_transition(learned.controller, row, correct_key)
            # A subgoal counts if its first step does: the episode may have ended on the way.
            weight = row.is_running[:, 0].astype(jnp.float32)
            penalty = self._penalty(learned.places, row.obs[:, 0, :2], ahead_xy)
            return self.manager.update(manager, batch, weight, noise_key, penalty)

        return optimisation.loop(update, learned.manager, (rows, ahead_xy), update_key)

    def _ahead(
        self, state: HiglState, rows: relabelling.SubgoalRow, key: Key[Array, ""]
    ) -> Float[Array, "U B 2"]:
        """Returns the places that subgoals are held to: a step towards the landmark, or here.

        They hang on the controller, which rests while the manager learns, so that they are known
        before its first update.
        """
        options, here_xy = self._options.landmarks, rows.obs[:, :, 0, :2]
        if self._options.guidance != "landmarks":
            return here_xy

        def lead() -> Float[Array, "U B 2"]:
            # One graph serves a round, where the released code makes one for every update.
            num_pools = rows.goal_xy.shape[0] if options.per_update else 1
            pools = replay.sample(state.low_replay, (num_pools, options.pool), key).obs
            planner = landmarks.Planner(self.controller, state.learned.controller, options)
            novel, seen = state.learned.novelty, rows.obs[:, :, 0]
            way = planner.lead(novel, pools, seen, rows.goal_xy) - here_xy
            # Only the direction counts, for a step of fixed length; a landmark right here has none.
            length = jnp.sqrt(jnp.square(way).sum(-1, keepdims=True))
            return here_xy + self._options.landmark_distance * way / jnp.maximum(length, 1e-6)

        # Before the first landmark subgoals are held as HRAC's are, to what is adjacent to here.
        return jax.lax.cond(state.num_steps >= options.first_step, lead, lambda: here_xy)

    def _penalty(
        self,
        places: adjacency.AdjacencyState,
        here_xy: Float[Array, "B 2"],
        ahead_xy: Float[Array, "B 2"],
    ) -> td3.Penalty | None:
        """Returns what holds the manager's subgoals near to the places `ahead_xy`, if anything."""
        if self._options.guidance == "none":
            return None

        def penalty(subgoal: Float[Array, "B 2"]) -> Float[Array, ""]:
            excess = self._adjacency.excess(places.network.params, ahead_xy, here_xy + subgoal)
            return self._options.guidance_weight * excess.mean()

        return penalty
