"""Options of HIGL, HRAC and HIRO; defaults are those of HIGL's released code."""

from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import baselines, checks, limits

Guidance = Literal["landmarks", "adjacency", "none"]
"""What holds a manager back from subgoals out of reach."""

GUIDANCE: dict[str, Guidance] = {"higl": "landmarks", "hrac": "adjacency", "hiro": "none"}
"""What makes the methods differ."""


@limits.dataclass
class Td3:
    """One level of HIGL: TD3 (Fujimoto et al. 2018) as its released code has it.

    Attributes:
      hidden: widths of the hidden layers of actor and critics.
      reach: greatest size of an action's entries; the robot's controls are actions / reach.
      actor_rate: learning rate of the actor.
      critic_rate: learning rate of the critics.
      critic_decay: weight of the critics' squared parameters, added to their gradient as in Adam
        with L2 regularisation.
      gamma: discount per action.
      target_rate: tau of the moving averages.
      noise: standard deviation of what is added to actions while exploring.
      target_noise: the same in the critics' targets.
      target_clip: limit to which the latter is clipped.
      batch_size: transitions per update.
    """

    hidden: limits.Widths = (300, 300)  # HIRO's
    reach: limits.Positive = 1.0
    actor_rate: limits.Rate = 1e-4
    critic_rate: limits.Rate = 1e-3
    critic_decay: limits.Fraction = 1e-4
    gamma: limits.Fraction = 0.99
    target_rate: limits.Rate = 0.005  # it, noise of targets and its limit: TD3's own
    noise: limits.NonNegative = 1.0
    target_noise: limits.NonNegative = 0.2
    target_clip: limits.NonNegative = 0.5
    batch_size: limits.BatchSize = 128


@limits.dataclass
class Adjacency:
    """HRAC's adjacency network, which learns how far apart positions are in control steps.

    Attributes:
      steps: positions at most so many control steps apart are adjacent; HRAC's and HIGL's numbers
        are meant for a `period` of 10, and each round's steps are told apart from the last one's.
      hidden: widths of the hidden layers.
      num_features: size of the embedding.
      learning_rate: of Adam.
      near: embeddings of adjacent positions are drawn nearer than this.
      far: embeddings of other positions are pushed farther than this.
      batch_size: pairs of positions per update.
      epochs: passes over all pairs of visited positions per fit.
      max_updates: most updates per fit.
      period: control steps of all environments between fits.
    """

    steps: Annotated[int, limits.Range(1, 1_000)] = 4
    hidden: limits.Widths = (128, 128, 128)
    num_features: Annotated[int, limits.Range(1, 4096)] = 32
    learning_rate: limits.Rate = 2e-4
    near: limits.Positive = 1.0
    far: float = 1.2  # HRAC's margin of 0.2 above `near`
    batch_size: limits.BatchSize = 64
    epochs: Annotated[int, limits.Range(1, 10_000)] = 25
    max_updates: limits.Count = 50_000
    period: limits.Count = 50_000

    def __post_init__(self) -> None:
        """Checks that what is pushed apart isn't drawn together."""
        checks.in_range("far", self.far, self.near)


@limits.dataclass
class Landmarks:
    """HIGL's landmarks and the graph that chooses one of them for the manager to follow.

    Attributes:
      num_coverage: landmarks that are spread over what has been visited.
      num_novel: landmarks that were the most novel when they were visited.
      pool: stored steps from which the former are chosen.
      per_update: whether they and the graph are made anew for each update of the manager, as
        released, or once per round.
      merge_radius: novel landmarks nearer than this to a newer visit, or to a more novel one that
        is as new, are dropped, units.
      novelty_hidden: widths of the hidden layers of the networks that measure novelty.
      novelty_rate: learning rate of the one that predicts the other.
      first_step: control steps of all environments before which there is no landmark.
      cutoff: least value of an edge; HIGL's -38, made for cells of 4 units.
      near: value of a goal that is near enough to be followed itself; released for goals that are
        crossed on the way, where landmarks come to lie.
      num_first: nearest landmarks, among which the first one to go to is chosen; those farther off
        lie beyond the cutoff as a rule, and the released code looks at all of them.
      heat: inverse temperature of the softmax that stands for the best path.
      rounds: of doubling the paths' lengths; 6 lead over up to 64 landmarks. Each loses some value
        to the softmax, and the 20 of the released code as much as a way of some cells.
    """

    num_coverage: Annotated[int, limits.Range(1, 1_000)] = 20
    num_novel: Annotated[int, limits.Range(1, 1_000)] = 20
    pool: limits.UpToMillion = 1_000
    per_update: bool = False
    merge_radius: limits.NonNegative = 0.2
    novelty_hidden: limits.Widths = (128, 128)
    novelty_rate: limits.Rate = 1e-3
    first_step: limits.CountFromZero = 60_000
    cutoff: Annotated[float, limits.Range(high=0.0)] = -38.0
    near: Annotated[float, limits.Range(high=0.0)] = -10.0
    num_first: Annotated[int, limits.Range(1, 2_000)] = 24
    heat: limits.Positive = 0.9
    rounds: Annotated[int, limits.Range(1, 100)] = 6  # 2**6 landmarks

    def __post_init__(self) -> None:
        """Checks that there are enough steps to choose from."""
        checks.in_range("pool", self.pool, self.num_coverage)


