"""PPO and SAC of `brax.training` as baselines: one level, from robot and goal to the controls."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.agents.sac import networks as sac_networks
from flax import serialization, struct
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.baselines.world import World
from eihrl_jax.brax import envs, learners, rows, wrapping
from eihrl_jax.config import brax as brax_config
from eihrl_jax.envs import goal_maze

_OF_THE_MACHINE = ("sps", "walltime", "buffer_current_size")
"""Metrics of Brax that aren't the learner's."""


class AgentState(struct.PyTreeNode):
    """What a run goes on from.

    Attributes:
      params: see `learners.Params`.
      num_steps: int32, control steps of all environments so far.
    """

    params: learners.Params
    num_steps: Int[Array, ""]


class BraxAgent:
    """The functions of a run, see `baselines.interface.RowLearner`.

    Attributes:
      steps_per_round: control steps of all environments together in a round.
    """

    def __init__(self, world: World, options: brax_config.BraxConfig):
        """Builds the networks, by Brax's own factories: what it trains is what acts here."""
        self.steps_per_round = options.steps_per_round
        self._options = options
        self._world = world
        self._training: _Training | None = None
        width, height = world.side_xy
        self._centre_xy = np.array([width / 2.0, -height / 2.0], np.float32)

        sizes = {"hidden_layer_sizes": options.hidden}
        self._factory: learners.Factory = sac_networks.make_sac_networks
        if isinstance(options, brax_config.PpoConfig):
            self._factory = ppo_networks.make_ppo_networks
            sizes = {f"{name}_hidden_layer_sizes": options.hidden for name in ("policy", "value")}
        self._factory = functools.partial(self._factory, **sizes)
        self._num_features = world.num_features(self.see)
        self._networks = self._factory(
            self._num_features,
            world.num_actions,
            preprocess_observations_fn=running_statistics.normalize,
        )

    def init(self, key: Key[Array, ""]) -> AgentState:
        """Returns the initial state of a run."""
        policy_key, value_key = jax.random.split(jax.random.key_data(key))
        statistics = learners.no_statistics(self._num_features)
        params: dict[str, Any] = {
            "normaliser": serialization.to_state_dict(statistics),
            "policy": self._networks.policy_network.init(policy_key),
        }
        if isinstance(self._options, brax_config.PpoConfig):
            params["value"] = self._networks.value_network.init(value_key)
        # Numbers of Python are among them, where training has arrays.
        return AgentState(jax.tree.map(jnp.asarray, params), jnp.int32(0))

    def begin(self, state: AgentState, num_rows: int, log_rounds: int) -> None:
        """Prepares training from a state on; nothing is computed before the first row.

        Args:
          state: the first one.
          num_rows: that are left of the run.
          log_rounds: rounds in a row.
        """
        assert isinstance(self._world.env, goal_maze.GoalMaze)
        self.close()
        env = envs.MazeEnv.of(self._world.env)
        course = learners.Course(
            env=learners.Watched(wrapping.wrap(env, env.episode_steps)),
            factory=self._factory,
            params=state.params,
            # A run that goes on draws other episodes than it began with.
            seed=(self._options.seed + int(state.num_steps)) % 2**31,
            num_rows=num_rows,
            num_waiting=self._num_waiting(num_rows),
            per_row=self.steps_per_round * log_rounds,
        )
        self._training = _Training(self._options, course)

    def next_row(self, state: AgentState) -> tuple[AgentState, dict[str, Array]]:
        """Trains for a row; returns the state after it, and metrics as `Baseline.advance` does."""
        assert self._training is not None
        return self._training.next_row(state)

    def close(self) -> None:
        """Ends training where it is; may be called at any time."""
        if self._training is not None:
            self._training.rows.close()
            self._training = None

    def policy(self, state: AgentState) -> dict[str, base.Params]:
        """Returns the parameters that act."""
        normaliser: Any = state.params["normaliser"]
        shown = {name: normaliser[name] for name in ("mean", "std")}
        return {"normaliser": shown, "policy": state.params["policy"]}

    def start(self) -> tuple[()]:
        """Returns the carry at the beginning of an episode, which is empty."""
        return ()

    def act(
        self, policy: dict[str, base.Params], carry: tuple[()], obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], tuple[()]]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        normaliser: Any = policy["normaliser"]
        statistics = running_statistics.NestedMeanStd(**normaliser)
        networks = self._networks
        logits = networks.policy_network.apply(statistics, policy["policy"], self.see(obs))
        return networks.parametric_action_distribution.mode(logits), carry

    def see(self, obs: base.GoalObs) -> Float[Array, "*B F"]:
        """Returns what the level sees, as `envs.MazeEnv` shows it."""
        return envs.see(obs, self._centre_xy)

    def _num_waiting(self, num_rows: int) -> int:
        """Returns how many of the rows that are left precede learning; one remains at least."""
        if not isinstance(self._options, brax_config.SacConfig):
            return 0
        return min(self._options.warmup_rows, num_rows - 1)


class _Training:
    """A run that is under way.

    Attributes:
      rows: of the learner.
    """

    def __init__(self, options: brax_config.BraxConfig, course: learners.Course):
        """Prepares the learner of the options' method."""
        self._course = course
        self._waiting = course.num_waiting
        if isinstance(options, brax_config.PpoConfig):
            work = functools.partial(learners.run_ppo, options, course)
        else:
            assert isinstance(options, brax_config.SacConfig)
            work = functools.partial(learners.run_sac, options, course)
        self.rows: rows.Rows[learners.Row] = rows.Rows(work)

    def next_row(self, state: AgentState) -> tuple[AgentState, dict[str, Array]]:
        """Trains for a row, see `BraxAgent.next_row`."""
        num_steps = state.num_steps + self._course.per_row
        # Brax reports nothing while it fills the replay, before its first row.
        if self._waiting:
            self._waiting -= 1
            return state.replace(num_steps=num_steps), {"episodes": jnp.zeros(())}

        row = self.rows.next()
        params = jax.tree.map(
            lambda old, new: jnp.asarray(new, old.dtype), state.params, row.params
        )
        learned = {
            f"learner/{name.removeprefix('training/')}": jnp.asarray(value)
            for name, value in row.metrics.items()
            if name.startswith("training/") and not name.endswith(_OF_THE_MACHINE)
        }
        return AgentState(params, num_steps), learned | self._course.env.take()
