"""HESS as a whole: a round is one episode in every environment, then learning from them."""

import functools

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.hess import episodes as episodes_lib
from eihrl_jax.baselines.hess import exploration, learning
from eihrl_jax.baselines.world import World
from eihrl_jax.config import hess as config_lib
from eihrl_jax.ops import tree

_RECENT = 0.2
"""Weight of the last round in means of recent rounds."""


class ExplorationChoice(struct.PyTreeNode):
    """A subgoal while exploring; all of it in the subgoal space.

    Attributes:
      target: float32 [2], where to go.
      action: float32 [2], the manager's action that leads there.
      embedding: float32 [2], what was chosen, of which the target may lie beyond.
      is_exploring: whether exploration chose it.
    """

    target: Float[Array, "2"]
    action: Float[Array, "2"]
    embedding: Float[Array, "2"]
    is_exploring: Bool[Array, ""]


class Hess:
    """The functions of a run; has no mutable state.

    Attributes:
      options: of the run.
      steps_per_round: control steps of all environments in a round, those after an episode's end
        included.
    """

    def __init__(self, world: World, options: config_lib.HessConfig):
        """Builds the learners."""
        self.options = options
        self._world = world
        self._num_periods = options.num_periods(world.episode_steps)
        self.steps_per_round = options.num_envs * self._num_periods * options.period
        self._num_seen = world.num_features(self.see)
        self._learning = learning.Learning(self._num_seen, world, self.steps_per_round, options)

    def init(self, key: Key[Array, ""]) -> learning.HessState:
        """Returns the initial state of a run, without episodes and subgoals."""
        key, learned_key, env_key = jax.random.split(key, 3)

        # A round's subgoals must not wrap around the end of their replay.
        per_round = self.options.num_envs * self._num_periods
        high_capacity = -(-self.options.high_capacity // per_round) * per_round

        return learning.HessState(
            learned=self._learning.init(learned_key),
            squares=exploration.init(),
            episodes=episodes_lib.init(
                self.options.capacity,
                self.options.period,
                self._num_periods,
                (self._num_seen, self._world.num_actions),
            ),
            high_replay=replay.init(
                learning.empty_row(self._num_seen + 2), high_capacity, self.options.num_envs
            ),
            envs=self._world.reset(self.options.num_envs, env_key),
            key=key,
            success=jnp.float32(0.0),
            miss=jnp.float32(jnp.inf),
            num_steps=jnp.int32(0),
        )

    def advance(
        self, state: learning.HessState
    ) -> tuple[learning.HessState, dict[str, Float[Array, ""]]]:
        """Acts for an episode in every environment and learns from them.

        The subgoal space is trained before that, so that both levels have learned with it as it is
        when they are evaluated.
        """
        key, act_key, learn_key, space_key = jax.random.split(state.key, 4)
        state, space_loss = self._learning.train_space(state, space_key)
        state = state.replace(squares=self._look_ahead(state))

        envs, period = self._run_round(state, act_key)
        num_steps = state.num_steps + self.steps_per_round
        state = state.replace(envs=envs, key=key, num_steps=num_steps)
        state = self._store(state, period)

        state, metrics = self._learning.learn(state, learn_key)
        metrics |= {
            "representation_loss": space_loss,
            "miss": state.miss,
            "exploring": self._exploring_share(state),
        }
        return state, metrics | periods.sum_ends(periods.is_end(period), period.metrics)

    def policy(self, state: learning.HessState) -> dict[str, base.Params]:
        """Returns the parameters that act: `manager`, `controller` and their `representation`."""
        return {
            "manager": state.learned.manager.actor.params,
            "controller": state.learned.controller.actor.params,
            "representation": state.learned.space.network.params,
        }

    def start(self) -> periods.Carry:
        """Returns the carry at the beginning of an episode."""
        return periods.Carry.start()

    def act(
        self, policy: dict[str, base.Params], carry: periods.Carry, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], periods.Carry]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        # The manager chooses at every step; `advance` takes its choice where a subgoal is due.
        action = self._learning.manager.mode(policy["manager"], self._manager_features(obs))
        seen = self.see(obs)
        here = self._learning.space.embed(policy["representation"], seen)
        carry = carry.advance(here + action, obs.xy, self.options.period, _stay)
        features = learning.controller_features(seen, here, carry.subgoal)
        return self._learning.controller.act(policy["controller"], features), carry

    def see(self, obs: base.GoalObs) -> Float[Array, "*B F"]:
        """Returns what both levels see: x and y from the arena's centre, and the robot."""
        return jnp.concatenate([self._world.centred(obs.xy), obs.proprioception], axis=-1)

    def _manager_features(self, obs: base.GoalObs) -> Float[Array, "*B M"]:
        return jnp.concatenate([self.see(obs), self._world.centred(obs.goal_xy)], axis=-1)

    def _exploring_share(self, state: learning.HessState) -> Float[Array, ""]:
        """Returns the share of subgoals that exploration chooses."""
        options = self.options.exploration
        # As long as no episode succeeds 73 % of the subgoals explore, fewer with every success.
        share = jax.nn.sigmoid(1.0 - 2.0 * options.success_weight * state.success)
        return jnp.where(state.num_steps >= options.first_step, share, 0.0)

    def _look_ahead(self, state: learning.HessState) -> exploration.ExplorationState:
        """Computes the novelty of squares anew where that is due."""
        options = self.options.exploration
        is_due = periods.is_due(state.num_steps, self.steps_per_round, options.every)

        # Not before visits are counted: the squares visited most would have the lowest novelty
        # count, and so be taken for the most novel ones.
        is_due &= state.squares.visits.any()

        # Embedded again, because stored embeddings are those of an earlier subgoal space.
        obs, is_there = episodes_lib.period_ends(state.episodes)
        ends = self._learning.space.embed(state.learned.space.network.params, obs)
        return jax.lax.cond(
            is_due,
            lambda squares: exploration.look_ahead(squares, ends, is_there, options),
            lambda squares: squares,
            state.squares,
        )

    def _run_round(
        self, state: learning.HessState, key: Key[Array, ""]
    ) -> tuple[base.EnvState, periods.Period[ExplorationChoice]]:
        """Runs one episode in every environment; leading axes [J, c, N]."""
        learned, controller = state.learned, self._learning.controller

        def act(
            obs: base.GoalObs, choice: ExplorationChoice, key: Key[Array, ""]
        ) -> Float[Array, " nu"]:
            seen = self.see(obs)
            here = self._learning.space.embed(learned.space.network.params, seen)
            features = learning.controller_features(seen, here, choice.target)
            action = controller.act(learned.controller.actor.params, features)
            return controller.explore(action, key)

        def body(
            envs: base.EnvState, key: Key[Array, ""]
        ) -> tuple[base.EnvState, periods.Period[ExplorationChoice]]:
            choose = functools.partial(self._choose, state)
            return periods.run(self._world, envs, self.options.period, choose, act, _stay, key)

        # Episodes are stored whole, so that all robots begin a new one with the round.
        everywhere = jnp.ones(self.options.num_envs, bool)
        envs = self._world.renew(state.envs, everywhere)
        return jax.lax.scan(body, envs, jax.random.split(key, self._num_periods))

    def _choose(
        self, state: learning.HessState, obs: base.GoalObs, key: Key[Array, ""]
    ) -> ExplorationChoice:
        """Chooses the next subgoal: the manager's, or one to explore with."""
        options = self.options.exploration
        share_key, act_key, any_key, draw_key, select_key = jax.random.split(key, 5)
        space, manager = self._learning.space, self._learning.manager
        params = state.learned.space.network.params
        here = space.embed(params, self.see(obs))

        # The manager's choice, at first a random one.
        own = manager.sample(
            state.learned.manager.actor.params, self._manager_features(obs), act_key
        )
        reach = self.options.manager.reach
        drawn = jax.random.uniform(any_key, own.shape, minval=-reach, maxval=reach)
        own = jnp.where(state.num_steps < self.options.random_steps, drawn, own)

        # Li et al. 2021, Sec. 3.2 and 3.3: exploration's choice, later extended beyond it.
        steps = episodes_lib.sample(state.episodes, (options.num_candidates,), draw_key)
        candidates = space.embed(params, steps.obs)
        has_potential = state.num_steps >= options.potential_step
        chosen = exploration.select(
            state.squares, here, candidates, has_potential, options, select_key
        )
        way = chosen - here
        # If none is within reach, the choice may be the robot's own place, at distance 0.
        length = jnp.sqrt(jnp.square(way).sum() + 1e-12)
        beyond = jnp.where(has_potential, options.extension, 0.0) * way / length

        is_exploring = jax.random.bernoulli(share_key, self._exploring_share(state))
        action = jnp.where(is_exploring, way + beyond, own)
        return ExplorationChoice(
            target=here + action,
            action=action,
            # A miss counts for the chosen square, not for that of the extended target.
            embedding=jnp.where(is_exploring, chosen, here + own),
            is_exploring=is_exploring,
        )

    def _store(
        self, state: learning.HessState, period: periods.Period[ExplorationChoice]
    ) -> learning.HessState:
        """Stores a round, and counts where it led, once the subgoal space has been trained."""
        batch = self._episode_batch(state, period)
        squares, side = state.squares, self.options.exploration.square

        # Where the last step led to was visited too. Nothing is counted in the squares of a space
        # that hasn't been trained: training moves everything to other ones.
        steps = jnp.arange(batch.embedding.shape[1], dtype=jnp.int32)
        was_there = steps[None] <= batch.length[:, None]
        was_there &= state.learned.space.num_blocks > 0
        weight = was_there.astype(jnp.float32)
        visits = exploration.add(squares.visits, batch.embedding, weight, side)

        # Not for a robot whose episode ended at its goal before it reached the subgoal, and, as
        # released, not for an episode's last subgoal, before which time may be up.
        choice = jax.tree.map(lambda leaf: leaf[:, 0].swapaxes(0, 1), period.subgoal)
        has_ended = period.terminated[:, -1].at[-1].set(True).T
        is_selected = period.is_running[:, 0].T & choice.is_exploring & ~has_ended
        reached = batch.embedding[:, self.options.period :: self.options.period]
        distance = learning.distance_between(batch.subgoal, reached)
        distance = jnp.where(is_selected, distance, 0.0)
        misses = exploration.add(squares.misses, choice.embedding, distance, side)

        # Means over recent rounds, where the released code has windows of 50 episodes.
        is_end = periods.is_end(period)
        num_solved = (is_end & (period.metrics["success"] == 1.0)).sum(dtype=jnp.float32)
        success = num_solved / jnp.maximum(is_end.sum(dtype=jnp.float32), 1.0)
        return state.replace(
            squares=squares.replace(visits=visits, misses=misses),
            episodes=episodes_lib.add(state.episodes, batch),
            high_replay=replay.add(state.high_replay, self._subgoal_rows(period)),
            success=(1.0 - _RECENT) * state.success + _RECENT * success,
            miss=self._recent_miss(state, distance.sum(1).mean()),
        )

    def _recent_miss(self, state: learning.HessState, miss: Float[Array, ""]) -> Float[Array, ""]:
        """Returns `HessState.miss` after a round, whose episodes' mean is `miss`."""
        # A mean that began at infinity would stay there.
        is_first = ~jnp.isfinite(state.miss)
        recent = jnp.where(is_first, miss, (1.0 - _RECENT) * state.miss + _RECENT * miss)
        # The round explored if that was due when it began.
        before = state.num_steps - self.steps_per_round
        has_explored = before >= self.options.exploration.first_step
        return jnp.where(has_explored, recent, state.miss)

    def _episode_batch(
        self, state: learning.HessState, period: periods.Period[ExplorationChoice]
    ) -> episodes_lib.Episodes:
        """Returns a round as episodes."""
        # From [J, c, N] to [N, J c], followed by the observation after the last step.
        seen, action, is_running = jax.tree.map(
            lambda leaf: tree.merge_axes(leaf, 2).swapaxes(0, 1),
            (self.see(period.obs), period.action, period.is_running),
        )

        last = self.see(period.next_obs)[-1, -1]
        seen = jnp.concatenate([seen, last[:, None]], axis=1)

        # Embedded by the space in which the subgoals were chosen.
        return episodes_lib.Episodes(
            obs=seen,
            embedding=self._learning.space.embed(state.learned.space.network.params, seen),
            action=action,
            subgoal=period.subgoal.target[:, 0].swapaxes(0, 1),
            # In the released code steps inherit the losses of those whose place they take.
            loss=jnp.full(is_running.shape, episodes_lib.UNKNOWN, jnp.float32),
            length=is_running.sum(1, dtype=jnp.int32),
            position=jnp.int32(0),
        )

    def _subgoal_rows(self, period: periods.Period[ExplorationChoice]) -> learning.SubgoalRow:
        """Returns the manager's transitions of a round, with one leading axis."""
        options = self.options
        ends = periods.is_task_over(period, options.reward)

        # After its episode's end a robot stays where it is, so the last step has the result of the
        # period. Every round has as many rows; those after an end have `is_running` false.
        rows = learning.SubgoalRow(
            transition=base.Transition(
                obs=self._manager_features(period.obs)[:, 0],
                action=period.subgoal.action[:, 0],
                reward=periods.paid(period, options.costs_time, options.reward).sum(1),
                discount=options.manager.gamma * (1.0 - ends.astype(jnp.float32)),
                next_obs=self._manager_features(period.next_obs)[:, -1],
            ),
            is_running=period.is_running[:, 0],
        )

        return tree.merge_axes(rows, 2)


def _stay(
    subgoal: periods.SubgoalT, xy: Float[Array, "2"], next_xy: Float[Array, "2"]
) -> periods.SubgoalT:
    """Returns the subgoal after a step, unchanged: a fixed point of the subgoal space."""
    del xy, next_xy
    return subgoal
