"""Options of trying out a user's robot."""

import pathlib

from eihrl_jax.config import limits


@limits.dataclass
class RobotConfig:
    """Proposes a description for any MJCF, tries it out, and draws the robot in its cell.

    Prints the description and what a simulation says about it, all at once: parts farther away than
    its reach, speeds that walls don't hold, a start posture outside of its joints' ranges or its
    healthy heights, a symmetry that isn't one of the physics, steps that break down. Sizes and
    speeds are measured; times are a guess to begin with.

    Attributes:
      file: an MJCF file, or a description (.toml), which is then tried out as it is.
      out: folder of robot.toml and robot.png; must be new or empty.
    """

    file: pathlib.Path
    out: pathlib.Path = pathlib.Path("runs/robot")
