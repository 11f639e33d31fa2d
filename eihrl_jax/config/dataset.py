"""Options of a dataset: whose episodes, in which maze, how many."""

import pathlib
from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import limits

Form = Literal["flat", "goal"]
"""What an observation of a control step is: one vector, or a dict with the goal apart."""


@limits.dataclass
class DatasetConfig:
    """Writes episodes of a hierarchy as a dataset that `minari.load_dataset` reads.

    Walking is told control step by control step, as the Gymnasium environment eihrl_jax/Maze-v0
    shows it; oracle movement decision by decision, as eihrl_jax/HighLevel-v0 does. Episode i is the
    one that begins there with `reset(seed=seed + i)`. Episodes are on disk in parts while it runs.

    Attributes:
      maze: name of a maze or path of a maze file.
      robot: point, ant, swimmer, humanoid, go1 or a description file.
      movement: full: the robot walks, with its low level; oracle: the simulator moves the torso.
      high: run folder, policy folder or shipped name; uniform, frontier or shortest.
      low: the same of the low level that walks; none: the robot's shipped one.
      reward: sparse pays 1 per goal region, dense 1 / (1 + distance) per step (paper, D).
      observation: of walking: flat, or goal for a dict of observation, achieved and desired goal.
      num_decisions: time limit in subgoals; none: the maze's own.
      episodes: how many; more may be asked for when a dataset that was begun goes on.
      seed: of the first episode.
      batch: episodes that run at the same time, and are then written.
      engine: physics engine of walking.
      name: the dataset's id; none: eihrl_jax/<robot>-<maze>/<movement>-v0.
      out: folder of datasets; none: Minari's own, MINARI_DATASETS_PATH or ~/.minari/datasets.
      resume: continue a dataset that was begun with the same options.
    """

    maze: str = "u"
    robot: str = "ant"
    movement: base.MovementName = "full"
    high: str = "best-random-0"
    low: str | None = None
    reward: base.Reward = "sparse"
    observation: Form = "flat"
    num_decisions: limits.Decisions | None = None
    episodes: limits.UpToMillion = 100
    seed: limits.Seed = 0
    batch: Annotated[int, limits.Range(1, 1024)] = 64
    engine: base.EngineName = "mujoco"
    name: str | None = None
    out: pathlib.Path | None = None
    resume: bool = False

    def __post_init__(self) -> None:
        """Checks how the options fit together."""
        if self.movement == "oracle" and self.low is not None:
            raise base.UserError(f"low = {self.low} needs movement full, not oracle")
        if self.movement == "oracle" and self.observation != "flat":
            raise base.UserError(
                f"observation = {self.observation!r} needs movement full, not oracle"
            )
