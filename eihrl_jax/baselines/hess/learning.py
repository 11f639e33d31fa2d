"""What HESS learns in a round: the controller, the manager, and now and then the subgoal space."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.agents import replay
from eihrl_jax.baselines import periods
from eihrl_jax.baselines.hess import episodes as episodes_lib
from eihrl_jax.baselines.hess import levels, representation
from eihrl_jax.config import hess as config_lib


class Learned(struct.PyTreeNode):
    """All that is learned.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      space: the representation.
    """

    manager: levels.LevelState
    controller: levels.LevelState
    space: representation.RepresentationState


class SubgoalRow(struct.PyTreeNode):
    """A stored subgoal: a transition of the manager, and whether it counts."""

    transition: base.Transition
    is_running: Bool[Array, ""]


class Learning:
    """The functions that learn; holds no state.

    Attributes:
      manager: the upper level.
      controller: the lower level.
      space: the representation.
    """

    def __init__(
        self,
        num_seen: int,
        num_actions: int,
        episode_steps: int,
        steps_per_round: int,
        options: config_lib.HessConfig,
    ):
        """Builds networks and optimisers.

        Args:
          num_seen: size F of what both levels see.
          num_actions: size A of the controller's action.
          episode_steps: control steps of an episode.
          steps_per_round: control steps of all environments in a round.
          options: of the run.
        """
        self._options = options
        self._num_seen = num_seen
        self._steps_per_round = steps_per_round
        size = representation.NUM_SUBGOAL
        is_bounded = options.costs_time and options.reward == "sparse"
        floor = -float(episode_steps) if is_bounded else None
        self.manager = levels.Sac(num_seen + 2, size, options.manager, floor)
        self.controller = levels.Ddpg(num_seen + 2 * size, num_actions, options.controller)
        self.space = representation.Representation(num_seen, options.period, options.representation)

    def init(self, num_steps: int, key: Key[Array, ""]) -> Learned:
        """Draws all parameters; `num_steps` is the length of a stored episode."""
        manager_key, controller_key, space_key = jax.random.split(key, 3)
        return Learned(
            manager=self.manager.init(manager_key),
            controller=self.controller.init(controller_key),
            space=self.space.init((self._options.capacity, num_steps), space_key),
        )

    def subgoal_row(self) -> SubgoalRow:
        """Returns the shapes of one row of the manager's memory, as `replay.init` takes them."""
        number = jax.ShapeDtypeStruct((), jnp.float32)
        obs = jax.ShapeDtypeStruct((self._num_seen + 2,), jnp.float32)
        action = jax.ShapeDtypeStruct((representation.NUM_SUBGOAL,), jnp.float32)
        transition: Any = base.Transition(obs, action, number, number, obs)  # pyright: ignore
        return SubgoalRow(transition, jax.ShapeDtypeStruct((), bool))  # pyright: ignore

    def learn(
        self,
        learned: Learned,
        episodes: episodes_lib.Episodes,
        high_memory: replay.Replay,
        num_steps: Int[Array, ""],
        num_subgoals: int,
        key: Key[Array, ""],
    ) -> tuple[Learned, dict[str, Float[Array, ""]]]:
        """Updates both levels a round's number of times.

        Args:
          learned: what is learned so far.
          episodes: whole episodes.
          high_memory: `SubgoalRow`s.
          num_steps: control steps of all environments so far.
          num_subgoals: of the round, as many as there are updates of the manager.
          key: consumed.

        Returns:
          What is learned now, and means of what the learners tell.
        """
        low_key, high_key = jax.random.split(key)
        controller, low = self._learn_controller(learned.controller, episodes, num_steps, low_key)
        manager, high = self._learn_manager(learned.manager, high_memory, num_subgoals, high_key)
        metrics = {f"controller/{name}": value.mean() for name, value in low.items()}
        metrics |= {f"manager/{name}": value.mean() for name, value in high.items()}
        return learned.replace(controller=controller, manager=manager), metrics

    def train_space(
        self,
        learned: Learned,
        episodes: episodes_lib.Episodes,
        num_steps: Int[Array, ""],
        miss: Float[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[Learned, Float[Array, ""]]:
        """Trains the subgoal space where that is due; returns the loss, else NaN.

        Once trained, it is frozen as soon as `miss`, see `HessState`, is little.
        """
        options = self._options.representation
        is_due = periods.is_due(num_steps, self._steps_per_round, options.every)
        stability = jnp.where(
            num_steps > options.late_step, options.late_stability, options.stability
        )
        space, loss = jax.lax.cond(
            is_due & ~learned.space.is_frozen,
            lambda space: self.space.train(space, episodes.stored, stability, key),
            lambda space: (space, jnp.float32(jnp.nan)),
            learned.space,
        )
        is_good = (space.num_blocks > 0) & (miss < options.stop_error)
        return learned.replace(space=space.replace(is_frozen=space.is_frozen | is_good)), loss

    def control_transition(
        self, steps: episodes_lib.Steps
    ) -> tuple[base.Transition, Float[Array, " B"]]:
        """Returns what the controller learns from stored steps, and how much each counts.

        A step from where the subgoal was reached already doesn't count.
        """
        options = self._options.controller
        distance = _distance(steps.next_place, steps.subgoal)
        has_arrived = distance <= options.arrival
        transition = base.Transition(
            obs=jnp.concatenate([steps.obs, steps.place, steps.subgoal], axis=-1),
            action=steps.action,
            reward=-options.reward_scale * distance,
            discount=options.gamma * (1.0 - has_arrived.astype(jnp.float32)),
            next_obs=jnp.concatenate([steps.next_obs, steps.next_place, steps.subgoal], axis=-1),
        )
        was_there = _distance(steps.place, steps.subgoal) <= options.arrival
        return transition, 1.0 - was_there.astype(jnp.float32)

    def _learn_controller(
        self,
        controller: levels.LevelState,
        episodes: episodes_lib.Episodes,
        num_steps: Int[Array, ""],
        key: Key[Array, ""],
    ) -> tuple[levels.LevelState, dict[str, Float[Array, " U"]]]:
        options = self._options.controller
        count = max(1, round(options.updates_per_step * self._steps_per_round))
        # Drawn at once, outside the loop over updates: XLA would copy the memory into that loop.
        steps = episodes_lib.sample(episodes, (count, options.batch_size), key)
        halvings = num_steps // options.half_life
        rate = jnp.exp2(-halvings.astype(jnp.float32))

        def body(
            state: levels.LevelState, steps: episodes_lib.Steps
        ) -> tuple[levels.LevelState, dict[str, Array]]:
            return self.controller.update(state, *self.control_transition(steps), rate)

        return jax.lax.scan(body, controller, steps)

    def _learn_manager(
        self,
        manager: levels.LevelState,
        high_memory: replay.Replay,
        count: int,
        key: Key[Array, ""],
    ) -> tuple[levels.LevelState, dict[str, Float[Array, " U"]]]:
        draw_key, update_key = jax.random.split(key)
        shape = count, self._options.manager.batch_size
        rows = replay.sample(high_memory, shape, draw_key)

        def body(state: levels.LevelState, xs: Any) -> tuple[levels.LevelState, dict[str, Array]]:
            row, key = xs
            weight = row.is_running.astype(jnp.float32)
            return self.manager.update(state, row.transition, weight, key)

        return jax.lax.scan(body, manager, (rows, jax.random.split(update_key, count)))


def _distance(first: Float[Array, "*B 2"], second: Float[Array, "*B 2"]) -> Float[Array, "*B"]:
    return jnp.sqrt(jnp.square(first - second).sum(-1))
