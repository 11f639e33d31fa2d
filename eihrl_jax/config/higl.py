"""Options of HIGL, HRAC and HIRO; defaults are those of HIGL's released code."""

import dataclasses
from typing import Literal

from eihrl_jax import base
from eihrl_jax.config import baselines, checks

Guidance = Literal["landmarks", "adjacency", "none"]
"""What holds a manager back from subgoals out of reach."""

GUIDANCE: dict[str, Guidance] = {"higl": "landmarks", "hrac": "adjacency", "hiro": "none"}
"""What makes the methods differ."""


@dataclasses.dataclass(frozen=True, kw_only=True)
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

    hidden: tuple[int, ...] = (300, 300)
    reach: float = 1.0
    actor_rate: float = 1e-4
    critic_rate: float = 1e-3
    critic_decay: float = 1e-4
    gamma: float = 0.99
    target_rate: float = 0.005
    noise: float = 1.0
    target_noise: float = 0.2
    target_clip: float = 0.5
    batch_size: int = 128

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.widths("hidden", self.hidden)
        checks.in_range("reach", self.reach, above=0.0)
        checks.in_range("actor_rate", self.actor_rate, above=0.0, high=1.0)
        checks.in_range("critic_rate", self.critic_rate, above=0.0, high=1.0)
        checks.in_range("critic_decay", self.critic_decay, 0.0, 1.0)
        checks.in_range("gamma", self.gamma, 0.0, 1.0)
        checks.in_range("target_rate", self.target_rate, above=0.0, high=1.0)
        checks.in_range("noise", self.noise, 0.0)
        checks.in_range("target_noise", self.target_noise, 0.0)
        checks.in_range("target_clip", self.target_clip, 0.0)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Adjacency:
    """HRAC's adjacency network, which learns how far apart places are in control steps.

    Attributes:
      steps: positions at most so many control steps apart are adjacent; HRAC's and HIGL's numbers
        are meant for a `period` of 10, and each round's steps are told apart from the last one's.
      hidden: widths of the hidden layers.
      num_features: size of the embedding.
      learning_rate: of Adam.
      near: embeddings of adjacent places are drawn nearer than this.
      far: embeddings of other places are pushed farther than this.
      batch_size: pairs of places per update.
      epochs: passes over all pairs of visited places per fit.
      max_updates: most updates per fit.
      period: control steps of all environments between fits.
    """

    steps: int = 4
    hidden: tuple[int, ...] = (128, 128, 128)
    num_features: int = 32
    learning_rate: float = 2e-4
    near: float = 1.0
    far: float = 1.2
    batch_size: int = 64
    epochs: int = 25
    max_updates: int = 50_000
    period: int = 50_000

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.in_range("steps", self.steps, 1, 1_000)
        checks.widths("hidden", self.hidden)
        checks.in_range("num_features", self.num_features, 1, 4096)
        checks.in_range("learning_rate", self.learning_rate, above=0.0, high=1.0)
        checks.in_range("near", self.near, above=0.0)
        checks.in_range("far", self.far, self.near)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)
        checks.in_range("epochs", self.epochs, 1, 10_000)
        checks.in_range("max_updates", self.max_updates, 1, 2**31 - 1)
        checks.in_range("period", self.period, 1, 2**31 - 1)


