"""HIGL as a whole: a round is some periods in every environment, and what is learned from them."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.higl import landmarks, learning, relabelling
from eihrl_jax.baselines.world import World
from eihrl_jax.config import higl as config_lib
from eihrl_jax.ops import tree


class Higl:
    """The functions of a run; has no mutable state.

    Attributes:
      options: of the run.
      steps_per_round: control steps of all environments in a round.
    """

    def __init__(self, world: World, options: config_lib.HiglConfig):
        """Builds the learners."""
        self.options = options
        self.steps_per_round = options.steps_per_round
        self._world = world
        self._learning = learning.Learning(world.num_features(self.see), world, options)

    def init(self, key: Key[Array, ""]) -> learning.HiglState:
        """Returns the initial state of a run, with empty replays."""
        key, learned_key, env_key = jax.random.split(key, 3)
        num_envs = self.options.num_envs
        envs = self._world.reset(num_envs, env_key)
        learned = self._learning.init(learned_key)

        # The round is only traced: it tells what the rows of both replays hold.
        steps, subgoals = jax.eval_shape(lambda: self._rows(self._run_round(learned, envs, key)[1]))

        return learning.HiglState(
            learned=learned,
            low_replay=replay.init(replay.row(steps, 3), self.options.capacity, num_envs),
            high_replay=replay.init(replay.row(subgoals, 2), self.options.high_capacity, num_envs),
            envs=envs,
            key=key,
            num_steps=jnp.int32(0),
        )

    def advance(
        self, state: learning.HiglState
    ) -> tuple[learning.HiglState, dict[str, Float[Array, ""]]]:
        """Acts for a round and learns from it; returns metrics too."""
        key, act_key, learn_key, fit_key = jax.random.split(state.key, 4)
        state, period = self._collect(state.replace(key=key), act_key)
        learned, metrics = self._learning.learn(state, learn_key)
        # HIRO holds its subgoals to nothing, so that there is nothing to fit.
        if self.options.guidance != "none":
            every = self.options.adjacency.period
            is_due = periods.is_due(state.num_steps, self.steps_per_round, every)
            learned, metrics["adjacency_loss"] = self._learning.fit_places(learned, is_due, fit_key)
        metrics |= periods.sum_ends(periods.is_end(period), period.metrics)
        return state.replace(learned=learned), metrics

    def policy(self, state: learning.HiglState) -> dict[str, base.Params]:
        """Returns the parameters that act: the actors of `manager` and `controller`."""
        learned = state.learned
        return {
            "manager": learned.manager.actor.params,
            "controller": learned.controller.actor.params,
        }

    def start(self) -> periods.Carry:
        """Returns the carry at the beginning of an episode."""
        return periods.Carry.start()

    def act(
        self, policy: dict[str, base.Params], carry: periods.Carry, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], periods.Carry]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        # The manager chooses at every step; `advance` takes its choice where a subgoal is due.
        subgoal = self._learning.manager.act(policy["manager"], self._manager_features(obs))
        carry = carry.advance(subgoal, obs.xy, self.options.period, _move)
        features = landmarks.controller_features(self.see(obs), carry.subgoal)
        action = self._learning.controller.act(policy["controller"], features)
        return action / self.options.controller.reach, carry

    def see(self, obs: base.GoalObs) -> Float[Array, "*B F"]:
        """Returns what both levels see: x and y from the arena's centre, the robot, the time."""
        xy = self._world.centred(obs.xy)
        return jnp.concatenate([xy, obs.proprioception, obs.time[..., None]], axis=-1)

    def _manager_features(self, obs: base.GoalObs) -> Float[Array, " M"]:
        return jnp.concatenate([self.see(obs), self._world.centred(obs.goal_xy)])

    def _collect(
        self, state: learning.HiglState, key: Key[Array, ""]
    ) -> tuple[learning.HiglState, periods.Period[Array]]:
        """Acts for a round and stores it; returns what happened too."""
        envs, period = self._run_round(state.learned, state.envs, key)
        steps, subgoals = self._rows(period)
        state = state.replace(
            # One way per robot: a robot's steps of all periods in a row.
            learned=self._learning.visit(state.learned, tree.merge_axes(steps, 2)),
            low_replay=replay.add(state.low_replay, tree.merge_axes(steps, 3)),
            high_replay=replay.add(state.high_replay, tree.merge_axes(subgoals, 2)),
            envs=envs,
            num_steps=state.num_steps + self.steps_per_round,
        )
        return state, period

    def _run_round(
        self, learned: learning.Learned, envs: base.EnvState, key: Key[Array, ""]
    ) -> tuple[base.EnvState, periods.Period[Array]]:
        """Runs some periods with exploration; leading axes [R, k, N]."""
        manager, controller = self._learning.manager, self._learning.controller

        def choose(obs: base.GoalObs, key: Key[Array, ""]) -> Float[Array, "2"]:
            subgoal = manager.act(learned.manager.actor.params, self._manager_features(obs))
            # As released: an episode's first subgoal has no noise.
            return jnp.where(obs.time == 0.0, subgoal, manager.explore(subgoal, key))

        def act(
            obs: base.GoalObs, subgoal: Float[Array, "2"], key: Key[Array, ""]
        ) -> Float[Array, " A"]:
            features = landmarks.controller_features(self.see(obs), subgoal)
            action = controller.act(learned.controller.actor.params, features)
            return controller.explore(action, key)

        def body(
            envs: base.EnvState, key: Key[Array, ""]
        ) -> tuple[base.EnvState, periods.Period[Array]]:
            world, k, reach = self._world, self.options.period, self.options.controller.reach
            # Who ended within the last period has rested until its end.
            envs = world.renew(envs, envs.is_over)
            return periods.run(world, envs, k, choose, act, _move, key, reach=reach)

        return jax.lax.scan(body, envs, jax.random.split(key, self.options.periods_per_round))

    def _rows(
        self, period: periods.Period[Array]
    ) -> tuple[learning.ControlRow, relabelling.SubgoalRow]:
        """Returns what is stored of a round, with leading axes [R, k, N] and [R, N]."""
        obs, next_obs = self.see(period.obs), self.see(period.next_obs)
        left = _move(period.subgoal, obs[..., :2], next_obs[..., :2])

        # The reward tells of the subgoal before the step; the released code stores that after it.
        steps = learning.ControlRow(
            obs=obs,
            subgoal=left if self.options.stores_moved_subgoal else period.subgoal,
            action=period.action,
            reward=-jnp.sqrt(jnp.square(left).sum(-1)),
            next_obs=next_obs,
            is_end=period.terminated | period.truncated,
            # A simulation that breaks down would be an end without a value: nothing costs less.
            is_running=period.is_running & (period.metrics["broke_down"] == 0.0),
        )

        # A row is one robot's whole subgoal, which the correction weighs by all of its steps.
        subgoals = relabelling.SubgoalRow(
            obs=obs.swapaxes(1, 2),
            action=period.action.swapaxes(1, 2),
            is_running=period.is_running.swapaxes(1, 2),
            subgoal=period.subgoal[:, 0],
            goal_xy=self._world.centred(period.obs.goal_xy[:, 0]),
            reward=periods.paid(period, self.options.costs_time, self.options.reward).sum(1),
            next_obs=next_obs[:, -1],
            next_goal_xy=self._world.centred(period.next_obs.goal_xy[:, -1]),
            terminated=periods.is_task_over(period, self.options.reward),
            truncated=period.truncated[:, -1],
        )

        return steps, subgoals


def _move(
    subgoal: Float[Array, "*B 2"], xy: Float[Array, "*B 2"], next_xy: Float[Array, "*B 2"]
) -> Float[Array, "*B 2"]:
    """Returns the remaining displacement after a step: the subgoal's position doesn't move."""
    return subgoal + xy - next_xy
