"""Success rates and how far they can be trusted (host side, NumPy).

Success is `achieved goals / total goals` (paper, Table 2). In a maze with one goal the episodes are
independent trials and Wilson's interval holds. The goals of one episode are not independent of
each other, so several goals per episode enter with the number of independent trials that explains
the scatter of the episodes. Policies from several training runs are compared by Student's interval
over the runs.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import special

CONFIDENCE = 0.95
NUM_BLOCKS = 5
"""The paper's percentages are multiples of 0.2 and its deviations those of blocks of 100 episodes,
which points at five blocks."""

_NUM_RESAMPLES = 10_000


@dataclasses.dataclass(frozen=True, kw_only=True)
class Success:
    """A success rate with its uncertainty, all in [0, 1].

    Attributes:
      rate: achieved goals / total goals.
      low: lower end of the 95 % interval.
      high: upper end of the 95 % interval.
      block_std: standard deviation over five blocks of episodes, to be compared with the paper's
        plus-minus; None below ten episodes.
    """

    rate: float
    low: float
    high: float
    block_std: float | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunSpread:
    """Success rates of several training runs, all in [0, 1].

    Attributes:
      mean: mean over the runs.
      std: sample standard deviation over the runs.
      low: lower end of Student's 95 % interval of the mean.
      high: upper end of it.
    """

    mean: float
    std: float
    low: float
    high: float


def wilson(rate: float, num_trials: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Computes Wilson's score interval of a proportion.

    Args:
      rate: observed proportion in [0, 1].
      num_trials: number of independent trials; positive, need not be whole.
      confidence: probability of covering the true proportion.

    Returns:
      Lower and upper end, within [0, 1].

    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference,
      Journal of the American Statistical Association 22 (1927).
    """
    # Both ends of the interval are the roots of one quadratic equation in the true proportion.
    z = special.ndtri((1.0 + confidence) / 2.0)
    centre = (rate + z**2 / (2.0 * num_trials)) / (1.0 + z**2 / num_trials)
    spread = math.sqrt(rate * (1.0 - rate) / num_trials + (z / (2.0 * num_trials)) ** 2)
    half = z * spread / (1.0 + z**2 / num_trials)

    # At the ends of the range the interval ends there too; rounding must not move it off.
    low = 0.0 if rate == 0.0 else max(0.0, centre - half)
    high = 1.0 if rate == 1.0 else min(1.0, centre + half)
    return float(low), float(high)


def effective_trials(achieved: Int[np.ndarray, " E"], num_goals: int) -> float:
    """Returns how many independent trials scatter as much as these episodes do.

    A mean of E episodes with fraction p has the variance s²/E, independent trials p(1-p)/n. The two
    are equal at n = E p(1-p) / s², which is E where an episode's goals are reached all or none, and
    `num_goals` E where they are independent. Outside of these limits the nearer one is taken.

    Args:
      achieved: goals reached in each of E episodes.
      num_goals: goals that each episode had.

    Returns:
      Number of trials, between E and `num_goals` E.
    """
    fraction = achieved / num_goals
    num_episodes = len(fraction)
    rate = fraction.mean()
    variance = fraction.var()

    if np.ptp(fraction) == 0.0:
        # All or none of the goals every time says nothing of their independence.
        return float(num_episodes if rate in (0.0, 1.0) else num_episodes * num_goals)

    # n = E p(1-p) / s², see above, kept between all-or-none and independent goals.
    trials = num_episodes * rate * (1.0 - rate) / variance
    return float(np.clip(trials, num_episodes, num_episodes * num_goals))


def block_std(fraction: Float[np.ndarray, " E"], num_blocks: int = NUM_BLOCKS) -> float | None:
    """Returns the sample standard deviation of block means; None below two episodes a block.

    Args:
      fraction: what each episode reached, in [0, 1].
      num_blocks: blocks of consecutive episodes, as equal in size as can be.
    """
    if len(fraction) < 2 * num_blocks:
        return None
    return float(np.std([block.mean() for block in np.array_split(fraction, num_blocks)], ddof=1))


def success(achieved: Int[np.ndarray, " E"], num_goals: int) -> Success:
    """Summarises the episodes of one policy in one maze.

    Args:
      achieved: goals reached in each of E >= 1 episodes.
      num_goals: goals that each episode had.

    Returns:
      The rate with Wilson's interval; see `effective_trials` for several goals.
    """
    rate = float(achieved.sum() / (len(achieved) * num_goals))
    low, high = wilson(rate, effective_trials(achieved, num_goals))
    return Success(rate=rate, low=low, high=high, block_std=block_std(achieved / num_goals))


def student(values: Float[np.ndarray, " N"], confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Computes Student's interval of the mean of N >= 2 independent values, e.g. training runs.

    Args:
      values: one number per run.
      confidence: probability of covering the true mean of normally distributed values.

    Returns:
      Lower and upper end.
    """
    num = len(values)
    # N - 1 degrees of freedom: the standard deviation is estimated from the same values.
    quantile = special.stdtrit(num - 1, (1.0 + confidence) / 2.0)
    half = quantile * np.std(values, ddof=1) / math.sqrt(num)
    mean = np.mean(values)
    return float(mean - half), float(mean + half)


def bootstrap(
    strata: Sequence[Float[np.ndarray, " _"]], confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Computes the bootstrapped interval of the mean over strata, each of the same weight.

    Args:
      strata: independent values of each, e.g. one number per seed in each maze.
      confidence: probability between the interval's ends.

    Returns:
      Lower and upper end, quantiles of the means of resamples.

    Source: R. Agarwal et al., Deep reinforcement learning at the edge of the statistical precipice,
      NeurIPS (2021), Sec. 4.1 (stratified bootstrap).
    """
    # The same numbers for the same values, whoever asks and when.
    rng = np.random.default_rng(0)
    means = np.zeros(_NUM_RESAMPLES)
    for values in strata:
        drawn = rng.integers(len(values), size=(_NUM_RESAMPLES, len(values)))
        means += values[drawn].mean(1) / len(strata)
    low, high = np.quantile(means, [(1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0])
    return float(low), float(high)


def over_runs(rates: Float[np.ndarray, " N"]) -> RunSpread:
    """Summarises the success rates of N >= 2 policies trained alike from different seeds."""
    # Student's interval knows no limits, a rate has them.
    low, high = student(rates)
    return RunSpread(
        mean=float(np.mean(rates)),
        std=float(np.std(rates, ddof=1)),
        low=max(low, 0.0),
        high=min(high, 1.0),
    )


def wasserstein(values: Float[np.ndarray, " S"], sigma: float) -> float:
    """Returns the Wasserstein-1 distance between a sample and N(0, sigma).

    It is the mean difference of quantiles, taken at the sample's (i + 1/2) / S.

    >>> round(wasserstein(np.full(1001, 2.0), 0.3), 3)
    2.0
    """
    ordered = np.sort(values)
    levels = (np.arange(len(ordered)) + 0.5) / len(ordered)  # of the quantiles
    return float(np.abs(ordered - sigma * special.ndtri(levels)).mean())
