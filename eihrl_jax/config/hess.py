"""Options of HESS; defaults are those of its released code, but for what the paper says better."""

import dataclasses
from typing import Literal

from eihrl_jax.config import baselines, checks


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sac:
    """HESS's upper level: soft actor-critic with a fixed temperature.

    Attributes:
      hidden: widths of the hidden layers.
      reach: greatest size of a displacement's entries in the subgoal space.
      learning_rate: of Adam.
      temperature: alpha.
      gamma: discount per subgoal.
      target_rate: tau of the moving average.
      batch_size: subgoals per update.
    """

    hidden: tuple[int, ...] = (256, 256)
    reach: float = 20.0
    learning_rate: float = 3e-4
    temperature: float = 0.2
    gamma: float = 0.99
    target_rate: float = 0.005
    batch_size: int = 128

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.widths("hidden", self.hidden)
        checks.in_range("reach", self.reach, above=0.0)
        checks.in_range("learning_rate", self.learning_rate, above=0.0, high=1.0)
        checks.in_range("temperature", self.temperature, 0.0)
        checks.in_range("gamma", self.gamma, 0.0, 1.0)
        checks.in_range("target_rate", self.target_rate, above=0.0, high=1.0)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ddpg:
    """HESS's lower level: deterministic policy gradients.

    Attributes:
      hidden: widths of the actor's hidden layers.
      critic_hidden: widths of the critic's.
      learning_rate: of Adam at the start.
      half_life: control steps of all environments in which it halves, at once.
      critic_decay: weight of the critic's squared parameters, added to their gradient.
      max_grad_norm: to which gradients are clipped.
      gamma: discount per control step.
      target_rate: of the moving averages.
      target_period: updates between their steps.
      noise: standard deviation of what is added to actions while exploring.
      random_share: share of actions that are drawn uniformly while exploring.
      batch_size: control steps per update.
      updates_per_step: updates per control step; released: 200 per episode of 500.
      reward_scale: of minus the distance to the subgoal.
      arrival: distance in the subgoal space at which the subgoal is reached.
    """

    hidden: tuple[int, ...] = (400, 400, 400, 400)
    critic_hidden: tuple[int, ...] = (400, 400, 400, 400, 400)
    learning_rate: float = 2e-4
    half_life: int = 1_500_000
    critic_decay: float = 1e-5
    max_grad_norm: float = 1.0
    gamma: float = 0.99
    target_rate: float = 0.01
    target_period: int = 3
    noise: float = 0.2
    random_share: float = 0.2
    batch_size: int = 128
    updates_per_step: float = 0.4
    reward_scale: float = 0.1
    arrival: float = 0.1

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.widths("hidden", self.hidden)
        checks.widths("critic_hidden", self.critic_hidden)
        checks.in_range("learning_rate", self.learning_rate, above=0.0, high=1.0)
        checks.in_range("half_life", self.half_life, 1, 2**31 - 1)
        checks.in_range("critic_decay", self.critic_decay, 0.0, 1.0)
        checks.in_range("max_grad_norm", self.max_grad_norm, above=0.0)
        checks.in_range("gamma", self.gamma, 0.0, below=1.0)
        checks.in_range("target_rate", self.target_rate, above=0.0, high=1.0)
        checks.in_range("target_period", self.target_period, 1, 1_000)
        checks.in_range("noise", self.noise, 0.0)
        checks.in_range("random_share", self.random_share, 0.0, 1.0)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)
        checks.in_range("updates_per_step", self.updates_per_step, above=0.0, high=100.0)
        checks.in_range("reward_scale", self.reward_scale, above=0.0)
        checks.in_range("arrival", self.arrival, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Representation:
    """HESS's subgoal space.

    Attributes:
      hidden: widths of the hidden layers.
      learning_rate: of Adam.
      batch_size: of pairs, and of anchors, per update.
      num_updates: per block of training.
      every: control steps of all environments between blocks.
      stability: weight of the anchors up to `late_step`; 0.1 in the paper, 0.001 in the released
        code.
      late_stability: weight after it.
      late_step: control steps until then.
      anchored_share: share of the stored steps, those of the least loss, that are anchored.
      anchors: best: that share, as in the paper; rest: all but that share, as in the released code.
      stop_error: training stops once exploration's subgoals of an episode are missed by less, in
        sum; where success leaves little to explore, that is soon. Released: 100 in 50 episodes.
    """

    hidden: tuple[int, ...] = (100, 100)
    learning_rate: float = 1e-4
    batch_size: int = 100
    num_updates: int = 50_000
    every: int = 50_000
    stability: float = 0.1
    late_stability: float = 0.1
    late_step: int = 250_000
    anchored_share: float = 0.3
    anchors: Literal["best", "rest"] = "best"
    stop_error: float = 2.0

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.widths("hidden", self.hidden)
        checks.in_range("learning_rate", self.learning_rate, above=0.0, high=1.0)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)
        checks.in_range("num_updates", self.num_updates, 1, 2**31 - 1)
        checks.in_range("every", self.every, 1, 2**31 - 1)
        checks.in_range("stability", self.stability, 0.0)
        checks.in_range("late_stability", self.late_stability, 0.0)
        checks.in_range("late_step", self.late_step, 0, 2**31 - 1)
        checks.in_range("anchored_share", self.anchored_share, above=0.0, high=1.0)
        checks.one_of("anchors", self.anchors, ("best", "rest"))
        checks.in_range("stop_error", self.stop_error, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exploration:
    """HESS's choice of subgoals to explore with.

    Attributes:
      square: side of the squares into which the subgoal space is hashed.
      gamma: discount of visits in later periods.
      reach: distance in the subgoal space within which subgoals are chosen.
      num_candidates: stored states among which one is chosen.
      miss_weight: of the distances by which subgoals in a square were missed.
      first_step: control steps of all environments before exploration begins.
      potential_step: control steps before misses count and subgoals are extended.
      extension: by how much, away from the robot.
      every: control steps between computations of novelty.
      success_weight: of the success while training; the share is sigmoid(1 - 2 weight success).
    """

    square: float = 3.0
    gamma: float = 0.99
    reach: float = 20.0
    num_candidates: int = 1_000
    miss_weight: float = 10.0
    first_step: int = 50_000
    potential_step: int = 200_000
    extension: float = 5.0
    every: int = 5_000
    success_weight: float = 10.0

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.in_range("square", self.square, above=0.0)
        checks.in_range("gamma", self.gamma, 0.0, 1.0)
        checks.in_range("reach", self.reach, above=0.0)
        checks.in_range("num_candidates", self.num_candidates, 1, 1_000_000)
        checks.in_range("miss_weight", self.miss_weight, 0.0)
        checks.in_range("first_step", self.first_step, 0, 2**31 - 1)
        checks.in_range("potential_step", self.potential_step, 0, 2**31 - 1)
        checks.in_range("extension", self.extension, 0.0)
        checks.in_range("every", self.every, 1, 2**31 - 1)
        checks.in_range("success_weight", self.success_weight, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class HessConfig(baselines.BaselineConfig):
    """HESS (Li et al. 2021): active exploration of a learned, stable subgoal space.

    The released schedules count episodes of 500 control steps; ours count control steps, for mazes
    whose episodes are longer. A round is one episode in every environment. A robot that has reached
    its goal rests until the others' time is up.

    Attributes:
      period: c, control steps per subgoal.
      capacity: episodes that the memory holds, a multiple of `num_envs`.
      high_capacity: subgoals in the manager's memory.
      random_steps: first control steps, in which the manager's subgoals are drawn uniformly.
      costs_time: whether each control step costs the manager 1, which makes rewards of 1 and 0
        those of 0 and -1 of the released code; where they are sparse its targets are clipped to
        between minus the episode's steps and 0. Else entropy, of which the temperature makes up to
        1.5 per subgoal, is worth more than a goal.
      manager: numbers of the upper level.
      controller: numbers of the lower level.
      representation: of the subgoal space.
      exploration: of the choice of subgoals.
    """

    method: str = "hess"
    period: int = 50
    capacity: int = 1_000
    high_capacity: int = 48_000
    random_steps: int = 150_000
    costs_time: bool = True
    manager: Sac = Sac()
    controller: Ddpg = Ddpg()
    representation: Representation = Representation()
    exploration: Exploration = Exploration()

    def __post_init__(self) -> None:
        """Checks ranges, and how the options fit together."""
        baselines.check_arena(self, ("hess",))
        checks.in_range("period", self.period, 1, 10_000)
        checks.in_range("capacity", self.capacity, 1, 2**31 - 1)
        checks.divides("num_envs", self.num_envs, "capacity", self.capacity)
        checks.in_range("high_capacity", self.high_capacity, 1, 2**31 - 1)
        checks.in_range("random_steps", self.random_steps, 0, 2**31 - 1)

    def num_periods(self, episode_steps: int) -> int:
        """Returns the subgoals of an episode, of which time may cut the last one short."""
        return -(-episode_steps // self.period)
