"""Options of the baselines: the arena that all of them share, and those of flat DroQ."""

import dataclasses
import pathlib
from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.config import low as low_config

Goals = Literal["own", "anywhere"]
"""Where goals lie in training, see `BaselineConfig`."""

LEVELS = ("learner", "manager", "controller")
"""Names of the options of a method's levels, whose batches devices share."""


@limits.dataclass
class BaselineConfig:
    """What all baselines share: the arena and the run around them.

    Attributes:
      method: droq, higl, hrac, hiro, hess, ppo or sac, each with options and defaults of its own.
      seed: of every random number of the run.
      run: run folder, made by the run.
      resume: continue the run that the folder holds.
      maze: name of a maze or path of a maze file.
      reward: sparse pays 1 per goal region, dense 1 / (1 + distance) per control step (paper, D).
      num_decisions: time limit in our subgoals; none: the maze's own (paper, Table 3 over 25).
      goals: where they lie in training: own: where the maze has them; anywhere: in each episode in
        another cell that can be reached, as in the released training of HIRO, HRAC and HIGL.
        Evaluations are always of the maze's own.
      robot: which robot is controlled.
      engine: "mujoco" for the C engine on the processor, "mjx" for JAX on an accelerator.
      num_envs: environments that run at the same time, one robot in each.
      num_steps: control steps of all environments together, after which the run ends with the row
        of metrics that it is in.
      log_rounds: rounds of acting and learning per row of metrics.
      evaluate_every: rows of metrics between evaluations.
      checkpoint_every: rows of metrics between checkpoints.
      num_eval_episodes: episodes per evaluation, without exploration.
      num_devices: devices of each process that share environments, replay and batches; None: as
        many as can share them evenly, on CPU and for ppo and sac one.
      coordinator: host:port of process 0, for a run of several processes on one or more hosts;
        "auto": found in the environment of the cluster.
      num_processes: processes of the run.
      process_id: number of this process, from 0.
    """

    method: str = "droq"
    seed: limits.Seed = 0
    run: pathlib.Path = pathlib.Path("runs/baseline")
    resume: bool = False
    maze: str = "random"
    reward: base.Reward = "sparse"
    num_decisions: limits.Decisions | None = None
    goals: Goals = "own"
    robot: str = "ant"
    engine: base.EngineName = "mujoco"
    num_envs: Annotated[int, limits.Range(1, 2**16)] = 10
    num_steps: limits.Count = 1_000_000
    log_rounds: limits.UpToMillion = 10
    evaluate_every: limits.UpToMillion = 4
    checkpoint_every: limits.UpToMillion = 4
    num_eval_episodes: limits.UpToMillion = 50
    num_devices: Annotated[int, limits.Range(1, 1024)] | None = None
    coordinator: str | None = None
    num_processes: int | None = None
    process_id: int | None = None

    @property
    def shared(self) -> dict[str, int]:
        """What devices share evenly, by the name of its option."""
        levels = [field.name for field in dataclasses.fields(self) if field.name in LEVELS]
        sizes = {f"{name}.batch_size": getattr(self, name).batch_size for name in levels}
        return {"num_envs": self.num_envs} | sizes


@limits.dataclass
class FlatConfig(BaselineConfig):
    """Flat DroQ: one level, from where the robot and its goal are to its controls.

    Attributes:
      warmup_steps: first control steps of all environments, with uniform controls.
      iterations_per_round: control steps of each environment per round.
      updates_per_step: critic updates per control step.
      capacity: transitions that the replay holds, a multiple of `num_envs`.
      learner: hyper-parameters of DroQ.
    """

    checkpoint_every: limits.UpToMillion = 20  # Its replay is large, its rows are short.
    method: Annotated[str, limits.OneOf(("droq",))] = "droq"
    warmup_steps: limits.Count = 5_000  # DroQ's, as is all of the learner
    iterations_per_round: Annotated[int, limits.Range(1, 10_000)] = 10
    updates_per_step: Annotated[int, limits.Range(1, 1_000)] = 20  # DroQ's
    capacity: limits.Count = 1_000_000  # all of a run of the default length
    learner: low_config.Droq = dataclasses.field(default_factory=low_config.Droq)

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        # A step of all environments is written at once, and never around the replay's end.
        checks.divides("num_envs", self.num_envs, "capacity", self.capacity)

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round."""
        return self.num_envs * self.iterations_per_round
