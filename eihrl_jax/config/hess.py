"""Options of HESS; defaults are its released code's, in some points its paper's."""

from typing import Annotated, Literal

from eihrl_jax.config import baselines, checks, limits


@limits.dataclass
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

    hidden: limits.Widths = (256, 256)
    reach: limits.Positive = 20.0
    learning_rate: limits.Rate = 3e-4  # it, widths and moving average: SAC (Haarnoja et al. 2018)
    temperature: limits.NonNegative = 0.2
    gamma: limits.Fraction = 0.99
    target_rate: limits.Rate = 0.005
    batch_size: limits.BatchSize = 128


@limits.dataclass
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

    hidden: limits.Widths = (400, 400, 400, 400)
    critic_hidden: limits.Widths = (400, 400, 400, 400, 400)
    learning_rate: limits.Rate = 2e-4
    half_life: limits.Count = 1_500_000  # 3,000 episodes of the released code
    critic_decay: limits.Fraction = 1e-5
    max_grad_norm: limits.Positive = 1.0
    gamma: Annotated[float, limits.Range(0.0, below=1.0)] = 0.99
    target_rate: limits.Rate = 0.01
    target_period: Annotated[int, limits.Range(1, 1_000)] = 3
    noise: limits.NonNegative = 0.2
    random_share: limits.Fraction = 0.2
    batch_size: limits.BatchSize = 128
    updates_per_step: Annotated[float, limits.Range(above=0.0, high=100.0)] = 0.4  # 200 / 500
    reward_scale: limits.Positive = 0.1
    arrival: limits.NonNegative = 0.1


@limits.dataclass
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

    hidden: limits.Widths = (100, 100)
    learning_rate: limits.Rate = 1e-4
    batch_size: limits.BatchSize = 100
    num_updates: limits.Count = 50_000
    every: limits.Count = 50_000  # 100 episodes of the released code, see `HessConfig`
    stability: limits.NonNegative = 0.1
    late_stability: limits.NonNegative = 0.1
    late_step: limits.CountFromZero = 250_000  # 500 episodes
    anchored_share: Annotated[float, limits.Range(high=1.0, above=0.0)] = 0.3
    anchors: Literal["best", "rest"] = "best"
    stop_error: limits.NonNegative = 2.0


@limits.dataclass
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

    square: limits.Positive = 3.0
    gamma: limits.Fraction = 0.99
    reach: limits.Positive = 20.0
    num_candidates: limits.UpToMillion = 1_000
    miss_weight: limits.NonNegative = 10.0
    first_step: limits.CountFromZero = 50_000  # 100 episodes of the released code
    potential_step: limits.CountFromZero = 200_000  # 400 episodes
    extension: limits.NonNegative = 5.0
    every: limits.Count = 5_000  # 10 episodes
    success_weight: limits.NonNegative = 10.0


@limits.dataclass
class HessConfig(baselines.BaselineConfig):
    """HESS (Li et al. 2021): active exploration of a learned, stable subgoal space.

    The released schedules count episodes of 500 control steps; ours count control steps, for mazes
    whose episodes are longer. A round is one episode in every environment. A robot that has reached
    its goal rests until the others' time is up.

    Attributes:
      period: c, control steps per subgoal.
      capacity: episodes that the replay holds, a multiple of `num_envs`.
      high_capacity: subgoals in the manager's replay.
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

    method: Annotated[str, limits.OneOf(("hess",))] = "hess"
    period: Annotated[int, limits.Range(1, 10_000)] = 50
    capacity: limits.Count = 1_000
    high_capacity: limits.Count = 48_000
    random_steps: limits.CountFromZero = 150_000  # 300 episodes
    costs_time: bool = True
    manager: Sac = Sac()
    controller: Ddpg = Ddpg()
    representation: Representation = Representation()
    exploration: Exploration = Exploration()

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # A round writes one episode of every environment at once.
        checks.divides("num_envs", self.num_envs, "capacity", self.capacity)

    def num_periods(self, episode_steps: int) -> int:
        """Returns the subgoals of an episode, of which time may cut the last one short."""
        return -(-episode_steps // self.period)
