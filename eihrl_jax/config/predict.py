"""Options of predicting success from a robot's law of end points."""

import pathlib
from typing import Annotated

from eihrl_jax import base
from eihrl_jax.config import limits


@limits.dataclass
class PredictConfig:
    """Predicts what robots do in mazes from where their subgoals ended, without physics.

    Every robot x high level in every maze: expected success and decisions, exact for the measured
    law as long as all states fit into memory. Writes prediction.json and prediction.md, and beside
    evaluations with physics prediction.png.

    Attributes:
      mazes: names, suites or text files, as of `evaluate`.
      robot: names or description files.
      high: run folders, policy folders or shipped names, as of `evaluate`.
      ends: folder of `measure_low` for each robot; none: what is shipped of the robots.
      walked: folders of `evaluate`; what walks there is predicted in the mazes of that evaluation,
        and set beside what it did, and `mazes`, `robot` and `high` aren't looked at.
      num_decisions: time limit in subgoals; none: each maze's own, or that of `walked`.
      anchored: subgoals count from the middle of the robot's cell; none: as in the high level's own
        training, where the robot's low level knows them.
      num_states: most states that are followed at once; where there are more, the faint ones are
        thinned at random, and the result is an estimate.
      seed: of what is thinned.
      out: folder of the results; must be new or empty.
    """

    mazes: limits.Several[str] = ("random", "g1", "g2", "g3")
    robot: limits.Several[str] = ("ant",)
    high: limits.Several[str] = ("best-random-0",)
    ends: tuple[pathlib.Path, ...] = ()
    walked: tuple[pathlib.Path, ...] = ()
    num_decisions: Annotated[int, limits.Range(1, 10_000_000)] | None = None
    anchored: bool | None = None
    num_states: Annotated[int, limits.Range(16, 2**20)] = 4096
    seed: limits.Seed = 0
    out: pathlib.Path = pathlib.Path("runs/prediction")

    def __post_init__(self) -> None:
        """Checks that every robot has a measurement, or none."""
        if self.ends and len(self.ends) != len(self.robot):
            raise base.UserError(
                f"ends names {len(self.ends)} measurements for {len(self.robot)} robots"
            )
