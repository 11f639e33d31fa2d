"""Options of the low level's training: input, reward, learner, and the run around them."""

import pathlib
from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import checks, limits

Frame = Literal["world", "direction", "canonical"]
"""Frames in which the low level may see the world, see `LowInput`."""


Relabel = Literal["never", "direction", "restart"]
"""Ways to use a stored step for another direction, see `LowConfig`."""


@limits.dataclass
class LowInput:
    """How observations become the network's input.

    Attributes:
      frame: "world" as in the paper; "direction": turned such that the subgoal points along x+;
        "canonical": also the robot's parts renamed by its symmetry, such that it faces the subgoal.
      use_progress: adds the displacement since the subgoal was given and the time left.
      velocity_scale: factor on joint velocities and spin. Unscaled they are ten times as large as
        the rest, which they drown in the critics' layer normalisation.
      full_range: actions move servos as far as the robot may when it gets up, see `recovery_range`
        of `robots.robot.Robot`.
    """

    frame: Frame = "world"
    use_progress: bool = False
    velocity_scale: Annotated[float, limits.Range(above=0.0, high=100.0)] = 1.0
    full_range: bool = False


@limits.dataclass
class LowReward:
    """The intrinsic reward, a difference of potentials of the displacement since the subgoal.

    Attributes:
      scale: alpha of eq. 1; 0 for a robot that only has to stand.
      lateral_weight: penalty of sideways drift, relative to progress; 0 in eq. 1.
      beyond_cell: reward of progress beyond one cell, relative to progress before: 1 in eq. 1, 0
        for none, -1 if going too far costs as much as going back.
      is_paced: the point from which on `beyond_cell` applies moves steadily from the start to one
        cell ahead in the subgoal's time, so that hurrying gains nothing.
      fall_cost: penalty of a fall, which must then end the episode; 0 in eq. 1.
      standing: reward of a control step upright and at full height, relative to one on its back; 0
        in eq. 1.
    """

    scale: Annotated[float, limits.Range(0.0, 1000.0)] = 3.0  # paper, Table 4
    lateral_weight: Annotated[float, limits.Range(0.0, 10.0)] = 0.0
    beyond_cell: Annotated[float, limits.Range(-1.0, 1.0)] = 1.0
    is_paced: bool = False
    fall_cost: Annotated[float, limits.Range(0.0, 1000.0)] = 0.0
    standing: Annotated[float, limits.Range(0.0, 1000.0)] = 0.0


@limits.dataclass
class Droq:
    """Hyper-parameters of DroQ; defaults of its authors' code for the ant.

    Attributes:
      hidden: widths of the hidden layers of all networks, even numbers.
      num_critics: size M of the ensemble.
      dropout: probability with which a critic's hidden unit is dropped.
      learning_rate: of Adam for actor, critics and temperature, at the start.
      learning_rate_half_life: critic updates in which the learning rate halves, however long the
        run; none: it stays.
      target_rate: tau, rate of the target critics' moving average.
      average_rate: of the moving average of the actor, per update of it; 1: the actor itself.
      target_entropy: entropy that the temperature steers the policy to, nats per action
        dimension; -1/2 gives the authors' -4 for the ant's eight.
      temperature: alpha at the start.
      actor_period: critic updates per update of actor and temperature.
      batch_size: transitions per update.
      gamma: discount per control step.
    """

    hidden: tuple[Annotated[int, limits.Range(2, 4096)], ...] = (256, 256)
    num_critics: Annotated[int, limits.Range(1, 100)] = 2  # REDQ's ten, less what dropout replaces
    dropout: Annotated[float, limits.Range(0.0, below=1.0)] = 0.01  # the ant's in DroQ's paper
    learning_rate: limits.Rate = 3e-4
    learning_rate_half_life: limits.Count | None = None
    target_rate: limits.Rate = 0.005
    average_rate: limits.Rate = 1.0
    target_entropy: Annotated[float, limits.Range(-10.0, 10.0)] = -0.5
    temperature: limits.Positive = 1.0
    actor_period: Annotated[int, limits.Range(1, 1000)] = 20  # once per step in the paper's preset
    batch_size: limits.BatchSize = 256
    gamma: limits.Fraction = 0.99

    def __post_init__(self) -> None:
        """Checks that layers have an even number of units: dropout decides about two at once."""
        for width in self.hidden:
            if width % 2:
                raise base.UserError(f"hidden = {width} must be even")


