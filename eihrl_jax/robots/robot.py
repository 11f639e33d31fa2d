"""What the rest of the package needs to know about a robot besides its MJCF."""

import pathlib
import re
from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import limits
from eihrl_jax.robots import symmetry as symmetry_lib

Root = Literal["free", "planar", "slide"]
"""How a robot's torso is joined to the world, see `Robot`."""


@limits.dataclass
class Robot:
    """A robot: where its model is, and the numbers by which the hierarchy drives it.

    Attributes:
      name: as it is called on the command line and in run folders.
      mjcf: path of the MJCF file; the file holds the robot alone, no floor and no walls.
      root: "free" for a body on a free joint (qpos: x y z, quaternion, joints), "planar" for one on
        two slides along x and y and a hinge about z (qpos: x y yaw, joints), "slide" for one on the
        two slides alone, whose first two controls push along x and y.
      physics_step: seconds per physics step.
      num_substeps: physics steps per control step.
      steps_per_subgoal: control steps per subgoal, k in the paper.
      reach: greatest distance in units of any part from the torso's xy; below 1.5 three wall boxes
        are enough, else eight.
      body_radius: radius in units with which oracle movement stops at walls.
      healthy_z: torso heights outside of which the robot counts as fallen, units; None: it can't.
      qpos_noise: half-width of the uniform noise on the joints at reset, radians.
      qvel_noise: standard deviation of the noise on velocities at reset, units or radians per
        second.
      symmetry: how the body maps to itself; None: not at all, or not of use.
    """

    name: str
    mjcf: pathlib.Path
    root: Root
    physics_step: Annotated[float, limits.Range(above=0.0, high=0.1)]
    num_substeps: Annotated[int, limits.Range(1, 1000)]
    steps_per_subgoal: Annotated[int, limits.Range(2, 10_000)]
    reach: Annotated[float, limits.Range(above=0.0, high=base.CELL)]
    body_radius: Annotated[float, limits.Range(above=0.0, high=base.CELL / 2)]
    healthy_z: tuple[float, float] | None = None
    qpos_noise: Annotated[float, limits.Range(0.0, 3.2)] = 0.1
    qvel_noise: Annotated[float, limits.Range(0.0, 10.0)] = 0.1
    symmetry: symmetry_lib.Symmetry | None = None

    def __post_init__(self) -> None:
        """Checks the name, and how the numbers fit together; descriptions may come from files."""
        # The name becomes part of paths.
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", self.name):
            raise base.UserError(f"name = {self.name!r} must be letters, digits, - and _")

        if self.healthy_z is not None and not self.healthy_z[0] < self.healthy_z[1]:
            raise base.UserError(f"healthy_z = {self.healthy_z} must be a height and a greater one")
        if self.healthy_z is not None and self.root != "free":
            raise base.UserError(f"healthy_z: a robot with root {self.root!r} can't fall")

        if self.symmetry is not None and self.symmetry.num_turns > 1 and self.root == "slide":
            raise base.UserError("symmetry: a robot with root 'slide' has no heading to turn")

    @property
    def control_step(self) -> float:
        """Seconds per control step."""
        return self.physics_step * self.num_substeps

    @property
    def num_walls(self) -> int:
        """Number of wall boxes that can touch the robot at once."""
        # Nearer than half a cell to its centre, a robot meets one cell on each axis and a corner.
        return 3 if self.reach < base.CELL / 2 else 8
