"""What the rest of the package needs to know about a robot besides its MJCF."""

import math
import pathlib
import re
from typing import Annotated, Literal

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.robots import symmetry as symmetry_lib

Root = Literal["free", "planar", "slide"]
"""How a robot's torso is joined to the world, see `Robot`."""

Sensors = Literal["all", "onboard"]
"""Sensors of a robot that its low level observes, see `Robot`."""


@limits.dataclass
class Robot:
    """A robot: where its model is, and the numbers by which the hierarchy drives it.

    Lengths are in the model's own metres; a cell, 3 units everywhere else, is `cell` metres wide.

    Attributes:
      name: as it is called on the command line and in run folders.
      mjcf: path of the MJCF file, whose own world is left out, see `physics.stock`.
      root: "free" for a body on a free joint (qpos: x y z, quaternion, joints), which replaces any
        other joints of its torso; "planar" for one on two slides along x and y and a hinge about z
        (qpos: x y yaw, joints); "slide" for one on the two slides alone, whose first two controls
        push along x and y.
      physics_step: seconds per physics step.
      num_substeps: physics steps per control step.
      steps_per_subgoal: control steps per subgoal, k in the paper.
      reach: greatest distance of any part from the torso's xy, metres; below half a cell three wall
        boxes are enough, else eight.
      body_radius: radius with which oracle movement stops at walls, metres.
      healthy_z: torso heights outside of which the robot has fallen, metres; None: it can't.
      cell: side of a cell, metres.
      max_speed: greatest speed of the torso along x and y that walls must hold, metres per second;
        None: what those boxes hold that its reach asks for.
      keyframe: name of the model's keyframe in which episodes start; None: its first one.
      start: all of qpos at the start of an episode, instead of a keyframe's.
      servo_range: how far from the start posture controls of 1 move a servo at most, radians or
        metres; None: to the end of its range.
      recovery_range: how far from it servos may move while the robot gets up after a fall, radians
        or metres; None: no farther than otherwise.
      qpos_noise: half-width of the uniform noise on the joints at reset, radians.
      qvel_noise: standard deviation of the noise on velocities at reset, units or radians per
        second.
      sensors: what its low level sees of its state: "all", or "onboard", what a real robot measures
        without outside help: no height and no velocity of the torso, see `envs.low_obs`.
      anchored: whether its low level follows subgoals that count from the middle of its cell; where
        not, they count from its torso unless asked otherwise, whatever the high level's training.
      symmetry: how the body maps to itself; None: not at all, or not of use.
    """

    name: str
    mjcf: pathlib.Path
    root: Root
    physics_step: Annotated[float, limits.Range(above=0.0, high=0.1)]
    num_substeps: Annotated[int, limits.Range(1, 1000)]
    steps_per_subgoal: Annotated[int, limits.Range(2, 10_000)]
    reach: limits.Positive
    body_radius: limits.Positive
    healthy_z: tuple[float, float] | None = None
    cell: Annotated[float, limits.Range(0.01, 1_000.0)] = base.CELL
    max_speed: limits.Positive | None = None
    keyframe: str | None = None
    start: tuple[float, ...] | None = None
    servo_range: limits.Positive | None = None
    recovery_range: limits.Positive | None = None
    qpos_noise: Annotated[float, limits.Range(0.0, 3.2)] = 0.1
    qvel_noise: Annotated[float, limits.Range(0.0, 10.0)] = 0.1
    sensors: Sensors = "all"
    anchored: bool = True
    symmetry: symmetry_lib.Symmetry | None = None

    def __post_init__(self) -> None:
        """Checks the name, and how the numbers fit together; descriptions may come from files."""
        # The name becomes part of paths.
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", self.name):
            raise base.UserError(f"name = {self.name!r} must be letters, digits, - and _")

        # Farther than in the cells around its own there are no walls for it.
        checks.in_range("reach", self.reach, above=0.0, high=self.cell)
        checks.in_range("body_radius", self.body_radius, above=0.0, high=self.cell / 2)
        if self._max_path >= self.cell - self.body_radius:
            raise base.UserError(
                f"max_speed = {self.max_speed} moves the torso {self._max_path:.2f} m in a control "
                f"step, must be less than {self.cell - self.body_radius:.2f}: reduce num_substeps"
            )
        if self.keyframe is not None and self.start is not None:
            raise base.UserError("keyframe and start exclude each other")
        if self.start is not None and not all(map(math.isfinite, self.start)):
            raise base.UserError(f"start = {self.start} must hold finite numbers")

        if self.recovery_range is not None and self.servo_range is None:
            raise base.UserError("recovery_range widens servo_range, which isn't given")
        if self.recovery_scale < 1.0:
            raise base.UserError(
                f"recovery_range = {self.recovery_range} must be at least "
                f"servo_range = {self.servo_range}"
            )

        if self.healthy_z is not None and not self.healthy_z[0] < self.healthy_z[1]:
            raise base.UserError(
                f"healthy_z = {self.healthy_z} must be a lower and an upper height"
            )
        if self.healthy_z is not None and self.root != "free":
            raise base.UserError(f"healthy_z: a robot with root {self.root!r} can't fall")

        if self.symmetry is not None and self.symmetry.num_turns > 1 and self.root == "slide":
            raise base.UserError("symmetry: a robot with root 'slide' has no heading to turn")

    @property
    def control_step(self) -> float:
        """Seconds per control step."""
        return self.physics_step * self.num_substeps

    @property
    def recovery_scale(self) -> float:
        """Controls that move servos `recovery_range` far, where 1 moves them `servo_range`."""
        if self.recovery_range is None or self.servo_range is None:
            return 1.0
        return self.recovery_range / self.servo_range

    @property
    def units_per_metre(self) -> float:
        """Units of mazes, of which a cell has 3, per metre of the robot's model."""
        return base.CELL / self.cell

    @property
    def num_walls(self) -> int:
        """Number of wall boxes that can touch the robot at once."""
        # Nearer than half a cell to its centre, a robot meets one cell on each axis and a corner.
        is_short = self.reach < self.cell / 2
        return 3 if is_short and self._max_path < self.cell / 2 - self.body_radius else 8

    @property
    def max_travel(self) -> float:
        """Units that the torso may move in a control step, for which its boxes stand still."""
        # What stands around the robot's own cell reaches a whole cell far to every side.
        room = self.cell / 2 if self.num_walls == 3 else self.cell
        return (room - self.body_radius) * self.units_per_metre

    @property
    def _max_path(self) -> float:
        """Metres of a control step at full speed."""
        return 0.0 if self.max_speed is None else self.max_speed * self.control_step
