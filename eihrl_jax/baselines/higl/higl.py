"""HIGL as a whole: it walks a round of periods in every environment, then learns from it."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.higl import landmarks, learning, relabelling
from eihrl_jax.config import higl as config_lib


class HiglState(struct.PyTreeNode):
    """All that a run needs to go on. N: number of environments.

    Attributes:
      learned: both levels, what is near what, and what is new.
      memory: `learning.ControlRow`s.
      high_memory: `relabelling.SubgoalRow`s.
      envs: environments with leading axis N.
      key: of what comes next.
      num_steps: int32, control steps of all environments so far.
    """

    learned: learning.Learned
    memory: replay.Replay
    high_memory: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    num_steps: Int[Array, ""]


Policy = dict[str, base.Params]
"""What acts: parameters of the actors `manager` and `controller`."""


class HiglCarry(struct.PyTreeNode):
    """What is remembered between control steps.

    Attributes:
      subgoal: float32 [2], the displacement that was left at the last step, units.
      xy: float32 [2], where the torso was then, units.
      steps_left: int32, control steps left in the period.
    """

    subgoal: Float[Array, "2"]
    xy: Float[Array, "2"]
    steps_left: Int[Array, ""]


class Higl:
    """The functions of a run; holds no state that changes.

    Attributes:
      options: of the run.
      steps_per_round: control steps of all environments in a round.
    """

    def __init__(
        self,
        env: base.Environment,
        num_actions: int,
        side_xy: tuple[int, int],
        options: config_lib.HiglConfig,
    ):
        """Builds the learners.

        Args:
          env: where the robots walk; its observation is a `base.GoalObs`, and its `step` rests
            where the episode is over.
          num_actions: size A of the robot's controls.
          side_xy: the arena's sides in units, its upper left corner at the origin.
          options: of the run.
        """
        self.options = options
        self.steps_per_round = options.steps_per_round
        self._env = env
        self._centre_xy = side_xy[0] / 2.0, -side_xy[1] / 2.0
        obs = jax.eval_shape(env.reset, jax.random.key(0)).obs
        num_seen = jax.eval_shape(self.see, obs).shape[0]
        self._learning = learning.Learning(num_seen, num_actions, side_xy, options)

    def init(self, key: Key[Array, ""]) -> HiglState:
        """Returns the state of a run that is about to start, its memories still empty."""
        key, learned_key, env_key = jax.random.split(key, 3)
        envs = jax.vmap(self._env.reset)(jax.random.split(env_key, self.options.num_envs))
        learned = self._learning.init(learned_key)
        _, walked = jax.eval_shape(self._walk_round, _policy(learned), envs, key)
        steps, subgoals = jax.eval_shape(self._rows, walked)
        return HiglState(
            learned=learned,
            memory=replay.init(replay.row(steps), self.options.capacity),
            high_memory=replay.init(replay.row(subgoals), self.options.high_capacity),
            envs=envs,
            key=key,
            num_steps=jnp.int32(0),
        )

    def advance(self, state: HiglState) -> tuple[HiglState, dict[str, Float[Array, ""]]]:
        """Walks a round and learns from it.

        Returns:
          The new state, and scalars: means of what the learners tell, and sums over the episodes
          that ended, their names beginning with `sum_`, see `periods.summarise`.
        """
        key, walk_key, learn_key, fit_key = jax.random.split(state.key, 4)
        envs, walked = self._walk_round(_policy(state.learned), state.envs, walk_key)
        steps, subgoals = self._rows(walked)
        memory = replay.add(state.memory, steps)
        high_memory = replay.add(state.high_memory, subgoals)
        num_steps = state.num_steps + self.options.steps_per_round

        by_robot = jax.tree.map(
            lambda leaf: leaf.reshape(-1, self.options.num_envs, *leaf.shape[1:]), steps
        )
        learned = self._learning.visit(state.learned, by_robot)
        has_landmarks = num_steps >= self.options.landmarks.first_step
        learned, metrics = self._learning.learn(
            learned, memory, high_memory, has_landmarks, learn_key
        )
        if self.options.guidance != "none":
            every = self.options.adjacency.period
            is_due = periods.is_due(num_steps, self.options.steps_per_round, every)
            learned, metrics["adjacency_loss"] = self._learning.fit_places(learned, is_due, fit_key)
        state = HiglState(
            learned=learned,
            memory=memory,
            high_memory=high_memory,
            envs=envs,
            key=key,
            num_steps=num_steps,
        )
        return state, metrics | periods.summarise(walked)

    def policy(self, state: HiglState) -> Policy:
        """Returns what acts."""
        return _policy(state.learned)

    def start(self) -> HiglCarry:
        """Returns the carry at the beginning of an episode."""
        zero = jnp.zeros(learning.NUM_SUBGOAL)
        return HiglCarry(subgoal=zero, xy=zero, steps_left=jnp.int32(0))

    def act(
        self, policy: Policy, carry: HiglCarry, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], HiglCarry]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        is_new = carry.steps_left == 0
        chosen = self._learning.manager.act(policy["manager"], self._manager_features(obs))
        subgoal = jnp.where(is_new, chosen, carry.subgoal + carry.xy - obs.xy)
        features = landmarks.controller_features(self.see(obs), subgoal)
        action = self._learning.controller.act(policy["controller"], features)
        left = jnp.where(is_new, jnp.int32(self.options.period), carry.steps_left) - 1
        carry = HiglCarry(subgoal=subgoal, xy=obs.xy, steps_left=left)
        return action / self.options.controller.reach, carry

    def see(self, obs: base.GoalObs) -> Float[Array, " F"]:
        """Returns what both levels see: x and y from the arena's centre, the robot, the time."""
        return jnp.concatenate([self._centred(obs.xy), obs.proprioception, obs.time[None]])

    def _centred(self, xy: Float[Array, "2"]) -> Float[Array, "2"]:
        return xy - jnp.array(self._centre_xy)

    def _manager_features(self, obs: base.GoalObs) -> Float[Array, " M"]:
        return jnp.concatenate([self.see(obs), self._centred(obs.goal_xy)])

    def _walk_round(
        self, policy: Policy, envs: base.EnvState, key: Key[Array, ""]
    ) -> tuple[base.EnvState, periods.Period]:
        """Walks some periods with exploration; leading axes [R, k, N].

        An episode's first subgoal has no noise.
        """
        manager, controller = self._learning.manager, self._learning.controller

        def choose(obs: base.GoalObs, is_first: Bool[Array, ""], key: Key[Array, ""]) -> Array:
            subgoal = manager.act(policy["manager"], self._manager_features(obs))
            return jnp.where(is_first, subgoal, manager.explore(subgoal, key))

        def act(obs: base.GoalObs, subgoal: Array, key: Key[Array, ""]) -> Array:
            features = landmarks.controller_features(self.see(obs), subgoal)
            return controller.explore(controller.act(policy["controller"], features), key)

        def body(envs: base.EnvState, key: Key[Array, ""]) -> tuple[base.EnvState, periods.Period]:
            envs = periods.renew(self._env, envs, envs.is_over)
            return periods.walk(
                self._env,
                envs,
                self.options.period,
                choose,
                act,
                lambda subgoal, obs, next_obs: subgoal + obs.xy - next_obs.xy,
                key,
                reach=self.options.controller.reach,
            )

        return jax.lax.scan(body, envs, jax.random.split(key, self.options.periods_per_round))

    def _rows(self, walked: periods.Period) -> tuple[learning.ControlRow, relabelling.SubgoalRow]:
        """Returns what is stored of a round, with one leading axis each."""
        see = jax.vmap(jax.vmap(jax.vmap(self.see)))
        obs, next_obs = see(walked.obs), see(walked.next_obs)
        left = walked.subgoal + obs[..., :2] - next_obs[..., :2]
        steps = learning.ControlRow(
            obs=obs,
            subgoal=left if self.options.stores_moved_subgoal else walked.subgoal,
            action=walked.action,
            reward=-jnp.sqrt(jnp.square(left).sum(-1)),
            next_obs=next_obs,
            is_end=walked.terminated | walked.truncated,
            # A simulation that breaks down would be an end without a value: nothing costs less.
            is_running=walked.is_running & (walked.metrics["broke_down"] == 0.0),
        )
        subgoals = relabelling.SubgoalRow(
            obs=obs.swapaxes(1, 2),
            action=walked.action.swapaxes(1, 2),
            is_running=walked.is_running.swapaxes(1, 2),
            subgoal=walked.subgoal[:, 0],
            goal_xy=jax.vmap(jax.vmap(self._centred))(walked.obs.goal_xy[:, 0]),
            reward=periods.paid(walked, self.options.costs_time, self.options.reward).sum(1),
            next_obs=next_obs[:, -1],
            next_goal_xy=jax.vmap(jax.vmap(self._centred))(walked.next_obs.goal_xy[:, -1]),
            terminated=periods.is_task_over(walked, self.options.reward),
            truncated=walked.truncated[:, -1],
        )
        return _flat(steps, 3), _flat(subgoals, 2)


def _policy(learned: learning.Learned) -> Policy:
    return {
        "manager": learned.manager.actor_params,
        "controller": learned.controller.actor_params,
    }


def _flat(rows: Any, num_axes: int) -> Any:
    """Makes one leading axis of several."""
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[num_axes:]), rows)
