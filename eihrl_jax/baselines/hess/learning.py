"""What HESS learns in a round: the controller, the manager, and now and then the subgoal space."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import optimisation, replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.actor_critic import ActorCriticState, Metrics
from eihrl_jax.baselines.hess import episodes as episodes_lib
from eihrl_jax.baselines.hess import exploration, levels, representation
from eihrl_jax.baselines.world import World
from eihrl_jax.config import hess as config_lib


class Learned(struct.PyTreeNode):
    """All that is learned.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      space: the representation.
    """

    manager: ActorCriticState
    controller: ActorCriticState
    space: representation.RepresentationState


class SubgoalRow(struct.PyTreeNode):
    """A stored subgoal: a transition of the manager, and whether it counts."""

    transition: base.Transition
    is_running: Bool[Array, ""]


class HessState(struct.PyTreeNode):
    """Everything needed to resume a run. N: number of environments.

    Attributes:
      learned: both levels and the subgoal space.
      squares: what is known about the squares of the subgoal space.
      episodes: whole episodes.
      high_replay: `SubgoalRow`s.
      envs: environments with leading axis N.
      key: of what comes next.
      success: float32, share of recent episodes in which all goals were visited.
      miss: float32, by how much exploration's subgoals of an episode were missed in sum, recently,
        in the subgoal space; inf: it hasn't begun.
      num_steps: int32, control steps of all environments so far.
    """

    learned: Learned
    squares: exploration.ExplorationState
    episodes: episodes_lib.Episodes
    high_replay: replay.Replay
    envs: base.EnvState
    key: Key[Array, ""]
    success: Float[Array, ""]
    miss: Float[Array, ""]
    num_steps: Int[Array, ""]


def empty_row(num_features: int) -> SubgoalRow:
    """Returns a row whose shapes are those of all rows; the manager's input has `num_features`."""
    obs, zero = jnp.zeros(num_features), jnp.float32(0.0)
    action = jnp.zeros(representation.NUM_SUBGOAL)
    transition = base.Transition(obs, action, reward=zero, discount=zero, next_obs=obs)
    return SubgoalRow(transition=transition, is_running=jnp.zeros((), bool))


