"""The Go1 of Unitree: a real quadruped of 12 kg whose twelve joints are driven by servos."""

import pathlib

from eihrl_jax.robots import robot, symmetry

# Hip, thigh and calf of the legs front right, front left, rear right and rear left.
_MIRROR = (-4, 5, 6, -1, 2, 3, -10, 11, 12, -7, 8, 9)

ROBOT = robot.Robot(
    name="go1",
    mjcf=pathlib.Path(__file__).parent / "assets" / "go1.xml",
    root="free",
    physics_step=0.005,
    num_substeps=4,
    steps_per_subgoal=200,
    reach=0.61,
    body_radius=0.35,
    healthy_z=(0.15, 0.6),
    servo_range=0.25,
    recovery_range=2.0,  # within the quarter of a radian it doesn't come off its back
    sensors="onboard",
    symmetry=symmetry.Symmetry(mirror_joints=_MIRROR, mirror_controls=_MIRROR),
)
"""0.02 s per control step, as the robot is driven in Smith et al. 2022, and 4 s per subgoal."""
