"""Training with Brax's own PPO and SAC functions, which run from the first step to the last.

Both are called as they are. What is read from them in between, and given back to them when a run
goes on, are the normaliser and the policy and, of PPO, the values: the rest of their state they
keep to themselves.
"""

import contextlib
import dataclasses
import pathlib
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from brax.training.acme import running_statistics, specs
from brax.training.agents.ppo import train as ppo
from brax.training.agents.sac import checkpoint as sac_checkpoint
from brax.training.agents.sac import train as sac
from flax import serialization
from jaxtyping import Array

from eihrl_jax import base
from eihrl_jax.baselines import periods
from eihrl_jax.brax import devices
from eihrl_jax.config import brax as brax_config

Params = dict[str, base.Params]
"""Of the normaliser, the policy and, of PPO, the values, by these names."""

Factory: TypeAlias = Callable[..., Any]
"""Brax's factory of networks, whose type says no more."""


class Row(NamedTuple):
    """What Brax's callback receives at the end of a row of metrics."""

    params: Params
    metrics: Mapping[str, Any]


Tell: TypeAlias = Callable[[Row], None]


class Watched(envs.Wrapper):
    """A wrapped environment that sums up the episodes which end in it."""

    def __init__(self, env: envs.Wrapper):
        """Takes the environment."""
        super().__init__(env)
        self._sums: dict[str, float] = {}

    def step(self, state: envs.State, action: Array) -> envs.State:
        """Advances one step; B rows."""
        state = self.env.step(state, action)
        metrics = {name: state.info["episode_metrics"][name] for name in state.metrics}
        jax.debug.callback(self._add, periods.sum_ends(state.done > 0.0, metrics))
        return state

    def take(self) -> dict[str, Array]:
        """Returns the sums since the last call, see `baselines.interface.Baseline.advance`."""
        jax.effects_barrier()  # what was computed has then been added
        sums, self._sums = self._sums, {}
        return {name: jnp.float32(value) for name, value in sums.items()}

    def _add(self, sums: dict[str, Array]) -> None:
        for name, value in sums.items():
            self._sums[name] = self._sums.get(name, 0.0) + float(np.sum(value))


@dataclasses.dataclass(frozen=True)
class Course:
    """What is left of a run.

    Attributes:
      env: in which robots learn, wrapped.
      factory: of the networks.
      params: to begin with.
      seed: of what is left.
      num_rows: of metrics that are left.
      num_waiting: of them, in which SAC only fills its replay.
      per_row: control steps of all environments in a row.
    """

    env: Watched
    factory: Factory
    params: Params
    seed: int
    num_rows: int
    num_waiting: int
    per_row: int

    def arguments(self, options: brax_config.BraxConfig) -> dict[str, Any]:
        """Returns what both learners are given."""
        return {
            "environment": self.env,
            "eval_env": self.env.env,
            # Wrapped already; with `wrap_env=False` SAC of Brax 0.14.2 fails.
            "wrap_env_fn": lambda env, **_: env,
            "num_timesteps": self.num_rows * self.per_row,
            "num_envs": options.num_envs,
            # Evaluations are ours; SAC's own, without which it can't do, are one step of one robot.
            "num_eval_envs": 1,
            "episode_length": 1,
            "learning_rate": options.learning_rate,
            "discounting": options.discounting,
            "reward_scaling": options.reward_scaling,
            "normalize_observations": True,
            "network_factory": self.factory,
            "max_devices_per_host": options.num_devices or 1,
            "seed": self.seed,
        }


def no_statistics(num_features: int) -> running_statistics.RunningStatisticsState:
    """Returns the normaliser that has seen nothing of F features."""
    return running_statistics.init_state(specs.Array((num_features,), jnp.dtype("float32")))


def run_ppo(options: brax_config.PpoConfig, course: Course, tell: Tell) -> None:
    """Trains by PPO to the end of the course, and reports every row."""
    normaliser, policy = for_brax(course.params)
    latest: list[Any] = []

    def keep(num_steps: int, make_policy: object, params: tuple[Any, ...]) -> None:
        del num_steps, make_policy
        latest[:] = params

    with _lenient():
        ppo.train(
            **course.arguments(options),
            batch_size=options.batch_size,
            unroll_length=options.unroll_length,
            num_minibatches=options.num_minibatches,
            num_updates_per_batch=options.num_updates_per_batch,
            entropy_cost=options.entropy_cost,
            gae_lambda=options.gae_lambda,
            clipping_epsilon=options.clipping_epsilon,
            restore_params=(normaliser, policy, course.params["value"]),
            num_evals=course.num_rows + 1,
            run_evals=False,
            policy_params_fn=keep,
            # Called after `keep` of the same step.
            progress_fn=lambda _, metrics: tell(Row(from_brax(latest), metrics)),
        )


def run_sac(options: brax_config.SacConfig, course: Course, tell: Tell) -> None:
    """Trains by SAC to the end of the course, and reports every row after the warm-up."""
    normaliser, policy = for_brax(course.params)

    def begin_with(state: Any) -> Any:
        return state.replace(normalizer_params=normaliser, policy_params=policy)

    # Brax 0.14.2 can't begin with what its SAC has written, so that it is put in on the way.
    with tempfile.TemporaryDirectory() as folder, _lenient(begin_with):

        def progress(num_steps: int, metrics: Mapping[str, Any]) -> None:
            # SAC tells its parameters to files alone.
            path = pathlib.Path(folder) / f"{num_steps:012d}"
            if path.is_dir():  # not so before the first step
                params = sac_checkpoint.load(str(path))
                shutil.rmtree(path)
                tell(Row(from_brax(params), metrics))

        sac.train(
            **course.arguments(options),
            batch_size=options.batch_size,
            min_replay_size=course.num_waiting * course.per_row,
            max_replay_size=options.capacity,
            grad_updates_per_step=options.grad_updates_per_step,
            tau=options.tau,
            num_evals=course.num_rows - course.num_waiting + 1,
            checkpoint_logdir=folder,
            progress_fn=progress,
        )


def _lenient(begin_with: Callable[[Any], Any] = lambda state: state) -> contextlib.ExitStack:
    """Lets Brax compute as it does by itself, whatever JAX's settings are; see `replicating`."""
    stack = contextlib.ExitStack()
    stack.enter_context(devices.replicating(begin_with))
    stack.enter_context(jax.numpy_dtype_promotion("standard"))
    stack.enter_context(jax.numpy_rank_promotion("allow"))
    return stack


def for_brax(params: Params) -> tuple[running_statistics.RunningStatisticsState, base.Params]:
    """Returns normaliser and policy as Brax has them."""
    told: Any = params["normaliser"]
    (num_features,) = told["mean"].shape
    normaliser: Any = serialization.from_state_dict(no_statistics(num_features), told)
    return normaliser, params["policy"]


def from_brax(params: Sequence[Any]) -> Params:
    """Inverse of `for_brax`, for the parameters of either learner."""
    normaliser, *others = params
    named = dict(zip(("policy", "value"), others, strict=False))  # SAC tells no values
    told = {"normaliser": serialization.to_state_dict(normaliser), **named}
    return jax.tree.map(jnp.asarray, told)
