"""Options of an animation of several mazes."""

import pathlib
from typing import Annotated

from eihrl_jax.config import limits


@limits.dataclass
class GalleryConfig:
    """Animates one robot in several mazes side by side, an episode in each.

    Long episodes are shown faster than short ones, so that all end at about the same time; a robot
    that has arrived waits for the others.

    Attributes:
      mazes: names or text files, as in `evaluate`, but no suites.
      robot: a shipped robot's name, or a description file.
      high: high level, as in `evaluate`; best: the shipped one that `evaluate` takes.
      seed: of the episodes.
      width: of one maze, pixels.
      num_frames: at most, 20 of them per second.
      out: new GIF or MP4.
    """

    mazes: limits.Several[str] = (
        "g2",
        "jaxued-labyrinth",
        "gymnasium-robotics-medium",
        "ogbench-medium-1",
    )
    robot: str = "ant"
    high: str = "best"
    seed: limits.Seed = 0
    width: Annotated[int, limits.Range(64, 1024)] = 280
    num_frames: Annotated[int, limits.Range(2, 1000)] = 100
    out: pathlib.Path = pathlib.Path("runs/gallery.gif")
