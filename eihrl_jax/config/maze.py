"""Options of showing a maze."""

import pathlib

from eihrl_jax.config import limits, reading


@limits.dataclass
class MazeConfig(reading.ReadingConfig):
    """Shows a maze as text and as a picture, with all that an evaluation would go by.

    Attributes:
      file: a maze file of any known kind (docs/mazes.md), the name of a maze, or of a suite, whose
        mazes are listed.
      num_decisions: time limit in subgoals; none: the maze's own.
      picture: new PNG file for the maze's plan.
      save: new file for the maze in our text.
    """

    file: str
    num_decisions: limits.Decisions | None = None
    picture: pathlib.Path | None = None
    save: pathlib.Path | None = None
