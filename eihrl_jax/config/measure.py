"""Options of measuring a low level: how evenly it carries out its subgoals."""

import dataclasses
import pathlib

from eihrl_jax import base
from eihrl_jax.config import checks


@dataclasses.dataclass(frozen=True, kw_only=True)
class MeasureConfig:
    """Measures a low level on random subgoals, on open floor and in random rooms.

    Prints and writes, per surrounding: displacement along the subgoal and sideways, the epsilon of
    the paper's Definition 3.1 as it really is, and how far its law is from the normal one that the
    high level trains with; falls and recoveries. Draws where the subgoals ended, and records a
    posture bank. `train_high --task.measured` takes the folder.

    Attributes:
      robot: which robot.
      low: its low level: run folder, policy folder or shipped name; none: the shipped one.
      num_subgoals: about this many per surrounding; those begun lying down don't count.
      num_envs: robots that walk at the same time.
      engine: physics engine.
      sigma: standard deviation in units of the normal law to compare with.
      num_postures: postures recorded for the high level's pictures.
      seed: of rooms, starts and subgoals.
      out: folder of the results; must be new or empty.
    """

    robot: str = "ant"
    low: str | None = None
    num_subgoals: int = 5_000
    num_envs: int = 128
    engine: base.EngineName = "mujoco"
    sigma: float = base.SIGMA
    num_postures: int = 2048
    seed: int = 0
    out: pathlib.Path = pathlib.Path("runs/subgoals")

    def __post_init__(self) -> None:
        """Checks ranges."""
        checks.in_range("num_envs", self.num_envs, 1, 2**16)
        # The first subgoal of a robot, which stood still before, gives no postures.
        checks.in_range("num_subgoals", self.num_subgoals, max(100, 2 * self.num_envs), 200_000)
        checks.one_of("engine", self.engine, base.ENGINES)
        checks.in_range("sigma", self.sigma, above=0.0, high=base.CELL)
        checks.in_range("num_postures", self.num_postures, 1, 1_000_000)
        checks.in_range("seed", self.seed, 0, 2**32 - 1)
