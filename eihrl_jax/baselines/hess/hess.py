"""HESS as a whole: a round is one episode in every environment, and what is learned from it."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.hess import episodes as episodes_lib
from eihrl_jax.baselines.hess import exploration, learning, representation
from eihrl_jax.config import hess as config_lib

Policy = dict[str, base.Params]
"""What acts: parameters of `manager`, `controller` and `representation`."""

_RECENT = 0.2
"""Weight of the last round in means of recent rounds."""


class HessState(struct.PyTreeNode):
    """All that a run needs to go on. N: number of environments.

    Attributes:
      learned: both levels and the subgoal space.
      squares: what is known about places in it.
      episodes: the memory of whole episodes.
      high_memory: `learning.SubgoalRow`s.
      envs: environments with leading axis N.
      key: of what comes next.
      success: float32, share of recent episodes in which all goals were visited.
      miss: float32, by how much exploration's subgoals of an episode were missed in sum, recently,
        in the subgoal space; inf: it hasn't begun.
      num_steps: int32, control steps of all environments so far.
    """

    learned: learning.Learned
    squares: exploration.ExplorationState
    episodes: episodes_lib.Episodes
    high_memory: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    success: Float[Array, ""]
    miss: Float[Array, ""]
    num_steps: Int[Array, ""]


class Chosen(struct.PyTreeNode):
    """A subgoal while exploring; places in the subgoal space.

    Attributes:
      target: float32 [2], where to go.
      action: float32 [2], the manager's action that leads there.
      place: float32 [2], the place that was chosen, of which the target may lie beyond.
      is_exploring: whether exploration chose it.
    """

    target: Float[Array, "2"]
    action: Float[Array, "2"]
    place: Float[Array, "2"]
    is_exploring: Bool[Array, ""]


class HessCarry(struct.PyTreeNode):
    """What is remembered between control steps.

    Attributes:
      subgoal: float32 [2], where to go, in the subgoal space.
      steps_left: int32, control steps left in the period.
    """

    subgoal: Float[Array, "2"]
    steps_left: Int[Array, ""]


class Hess:
    """The functions of a run; holds no state that changes.

    Attributes:
      options: of the run.
      steps_per_round: control steps of all environments in a round, rests included.
    """

    def __init__(
        self,
        env: base.Environment,
        num_actions: int,
        side_xy: tuple[int, int],
        episode_steps: int,
        options: config_lib.HessConfig,
    ):
        """Builds the learners.

        Args:
          env: where the robots walk; its observation is a `base.GoalObs`, and its `step` rests
            where the episode is over.
          num_actions: size A of the robot's controls.
          side_xy: the arena's sides in units, its upper left corner at the origin.
          episode_steps: control steps of an episode.
          options: of the run.
        """
        self.options = options
        self._env = env
        self._centre_xy = side_xy[0] / 2.0, -side_xy[1] / 2.0
        self._num_periods = options.num_periods(episode_steps)
        self.steps_per_round = options.num_envs * self._num_periods * options.period
        obs = jax.eval_shape(env.reset, jax.random.key(0)).obs
        num_seen = jax.eval_shape(self.see, obs).shape[0]
        self._sizes = num_seen, num_actions
        self._learning = learning.Learning(
            num_seen, num_actions, episode_steps, self.steps_per_round, options
        )

    def init(self, key: Key[Array, ""]) -> HessState:
        """Returns the state of a run that is about to start, its memories still empty."""
        key, learned_key, env_key = jax.random.split(key, 3)
        num_envs, capacity = self.options.num_envs, self.options.capacity
        per_round = num_envs * self._num_periods
        high_capacity = -(-self.options.high_capacity // per_round) * per_round
        episodes = episodes_lib.init(capacity, self.options.period, self._num_periods, self._sizes)
        return HessState(
            learned=self._learning.init(episodes.action.shape[1], learned_key),
            squares=exploration.init(),
            episodes=episodes,
            high_memory=replay.init(self._learning.subgoal_row(), high_capacity),
            envs=jax.vmap(self._env.reset)(jax.random.split(env_key, num_envs)),
            key=key,
            success=jnp.float32(0.0),
            miss=jnp.float32(jnp.inf),
            num_steps=jnp.int32(0),
        )

    def advance(self, state: HessState) -> tuple[HessState, dict[str, Float[Array, ""]]]:
        """Walks an episode in every environment and learns from them.

        The subgoal space is trained before that, so that both levels have learned with it as it is
        when they are evaluated.

        Returns:
          The new state, and scalars: means of what the learners tell, and sums over the episodes
          that ended, their names beginning with `sum_`, see `periods.summarise`.
        """
        key, walk_key, learn_key, space_key = jax.random.split(state.key, 4)
        state, space_loss = self._train_space(state, space_key)
        envs, walked = self._walk_round(state, walk_key)
        state = state.replace(
            envs=envs,
            key=key,
            num_steps=state.num_steps + self.steps_per_round,
        )
        state = self._remember(state, walked)
        num_subgoals = self.options.num_envs * self._num_periods
        learned, metrics = self._learning.learn(
            state.learned,
            state.episodes,
            state.high_memory,
            state.num_steps,
            num_subgoals,
            learn_key,
        )
        state = state.replace(learned=learned)
        metrics |= {
            "representation_loss": space_loss,
            "miss": state.miss,
            "exploring": self._exploring_share(state),
        }
        return state, metrics | periods.summarise(walked)

    def policy(self, state: HessState) -> Policy:
        """Returns what acts."""
        return {
            "manager": state.learned.manager.actor_params,
            "controller": state.learned.controller.actor_params,
            "representation": state.learned.space.params,
        }

    def start(self) -> HessCarry:
        """Returns the carry at the beginning of an episode."""
        return HessCarry(subgoal=jnp.zeros(2), steps_left=jnp.int32(0))

    def act(
        self, policy: Policy, carry: HessCarry, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], HessCarry]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        is_new = carry.steps_left == 0
        action = self._learning.manager.mode(policy["manager"], self._manager_features(obs))
        place = self._learning.space.place(policy["representation"], self.see(obs))
        subgoal = jnp.where(is_new, place + action, carry.subgoal)
        features = jnp.concatenate([self.see(obs), place, subgoal])
        left = jnp.where(is_new, jnp.int32(self.options.period), carry.steps_left) - 1
        ctrl = self._learning.controller.act(policy["controller"], features)
        return ctrl, HessCarry(subgoal=subgoal, steps_left=left)

    def see(self, obs: base.GoalObs) -> Float[Array, " F"]:
        """Returns what both levels see: x and y from the arena's centre, and the robot."""
        return jnp.concatenate([obs.xy - jnp.array(self._centre_xy), obs.proprioception])

    def _manager_features(self, obs: base.GoalObs) -> Float[Array, " M"]:
        goal_xy = obs.goal_xy - jnp.array(self._centre_xy)
        return jnp.concatenate([self.see(obs), goal_xy])

    def _exploring_share(self, state: HessState) -> Float[Array, ""]:
        """Returns the share of subgoals that exploration chooses."""
        options = self.options.exploration
        share = jax.nn.sigmoid(1.0 - 2.0 * options.success_weight * state.success)
        return jnp.where(state.num_steps >= options.first_step, share, 0.0)

    def _train_space(
        self, state: HessState, key: Key[Array, ""]
    ) -> tuple[HessState, Float[Array, ""]]:
        """Trains the subgoal space and looks ahead in it, where that is due; see `train_space`."""
        learned, loss = self._learning.train_space(
            state.learned, state.episodes, state.num_steps, state.miss, key
        )
        state = state.replace(learned=learned)
        return state.replace(squares=self._look_ahead(state)), loss

    def _walk_round(
        self, state: HessState, key: Key[Array, ""]
    ) -> tuple[base.EnvState, periods.Period]:
        """Walks one episode in every environment; leading axes [J, c, N]."""
        params = state.learned.space.params

        def act(obs: base.GoalObs, subgoal: Chosen, key: Key[Array, ""]) -> Array:
            seen = self.see(obs)
            place = self._learning.space.place(params, seen)
            features = jnp.concatenate([seen, place, subgoal.target])
            action = self._learning.controller.act(state.learned.controller.actor_params, features)
            return self._learning.controller.explore(action, key)

        def body(envs: base.EnvState, key: Key[Array, ""]) -> tuple[base.EnvState, periods.Period]:
            return periods.walk(
                self._env,
                envs,
                self.options.period,
                functools.partial(self._choose, state),
                act,
                lambda subgoal, obs, next_obs: subgoal,
                key,
            )

        envs = periods.renew(self._env, state.envs, jnp.ones(self.options.num_envs, bool))
        return jax.lax.scan(body, envs, jax.random.split(key, self._num_periods))

    def _choose(
        self,
        state: HessState,
        obs: base.GoalObs,
        is_first: Bool[Array, ""],
        key: Key[Array, ""],
    ) -> Chosen:
        """Chooses where to go while exploring."""
        del is_first
        options = self.options.exploration
        share_key, act_key, any_key, draw_key, select_key = jax.random.split(key, 5)
        params = state.learned.space.params
        here = self._learning.space.place(params, self.see(obs))
        own = self._learning.manager.sample(
            state.learned.manager.actor_params, self._manager_features(obs), act_key
        )
        reach = self.options.manager.reach
        drawn = jax.random.uniform(any_key, own.shape, minval=-reach, maxval=reach)
        own = jnp.where(state.num_steps < self.options.random_steps, drawn, own)

        drawn_steps = episodes_lib.sample(state.episodes, (options.num_candidates,), draw_key)
        candidates = self._learning.space.place(params, drawn_steps.obs)
        has_potential = state.num_steps >= options.potential_step
        chosen = exploration.select(
            state.squares, here, candidates, has_potential, options, select_key
        )
        way = chosen - here
        length = jnp.sqrt(jnp.square(way).sum() + 1e-12)
        beyond = jnp.where(has_potential, options.extension, 0.0) * way / length
        is_exploring = jax.random.bernoulli(share_key, self._exploring_share(state))
        action = jnp.where(is_exploring, way + beyond, own)
        place = jnp.where(is_exploring, chosen, here + own)
        return Chosen(target=here + action, action=action, place=place, is_exploring=is_exploring)

    def _remember(self, state: HessState, walked: periods.Period) -> HessState:
        """Stores a round, and counts where it led, once the subgoal space has been trained."""
        space = state.learned.space
        batch = self._episode_batch(space.params, walked)
        reached = batch.place[:, self.options.period :: self.options.period]
        chosen = jax.tree.map(lambda leaf: leaf[:, 0].swapaxes(0, 1), walked.subgoal)
        # A robot whose episode has ended at its goal doesn't go on to its subgoal. An episode's
        # last subgoal isn't looked back on, as released: time may be up before it.
        has_ended = walked.terminated[:, -1].at[-1].set(True).T
        is_selected = walked.is_running[:, 0].T & chosen.is_exploring & ~has_ended
        square = self.options.exploration.square
        steps = jnp.arange(batch.place.shape[1], dtype=jnp.int32)
        was_there = (steps[None] <= batch.length[:, None]) & (space.num_blocks > 0)
        squares = exploration.visit(state.squares, batch.place, was_there, square)
        distance = jnp.sqrt(jnp.square(batch.subgoal - reached).sum(-1))
        distance = jnp.where(is_selected, distance, 0.0)
        squares = exploration.miss(squares, chosen.place, distance, square)
        is_end = periods.is_end(walked)
        num_solved = (is_end & (walked.metrics["success"] == 1.0)).sum(dtype=jnp.float32)
        success = num_solved / jnp.maximum(is_end.sum(dtype=jnp.float32), 1.0)
        return state.replace(
            squares=squares,
            episodes=episodes_lib.add(state.episodes, batch),
            high_memory=replay.add(state.high_memory, self._subgoal_rows(walked)),
            success=(1.0 - _RECENT) * state.success + _RECENT * success,
            miss=self._recent_miss(state, distance.sum(1).mean()),
            learned=state.learned.replace(space=_with_new_episodes(state, batch)),
        )

    def _recent_miss(self, state: HessState, miss: Float[Array, ""]) -> Float[Array, ""]:
        """Returns `HessState.miss` after a round, whose episodes' mean is `miss`."""
        is_first = ~jnp.isfinite(state.miss)
        recent = jnp.where(is_first, miss, (1.0 - _RECENT) * state.miss + _RECENT * miss)
        before = state.num_steps - self.steps_per_round
        has_explored = before >= self.options.exploration.first_step
        return jnp.where(has_explored, recent, state.miss)

    def _look_ahead(self, state: HessState) -> exploration.ExplorationState:
        """Computes the novelty of places anew where that is due."""
        options = self.options.exploration
        is_due = periods.is_due(state.num_steps, self.steps_per_round, options.every)
        # Before anything has been counted, places that hold much would be the least novel ones.
        is_due &= state.squares.visits.any()
        obs, is_there = episodes_lib.period_ends(state.episodes)
        place = self._learning.space.place(state.learned.space.params, obs)
        return jax.lax.cond(
            is_due,
            lambda squares: exploration.look_ahead(squares, place, is_there, options),
            lambda squares: squares,
            state.squares,
        )

    def _episode_batch(self, params: Any, walked: periods.Period) -> episodes_lib.Episodes:
        """Returns a round as episodes."""
        see = jax.vmap(jax.vmap(jax.vmap(self.see)))
        obs, last = see(walked.obs), see(walked.next_obs)[-1, -1]
        by_time = obs.reshape(-1, *obs.shape[2:]).swapaxes(0, 1)
        seen = jnp.concatenate([by_time, last[:, None]], axis=1)
        action = walked.action.reshape(-1, *walked.action.shape[2:]).swapaxes(0, 1)
        running = walked.is_running.reshape(-1, walked.is_running.shape[-1])
        return episodes_lib.Episodes(
            obs=seen,
            place=self._learning.space.place(params, seen),
            action=action,
            subgoal=walked.subgoal.target[:, 0].swapaxes(0, 1),
            length=running.sum(0, dtype=jnp.int32),
            position=jnp.int32(0),
        )

    def _subgoal_rows(self, walked: periods.Period) -> learning.SubgoalRow:
        """Returns what the manager learns from a round, with one leading axis."""
        see = jax.vmap(jax.vmap(self._manager_features))
        first = jax.tree.map(lambda leaf: leaf[:, 0], walked.obs)
        last = jax.tree.map(lambda leaf: leaf[:, -1], walked.next_obs)
        ends = periods.is_task_over(walked, self.options.reward)
        rows = learning.SubgoalRow(
            transition=base.Transition(
                obs=see(first),
                action=walked.subgoal.action[:, 0],
                reward=periods.paid(walked, self.options.costs_time, self.options.reward).sum(1),
                discount=self.options.manager.gamma * (1.0 - ends.astype(jnp.float32)),
                next_obs=see(last),
            ),
            is_running=walked.is_running[:, 0],
        )
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), rows)


def _with_new_episodes(
    state: HessState, batch: episodes_lib.Episodes
) -> representation.RepresentationState:
    """Returns the subgoal space, for which new episodes have taken the place of the oldest."""
    space = state.learned.space
    unknown = jnp.full((batch.length.shape[0], space.loss.shape[1]), representation.UNKNOWN)
    position = state.episodes.position
    return space.replace(
        loss=jax.lax.dynamic_update_slice_in_dim(space.loss, unknown, position, axis=0)
    )