@limits.dataclass
class HiglConfig(baselines.BaselineConfig):
    """HIGL (Kim et al. 2021), and what it grew from: HRAC (Zhang et al. 2020), HIRO (Nachum 2018).

    A manager names a displacement of the torso every k control steps, a controller carries it out;
    both are TD3. The manager is held to subgoals that can be reached. An episode's last period may
    end with the episode, in which case the robot rests until the period is over.

    Attributes:
      guidance: what holds the manager back, see `GUIDANCE`.
      guidance_weight: of the term in the manager's loss that does it.
      landmark_distance: how far towards its landmark the manager is asked to go, units.
      period: k, control steps per subgoal.
      periods_per_round: subgoals of each environment between updates.
      updates_per_step: of the controller and of the novelty per control step; the manager is
        updated once where the controller is updated k times.
      costs_time: whether each control step costs the manager 1, which makes rewards of 1 and 0
        those of 0 and -1 of the released code. Else the guidance outweighs a goal a hundred times.
      reward_scale: of the manager's reward.
      num_candidates: subgoals among which the off-policy correction chooses; 1: no correction.
      capacity: control steps in the controller's replay.
      high_capacity: subgoals in the manager's replay.
      manager: numbers of the upper level; its actions are displacements in units.
      controller: numbers of the lower level.
      adjacency: of the adjacency network.
      landmarks: of the landmarks.
      is_limit_terminal: whether the time limit is an end without a value, and every end one for the
        controller too, as in the released code; else the controller's task never ends.
      stores_moved_subgoal: whether the controller's replay holds the subgoal of after the step
        while the reward is that of before it, as in the released code.
    """

    method: Annotated[str, limits.OneOf(tuple(GUIDANCE))] = "higl"
    guidance: Guidance = "landmarks"
    guidance_weight: limits.NonNegative = 20.0
    landmark_distance: limits.Positive = 2.0
    period: Annotated[int, limits.Range(1, 1_000)] = 10
    periods_per_round: Annotated[int, limits.Range(1, 10_000)] = 5
    updates_per_step: Annotated[float, limits.Range(above=0.0, high=100.0)] = 1.0
    costs_time: bool = True
    reward_scale: limits.Positive = 0.1
    num_candidates: Annotated[int, limits.Range(1, 1_000)] = 12
    capacity: limits.Count = 200_000
    high_capacity: limits.Count = 100_000
    # Controls of the released ant reach to 30; 0.95 looks two periods ahead.
    manager: Td3 = Td3(reach=10.0, gamma=0.99)
    controller: Td3 = Td3(reach=30.0, gamma=0.95)
    adjacency: Adjacency = Adjacency()
    landmarks: Landmarks = Landmarks()
    is_limit_terminal: bool = False
    stores_moved_subgoal: bool = False

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        if self.guidance != GUIDANCE[self.method]:
            raise base.UserError(
                f"guidance = {self.guidance!r} must be {GUIDANCE[self.method]!r} with method = "
                f"{self.method!r}"
            )

        # Each replay takes a whole round at a time, and never around its end.
        subgoals = self.num_envs * self.periods_per_round
        name = "num_envs * periods_per_round"
        checks.divides(f"{name} * period", self.steps_per_round, "capacity", self.capacity)
        checks.divides(name, subgoals, "high_capacity", self.high_capacity)
        # Pairs of positions come from one round, in which no two are farther apart than its steps.
        if self.guidance != "none":
            # Both ends of a pair lie in one round, see `Adjacency.steps`.
            most = self.periods_per_round * self.period - 1
            checks.in_range("adjacency.steps", self.adjacency.steps, high=most)
        # It is updated once where the controller is updated k times.
        if self.num_high_updates < 1:
            raise base.UserError(
                f"updates_per_step = {self.updates_per_step} gives the manager no update in a "
                f"round of {subgoals} subgoals"
            )

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round."""
        return self.num_envs * self.periods_per_round * self.period

    @property
    def num_updates(self) -> int:
        """Updates of the controller per round."""
        return round(self.steps_per_round * self.updates_per_step)

    @property
    def num_high_updates(self) -> int:
        """Updates of the manager per round."""
        return self.num_updates // self.period
