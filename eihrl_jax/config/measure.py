"""Options of measuring a low level: how evenly it carries out its subgoals."""

import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import checks, limits


@limits.dataclass
class MeasureConfig:
    """Measures a low level on random subgoals, on open floor, in random rooms and in corridors.

    Prints and writes, per surrounding: displacement along the subgoal and sideways, the epsilon of
    the paper's Definition 3.1 as it really is, and how far its law is from the normal one that the
    high level trains with; falls and recoveries. In corridors of one cell's width subgoals are
    anchored and directions free, as in a maze. Also: how far from cells' centres robots are after
    1, 10 and 100 subgoals on open floor, without and with anchors. Draws where the subgoals ended,
    and records a posture bank. `train_high --task.measured` takes the folder.

    Attributes:
      robot: which robot.
      low: its low level: run folder, policy folder or shipped name; none: the shipped one.
      stand: the one that takes over while the robot is down, like `low`, or "none"; by default the
        one beside its low level, if there is one.
      num_subgoals: about this many per surrounding; those begun lying down don't count.
      num_envs: environments that run at the same time, one robot in each.
      engine: physics engine.
      sigma: standard deviation in units of the normal law to compare with.
      num_postures: postures recorded for the high level's pictures.
      seed: of rooms, starts and subgoals.
      out: folder of the results; must be new or empty.
    """

    robot: str = "ant"
    low: str | None = None
    stand: str | None = None
    num_subgoals: Annotated[int, limits.Range(100, 200_000)] = 5_000
    num_envs: Annotated[int, limits.Range(1, 2**16)] = 128
    engine: base.EngineName = "mujoco"
    sigma: Annotated[float, limits.Range(above=0.0, high=base.CELL)] = base.SIGMA
    num_postures: limits.UpToMillion = 2048
    seed: limits.Seed = 0
    out: pathlib.Path = pathlib.Path("runs/subgoals")

    def __post_init__(self) -> None:
        """Checks that every robot is given a second subgoal."""
        # The first subgoal of a robot, which stood still before, gives no postures.
        checks.in_range("num_subgoals", self.num_subgoals, 2 * self.num_envs)
