"""What the rest of the package needs to know about a robot besides its MJCF."""

import dataclasses
import pathlib

from eihrl_jax.robots import symmetry as symmetry_lib


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
      qvel_noise: standard deviation of the noise on velocities at reset.
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
    healthy_z: tuple[float, float] | None
    qpos_noise: float = 0.1
    qvel_noise: float = 0.1
    symmetry: symmetry_lib.Symmetry | None = None

    @property
    def control_step(self) -> float:
        """Seconds per control step."""
        return self.physics_step * self.num_substeps

    @property
    def num_walls(self) -> int:
        """Number of wall boxes that can touch the robot at once."""
        return 3 if self.reach < 1.5 else 8