@dataclasses.dataclass(frozen=True, kw_only=True)
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
      novelty_hidden: widths of the hidden layers of the networks that tell novelty.
      novelty_rate: learning rate of the one that predicts the other.
      first_step: control steps of all environments before which there is no landmark.
      cutoff: least value of an edge; HIGL's -38, made for cells of 4 units.
      near: value of a goal that is near enough to be followed itself; released for goals that are
        walked about in, where landmarks come to lie.
      num_first: nearest landmarks, among which the first one to go to is chosen; those farther off
        lie beyond the cutoff as a rule, and the released code looks at all of them.
      heat: inverse temperature of the softmax that stands for the best path.
      rounds: of doubling the paths' lengths; 6 lead over up to 64 landmarks. Each loses some value
        to the softmax, and the 20 of the released code as much as a way of some cells.
    """

    num_coverage: int = 20
    num_novel: int = 20
    pool: int = 1_000
    per_update: bool = False
    merge_radius: float = 0.2
    novelty_hidden: tuple[int, ...] = (128, 128)
    novelty_rate: float = 1e-3
    first_step: int = 60_000
    cutoff: float = -38.0
    near: float = -10.0
    num_first: int = 24
    heat: float = 0.9
    rounds: int = 6

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.in_range("num_coverage", self.num_coverage, 1, 1_000)
        checks.in_range("num_novel", self.num_novel, 1, 1_000)
        checks.in_range("pool", self.pool, self.num_coverage, 1_000_000)
        checks.in_range("merge_radius", self.merge_radius, 0.0)
        checks.widths("novelty_hidden", self.novelty_hidden)
        checks.in_range("novelty_rate", self.novelty_rate, above=0.0, high=1.0)
        checks.in_range("first_step", self.first_step, 0, 2**31 - 1)
        checks.in_range("cutoff", self.cutoff, high=0.0)
        checks.in_range("near", self.near, high=0.0)
        checks.in_range("num_first", self.num_first, 1, 2_000)
        checks.in_range("heat", self.heat, above=0.0)
        checks.in_range("rounds", self.rounds, 1, 100)


@dataclasses.dataclass(frozen=True, kw_only=True)
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
      capacity: control steps in the controller's memory.
      high_capacity: subgoals in the manager's memory.
      manager: numbers of the upper level; its actions are displacements in units.
      controller: numbers of the lower level.
      adjacency: of the adjacency network.
      landmarks: of the landmarks.
      is_limit_terminal: whether the time limit is an end without a value, and every end one for the
        controller too, as in the released code; else the controller's task never ends.
      stores_moved_subgoal: whether the controller's memory holds the subgoal of after the step
        while the reward is that of before it, as in the released code.
    """

    method: str = "higl"
    guidance: Guidance = "landmarks"
    guidance_weight: float = 20.0
    landmark_distance: float = 2.0
    period: int = 10
    periods_per_round: int = 5
    updates_per_step: float = 1.0
    costs_time: bool = True
    reward_scale: float = 0.1
    num_candidates: int = 12
    capacity: int = 200_000
    high_capacity: int = 100_000
    manager: Td3 = Td3(reach=10.0, gamma=0.99)
    controller: Td3 = Td3(reach=30.0, gamma=0.95)
    adjacency: Adjacency = Adjacency()
    landmarks: Landmarks = Landmarks()
    is_limit_terminal: bool = False
    stores_moved_subgoal: bool = False

    def __post_init__(self) -> None:
        """Checks ranges, and how the options fit together."""
        baselines.check_arena(self, tuple(GUIDANCE))
        if self.guidance != GUIDANCE[self.method]:
            raise base.UserError(
                f"guidance = {self.guidance!r} must be {GUIDANCE[self.method]!r} with method = "
                f"{self.method!r}"
            )
        checks.in_range("guidance_weight", self.guidance_weight, 0.0)
        checks.in_range("landmark_distance", self.landmark_distance, above=0.0)
        checks.in_range("period", self.period, 1, 1_000)
        checks.in_range("periods_per_round", self.periods_per_round, 1, 10_000)
        checks.in_range("updates_per_step", self.updates_per_step, above=0.0, high=100.0)
        checks.in_range("reward_scale", self.reward_scale, above=0.0)
        checks.in_range("num_candidates", self.num_candidates, 1, 1_000)
        checks.in_range("capacity", self.capacity, 1, 2**31 - 1)
        checks.in_range("high_capacity", self.high_capacity, 1, 2**31 - 1)
        subgoals = self.num_envs * self.periods_per_round
        name = "num_envs * periods_per_round"
        checks.divides(f"{name} * period", self.steps_per_round, "capacity", self.capacity)
        checks.divides(name, subgoals, "high_capacity", self.high_capacity)
        if self.guidance != "none":
            most = self.periods_per_round * self.period - 1
            checks.in_range("adjacency.steps", self.adjacency.steps, high=most)
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
