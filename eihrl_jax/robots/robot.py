"""What the rest of the package needs to know about a robot besides its MJCF."""

import dataclasses
import pathlib
import re

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.robots import symmetry as symmetry_lib

ROOTS = ("free", "planar", "slide")
"""Ways in which a robot's torso is joined to the world."""


@dataclasses.dataclass(frozen=True, kw_only=True)
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
    root: str
    physics_step: float
    num_substeps: int
    steps_per_subgoal: int
    reach: float
    body_radius: float
    healthy_z: tuple[float, float] | None = None
    qpos_noise: float = 0.1
    qvel_noise: float = 0.1
    symmetry: symmetry_lib.Symmetry | None = None

    def __post_init__(self) -> None:
        """Checks ranges, since descriptions may come from files."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", self.name):
            raise base.UserError(f"name = {self.name!r} must be letters, digits, - and _")
        checks.one_of("root", self.root, ROOTS)
        checks.in_range("physics_step", self.physics_step, above=0.0, high=0.1)
        checks.in_range("num_substeps", self.num_substeps, 1, 1000)
        checks.in_range("steps_per_subgoal", self.steps_per_subgoal, 2, 10_000)
        checks.in_range("reach", self.reach, above=0.0, high=base.CELL)
        checks.in_range("body_radius", self.body_radius, above=0.0, high=base.CELL / 2)
        checks.in_range("qpos_noise", self.qpos_noise, 0.0, 3.2)
        checks.in_range("qvel_noise", self.qvel_noise, 0.0, 10.0)
        if self.healthy_z is not None and not self.healthy_z[0] < self.healthy_z[1]:
            raise base.UserError(f"healthy_z = {self.healthy_z} must be a height and a greater one")
        if self.symmetry is not None and self.symmetry.num_turns > 1 and self.root == "slide":
            raise base.UserError("symmetry: a robot with root 'slide' has no heading to turn")
        if self.healthy_z is not None and self.root != "free":
            raise base.UserError(f"healthy_z: a robot with root {self.root!r} can't fall")

    @property
    def control_step(self) -> float:
        """Seconds per control step."""
        return self.physics_step * self.num_substeps

    @property
    def num_walls(self) -> int:
        """Number of wall boxes that can touch the robot at once."""
        return 3 if self.reach < 1.5 else 8
