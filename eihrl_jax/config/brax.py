"""Options of Brax's learners, named as their arguments are where nothing else is said."""

import abc
from typing import Annotated

from eihrl_jax.base import UserError
from eihrl_jax.config import checks, limits
from eihrl_jax.config.baselines import BaselineConfig


@limits.dataclass
class BraxConfig(BaselineConfig, abc.ABC):
    """What both learners have.

    Attributes:
      hidden: widths of the hidden layers of all networks.
      learning_rate: of Adam.
      discounting: per control step.
      reward_scaling: factor on rewards.
    """

    num_envs: Annotated[int, limits.Range(1, 2**16)] = 64
    checkpoint_every: limits.UpToMillion = 1
    hidden: limits.Widths = (256, 256)
    learning_rate: limits.Rate = 1e-3
    discounting: limits.Fraction = 0.99
    reward_scaling: limits.Positive = 1.0

    @property
    @abc.abstractmethod
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round."""


@limits.dataclass
class PpoConfig(BraxConfig):
    """PPO of `brax.training`: one level, on-policy (Schulman et al. 2017).

    Attributes:
      unroll_length: control steps of each environment between two looks at the value.
      batch_size: unrolls in a minibatch.
      num_minibatches: that make up a round.
      num_updates_per_batch: passes over a round's steps.
      entropy_cost: weight of the entropy bonus.
      gae_lambda: of generalised advantages.
      clipping_epsilon: how far a policy may move in a round.
    """

    method: Annotated[str, limits.OneOf(("ppo",))] = "ppo"
    log_rounds: limits.UpToMillion = 2
    evaluate_every: limits.UpToMillion = 2
    unroll_length: Annotated[int, limits.Range(1, 10_000)] = 20
    batch_size: limits.BatchSize = 64
    num_minibatches: Annotated[int, limits.Range(1, 10_000)] = 8
    num_updates_per_batch: Annotated[int, limits.Range(1, 1_000)] = 8
    entropy_cost: limits.NonNegative = 1e-3
    gae_lambda: limits.Fraction = 0.95
    clipping_epsilon: limits.Positive = 0.3

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # A round is as many unrolls of all environments as its minibatches hold.
        unrolls = self.batch_size * self.num_minibatches
        checks.divides("num_envs", self.num_envs, "batch_size * num_minibatches", unrolls)

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round."""
        return self.batch_size * self.num_minibatches * self.unroll_length


@limits.dataclass
class SacConfig(BraxConfig):
    """SAC of `brax.training`: one level, off-policy (Haarnoja et al. 2018).

    Attributes:
      iterations_per_round: control steps of each environment per round.
      warmup_steps: control steps of all environments before the first update, `min_replay_size`;
        whole rows of metrics, so that there may be more of them.
      capacity: transitions that the replay holds, `max_replay_size`.
      batch_size: transitions per update.
      grad_updates_per_step: updates per control step of all environments at once.
      tau: how far the target critics follow in an update.
    """

    method: Annotated[str, limits.OneOf(("sac",))] = "sac"
    iterations_per_round: Annotated[int, limits.Range(1, 10_000)] = 10
    warmup_steps: limits.Count = 5_000
    capacity: limits.Count = 1_000_000
    batch_size: limits.BatchSize = 256
    grad_updates_per_step: Annotated[int, limits.Range(1, 1_000)] = 16
    tau: limits.Rate = 0.005

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        if self.warmup_rows * self.steps_per_round * self.log_rounds > self.capacity:
            raise UserError(
                f"warmup_steps = {self.warmup_steps} in whole rows of metrics must be at most "
                f"capacity = {self.capacity}"
            )

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round."""
        return self.num_envs * self.iterations_per_round

    @property
    def warmup_rows(self) -> int:
        """Rows of metrics in which nothing is learned yet."""
        return -(-self.warmup_steps // (self.steps_per_round * self.log_rounds))
