"""Options of the low level's training: input, reward, learner, and the run around them."""

import dataclasses
import pathlib
from typing import Literal, get_args

from eihrl_jax import base
from eihrl_jax.config import checks

Frame = Literal["world", "direction", "canonical"]
"""Frames in which the low level may see the world, see `LowInput`."""


Relabel = Literal["never", "direction", "restart"]
"""Ways to use a stored step for another direction, see `LowConfig`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowInput:
    """How observations become the network's input.

    Attributes:
      frame: "world" as in the paper; "direction": turned such that the subgoal points along x+;
        "canonical": also the robot's parts renamed by its symmetry, such that it faces the subgoal.
      use_progress: adds the displacement since the subgoal was given and the time left.
      velocity_scale: factor on joint velocities and spin. Unscaled they are ten times as large as
        the rest, which they drown in the critics' layer normalisation.
    """

    frame: Frame = "world"
    use_progress: bool = False
    velocity_scale: float = 1.0

    def __post_init__(self) -> None:
        """Checks the frame, which may come from a file."""
        checks.one_of("frame", self.frame, get_args(Frame))
        checks.in_range("velocity_scale", self.velocity_scale, above=0.0, high=100.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowReward:
    """The intrinsic reward, a difference of potentials of the displacement since the subgoal.

    Attributes:
      scale: alpha of eq. 1.
      lateral_weight: price of a unit of sideways drift against a unit of progress; 0 in eq. 1.
      beyond_cell: what progress beyond one cell pays, against progress before: 1 in eq. 1, 0 for
        nothing, -1 where going too far costs as much as going back.
      is_paced: the point beyond which progress pays `beyond_cell` moves steadily from the start to
        one cell ahead in the subgoal's time, so that hurrying gains nothing.
      fall_cost: what a fall costs besides the end of the episode, which it must end; 0 in eq. 1.
    """

    scale: float = 3.0
    lateral_weight: float = 0.0
    beyond_cell: float = 1.0
    is_paced: bool = False
    fall_cost: float = 0.0

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.in_range("scale", self.scale, above=0.0)
        checks.in_range("lateral_weight", self.lateral_weight, 0.0, 10.0)
        checks.in_range("beyond_cell", self.beyond_cell, -1.0, 1.0)
        checks.in_range("fall_cost", self.fall_cost, 0.0, 1000.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Droq:
    """Hyper-parameters of DroQ; defaults of its authors' code for the ant.

    Attributes:
      hidden: widths of the hidden layers of all networks, even numbers.
      num_critics: size M of the ensemble.
      dropout: probability with which a critic's hidden unit is dropped.
      learning_rate: of Adam for actor, critics and temperature, at the start.
      learning_rate_half_life: critic updates in which the learning rate halves, however long the
        run; none: it stays.
      target_rate: tau of the moving average that the target critics are.
      average_rate: of the moving average of the actor, per update of it; 1: the actor itself.
      target_entropy: what the temperature steers the policy's entropy to, nats per action
        dimension; -1/2 gives the authors' -4 for the ant's eight.
      temperature: alpha at the start.
      actor_period: critic updates per update of actor and temperature.
      batch_size: transitions per update.
      gamma: discount per control step.
    """

    hidden: tuple[int, ...] = (256, 256)
    num_critics: int = 2
    dropout: float = 0.01
    learning_rate: float = 3e-4
    learning_rate_half_life: int | None = None
    target_rate: float = 0.005
    average_rate: float = 1.0
    target_entropy: float = -0.5
    temperature: float = 1.0
    actor_period: int = 20
    batch_size: int = 256
    gamma: float = 0.99

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.widths("hidden", self.hidden, least=2)
        for width in self.hidden:
            if width % 2:
                raise base.UserError(f"hidden = {width} must be even")
        checks.in_range("num_critics", self.num_critics, 1, 100)
        checks.in_range("dropout", self.dropout, 0.0, below=1.0)
        checks.in_range("learning_rate", self.learning_rate, above=0.0, high=1.0)
        if self.learning_rate_half_life is not None:
            half_life = self.learning_rate_half_life
            checks.in_range("learning_rate_half_life", half_life, 1, 2**31 - 1)
        checks.in_range("target_rate", self.target_rate, above=0.0, high=1.0)
        checks.in_range("average_rate", self.average_rate, above=0.0, high=1.0)
        checks.in_range("target_entropy", self.target_entropy, -10.0, 10.0)
        checks.in_range("temperature", self.temperature, above=0.0)
        checks.in_range("actor_period", self.actor_period, 1, 1000)
        checks.in_range("batch_size", self.batch_size, 1, 2**20)
        checks.in_range("gamma", self.gamma, 0.0, 1.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowConfig:
    """A training run of the low level.

    Attributes:
      preset: name of the preset that the defaults came from.
      seed: of every random number of the run.
      run: run folder, made by the run.
      resume: continue the run that the folder holds.
      start_from: run folder of the same robot, input, networks, capacity and number of
        environments, with whose learner and memory this run begins; none: it begins anew.
      robot: which robot learns to walk.
      engine: "mujoco" for the C engine on the processor, "mjx" for JAX on an accelerator.
      num_envs: robots that walk at the same time.
      num_iterations: vector steps of the run; env steps divided by `num_envs`.
      warmup_iterations: first vector steps, with random actions and without updates.
      updates_per_iteration: critic updates per vector step.
      capacity: transitions that the replay memory holds, a multiple of `num_envs`.
      relabel: look at drawn steps as if a random direction had been asked for: "direction" since
        the subgoal began, "restart" just now.
      relabel_share: share of the drawn steps that are looked at so.
      num_rooms: random rooms to walk in, every second one with inner walls; 0: open floor alone.
      episode_steps: control steps per episode.
      ends_at_fall: a fall ends the episode; else the robot may learn to get up again.
      low_input: how observations become the network's input.
      reward: the intrinsic reward.
      droq: hyper-parameters of the learner.
      log_every: iterations per row of metrics, and per compiled piece of training.
      evaluate_every: iterations between measurements of the subgoal statistics.
      checkpoint_every: iterations between checkpoints, a multiple of `evaluate_every`.
      num_postures: postures recorded at the end for the high level's pictures.
    """

    preset: str = "paper"
    seed: int = 0
    run: pathlib.Path = pathlib.Path("runs/low")
    resume: bool = False
    start_from: pathlib.Path | None = None
    robot: str = "ant"
    engine: base.EngineName = "mujoco"
    num_envs: int = 1
    num_iterations: int = 400_000
    warmup_iterations: int = 5_000
    updates_per_iteration: int = 20
    capacity: int = 400_000
    relabel: Relabel = "never"
    relabel_share: float = 1.0
    num_rooms: int = 0
    episode_steps: int = 500
    ends_at_fall: bool = True
    low_input: LowInput = LowInput()
    reward: LowReward = LowReward()
    droq: Droq = Droq()
    log_every: int = 1_000
    evaluate_every: int = 10_000
    checkpoint_every: int = 20_000
    num_postures: int = 2048

    def __post_init__(self) -> None:
        """Checks ranges, and how the options fit together."""
        checks.in_range("seed", self.seed, 0, 2**32 - 1)
        checks.one_of("engine", self.engine, base.ENGINES)
        checks.in_range("num_envs", self.num_envs, 1, 2**16)
        checks.in_range("num_iterations", self.num_iterations, 1, 2**31 - 1)
        checks.in_range("warmup_iterations", self.warmup_iterations, 1, 2**31 - 1)
        checks.in_range("updates_per_iteration", self.updates_per_iteration, 1, 1000)
        checks.in_range("capacity", self.capacity, 1, 2**31 - 1)
        checks.divides("num_envs", self.num_envs, "capacity", self.capacity)
        checks.one_of("relabel", self.relabel, get_args(Relabel))
        checks.in_range("relabel_share", self.relabel_share, 0.0, 1.0)
        checks.in_range("num_rooms", self.num_rooms, 0, 4096)
        checks.in_range("episode_steps", self.episode_steps, 1, 100_000)
        checks.in_range("num_postures", self.num_postures, 1, 1_000_000)
        checks.in_range("log_every", self.log_every, 1)
        checks.divides("log_every", self.log_every, "num_iterations", self.num_iterations)
        checks.divides("log_every", self.log_every, "evaluate_every", self.evaluate_every)
        checks.divides(
            "evaluate_every", self.evaluate_every, "checkpoint_every", self.checkpoint_every
        )
        if self.reward.fall_cost and not self.ends_at_fall:
            raise base.UserError(
                f"fall_cost = {self.reward.fall_cost} is the price of a fall that ends an episode: "
                "it must be 0 where ends_at_fall is off"
            )
