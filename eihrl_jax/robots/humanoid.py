"""The humanoid: seventeen torque-driven joints, two legs, falls without control."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="humanoid",
    mjcf=pathlib.Path(__file__).parent / "assets" / "humanoid.xml",
    root="free",
    physics_step=0.005,
    num_substeps=5,
    steps_per_subgoal=100,
    reach=1.35,
    body_radius=0.4,
    healthy_z=(1.0, 2.0),
    qpos_noise=0.01,
    qvel_noise=0.01,
    symmetry=symmetry.Symmetry(
        mirror_joints=(-1, 2, -3, 8, 9, 10, 11, 4, 5, 6, 7, -15, -16, 17, -12, -13, 14),
        mirror_controls=(1, -2, -3, 8, 9, 10, 11, 4, 5, 6, 7, -15, -16, 17, -12, -13, 14),
    ),
)
"""0.025 s per control step. A trained runner's 1.2 units/s covers one cell in the 2.5 s of a
subgoal, the same time as the ant's. A guess until one is trained."""