@limits.dataclass
class LowConfig:
    """A training run of the low level.

    Attributes:
      preset: where the defaults come from: paper, best, point, swimmer, humanoid or stand.
      seed: of every random number of the run.
      run: run folder, made by the run.
      resume: continue the run that the folder holds.
      start_from: run folder of the same robot, input, networks, capacity and number of
        environments, with whose learner and replay this run begins; none: it begins anew.
      robot: which robot is trained.
      engine: "mujoco" for the C engine on the processor, "mjx" for JAX on an accelerator.
      num_envs: environments that run at the same time, one robot in each.
      num_iterations: vector steps of the run; env steps divided by `num_envs`.
      warmup_iterations: first vector steps, with uniform actions and without updates.
      updates_per_iteration: critic updates per vector step.
      capacity: transitions in the replay, a multiple of `num_envs`.
      relabel: give replayed steps a random direction: "direction" from the start of their subgoal
        on, "restart" from this step on, as the first one of a new subgoal.
      relabel_share: share of the replayed steps that are changed so.
      num_rooms: random rooms to train in, every second one with inner walls; 0: open floor alone.
      corridor_share: share of the random rooms that are corridors of one cell's width; there
        directions are free and subgoals count from the middle of the robot's cell, as in a maze.
      start_jitter: half-width of the uniform offset of a robot's start from the middle of its cell,
        units.
      anchored: in all rooms subgoals count from the middle of the robot's cell, as in a maze.
      episode_steps: control steps per episode.
      ends_at_fall: a fall ends the episode; else the robot may learn to get up again.
      thrown_share: share of the episodes in which the robot is thrown, in any posture.
      low_input: how observations become the network's input.
      reward: the intrinsic reward.
      droq: hyper-parameters of the learner.
      log_every: iterations per row of metrics, and per compiled piece of training.
      evaluate_every: iterations between measurements of the subgoal statistics.
      checkpoint_every: iterations between checkpoints, a multiple of `evaluate_every`.
      num_postures: postures recorded at the end for the high level's pictures.
      num_devices: devices of each process that share environments, replay and batches; None: as
        many as can share them evenly, on CPU one, which uses all cores.
      coordinator: host:port of process 0, for a run of several processes on one or more hosts;
        "auto": found in the environment of the cluster.
      num_processes: processes of the run.
      process_id: number of this process, from 0.

    >>> from eihrl_jax.config import presets
    >>> presets.LOW["point"].robot
    'point'
    """

    preset: str = "paper"
    seed: limits.Seed = 0
    run: pathlib.Path = pathlib.Path("runs/low")
    resume: bool = False
    start_from: pathlib.Path | None = None
    robot: str = "ant"
    engine: base.EngineName = "mujoco"
    num_envs: Annotated[int, limits.Range(1, 2**16)] = 1
    num_iterations: limits.Count = 400_000
    warmup_iterations: limits.Count = 5_000
    updates_per_iteration: Annotated[int, limits.Range(1, 1000)] = 20
    capacity: limits.Count = 400_000  # the whole run
    relabel: Relabel = "never"
    relabel_share: limits.Fraction = 1.0
    num_rooms: Annotated[int, limits.Range(0, 4096)] = 0
    corridor_share: limits.Fraction = 0.0
    start_jitter: Annotated[float, limits.Range(0.0, 1.4)] = 0.2
    anchored: bool = False
    episode_steps: Annotated[int, limits.Range(1, 100_000)] = 500  # 20 subgoals of the ant
    ends_at_fall: bool = True
    thrown_share: limits.Fraction = 0.0
    low_input: LowInput = LowInput()
    reward: LowReward = LowReward()
    droq: Droq = Droq()
    log_every: Annotated[int, limits.Range(1)] = 1_000
    evaluate_every: int = 10_000
    checkpoint_every: int = 20_000
    num_postures: limits.UpToMillion = 2048
    num_devices: Annotated[int, limits.Range(1, 1024)] | None = None
    coordinator: str | None = None
    num_processes: int | None = None
    process_id: int | None = None

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # A step of all robots is one row of the replay; files are written between compiled pieces.
        checks.divides("num_envs", self.num_envs, "capacity", self.capacity)
        # Training is compiled in pieces of `log_every` iterations, and stops only between them.
        checks.divides("log_every", self.log_every, "num_iterations", self.num_iterations)
        checks.divides("log_every", self.log_every, "evaluate_every", self.evaluate_every)
        checks.divides(
            "evaluate_every", self.evaluate_every, "checkpoint_every", self.checkpoint_every
        )

        if self.reward.fall_cost and not self.ends_at_fall:
            raise base.UserError(
                f"fall_cost = {self.reward.fall_cost} is for falls that end an episode: it must be "
                "0 with ends_at_fall = False"
            )