class Learning:
    """The functions that learn; holds no state.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      space: the representation.
    """

    def __init__(
        self, num_seen: int, world: World, steps_per_round: int, options: config_lib.HessConfig
    ):
        """Builds networks and optimisers.

        Args:
          num_seen: size F of what both levels see.
          world: where the robots act.
          steps_per_round: control steps of all environments in a round.
          options: of the run.
        """
        self._options, self._world = options, world
        self._steps_per_round = steps_per_round
        size = representation.NUM_SUBGOAL
        # A step costs at most 1, and goals are ends: no value is below that of a whole episode.
        is_bounded = options.costs_time and options.reward == "sparse"
        floor = -float(world.episode_steps) if is_bounded else None
        self.manager = levels.Sac(num_seen + 2, size, options.manager, floor)
        self.controller = levels.Ddpg(num_seen + 2 * size, world.num_actions, options.controller)
        self.space = representation.Representation(num_seen, options.representation)

    def init(self, key: Key[Array, ""]) -> Learned:
        """Draws all parameters."""
        manager_key, controller_key, space_key = jax.random.split(key, 3)
        return Learned(
            manager=self.manager.init(manager_key),
            controller=self.controller.init(controller_key),
            space=self.space.init(space_key),
        )

    def learn(self, state: HessState, key: Key[Array, ""]) -> tuple[HessState, Metrics]:
        """Updates both levels a round's number of times; returns means of what they tell too."""
        low_key, high_key = jax.random.split(key)
        controller, low_metrics = self._learn_controller(state, low_key)

        # As many updates of the manager as there were subgoals.
        draw_key, update_key = jax.random.split(high_key)
        count = self._steps_per_round // self._options.period
        shape = count, self._options.manager.batch_size
        manager, high_metrics = optimisation.loop(
            lambda manager, row, key: self.manager.update(
                manager, row.transition, row.is_running.astype(jnp.float32), key
            ),
            state.learned.manager,
            self._world.draw(state.high_replay, shape, draw_key),
            update_key,
        )
        learned = state.learned.replace(controller=controller, manager=manager)
        metrics = optimisation.means("controller", low_metrics)
        return state.replace(learned=learned), metrics | optimisation.means("manager", high_metrics)

    def train_space(
        self, state: HessState, key: Key[Array, ""]
    ) -> tuple[HessState, Float[Array, ""]]:
        """Trains the subgoal space where that is due; returns the mean loss, else NaN.

        Once trained, it is frozen as soon as exploration misses little.
        """
        options = self._options.representation
        is_due = periods.is_due(state.num_steps, self._steps_per_round, options.every)
        # In the released code anchors weigh less at first; by default they don't here.
        is_late = state.num_steps > options.late_step
        stability = jnp.where(is_late, options.late_stability, options.stability)

        space, losses, loss = jax.lax.cond(
            is_due & ~state.learned.space.is_frozen,
            lambda space: self.space.train(space, state.episodes, stability, key),
            lambda space: (space, state.episodes.loss, jnp.float32(jnp.nan)),
            state.learned.space,
        )

        is_good = (space.num_blocks > 0) & (state.miss < options.stop_error)
        space = space.replace(is_frozen=space.is_frozen | is_good)
        learned, episodes = state.learned.replace(space=space), state.episodes.replace(loss=losses)
        return state.replace(learned=learned, episodes=episodes), loss

    def control_transition(
        self, steps: episodes_lib.Steps
    ) -> tuple[base.Transition, Float[Array, " B"]]:
        """Returns what the controller learns from stored steps, and how much each counts.

        A step from where the subgoal was reached already doesn't count.
        """
        options = self._options.controller
        distance = distance_between(steps.next_embedding, steps.subgoal)
        # The critic's output is the time to the subgoal, which is over where the robot arrives.
        has_arrived = distance <= options.arrival

        transition = base.Transition(
            obs=controller_features(steps.obs, steps.embedding, steps.subgoal),
            action=steps.action,
            reward=-options.reward_scale * distance,
            discount=options.gamma * (1.0 - has_arrived.astype(jnp.float32)),
            next_obs=controller_features(steps.next_obs, steps.next_embedding, steps.subgoal),
        )

        was_there = distance_between(steps.embedding, steps.subgoal) <= options.arrival
        return transition, 1.0 - was_there.astype(jnp.float32)

    def _learn_controller(
        self, state: HessState, key: Key[Array, ""]
    ) -> tuple[ActorCriticState, dict[str, Float[Array, " U"]]]:
        options = self._options.controller
        count = max(1, round(options.updates_per_step * self._steps_per_round))
        drawn = episodes_lib.sample(state.episodes, (count, options.batch_size), key)
        steps = self._world.shard(drawn, axis=1)
        # The learning rate halves at once, as released.
        rate = jnp.exp2(-(state.num_steps // options.half_life).astype(jnp.float32))

        def body(
            controller: ActorCriticState, steps: episodes_lib.Steps
        ) -> tuple[ActorCriticState, Metrics]:
            return self.controller.update(controller, *self.control_transition(steps), rate)

        # DDPG's update draws nothing, so that this loop needs no keys.
        return jax.lax.scan(body, state.learned.controller, steps)


def controller_features(
    seen: Float[Array, "*B F"], embedding: Float[Array, "*B 2"], subgoal: Float[Array, "*B 2"]
) -> Float[Array, "*B C"]:
    """Returns the controller's input: what is seen, where that lies, and where to go."""
    return jnp.concatenate([seen, embedding, subgoal], axis=-1)


def distance_between(
    first: Float[Array, "*B 2"], second: Float[Array, "*B 2"]
) -> Float[Array, "*B"]:
    """Returns the distances of points in the subgoal space."""
    return jnp.sqrt(jnp.square(first - second).sum(-1))
