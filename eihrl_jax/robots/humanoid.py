"""The humanoid: seventeen torque-driven joints, two legs, falls without control."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="humanoid",
    mjcf=pathlib.Path(__file__).parent / "assets" / "humanoid.xml",
    root="free",
    physics_step=0.005,
    num_substeps=5,
    steps_per_subgoal=200,
    reach=1.35,
    body_radius=0.4,
    healthy_z=(1.0, 2.0),  # as Gym's humanoid, and its noise: more would topple it
    qpos_noise=0.01,
    qvel_noise=0.01,
    # The abdomen stays; legs (4 to 11) and arms (12 to 17) change sides. Joints and controls
    # differ in the order of the abdomen's first two.
    symmetry=symmetry.Symmetry(
        mirror_joints=(-1, 2, -3, 8, 9, 10, 11, 4, 5, 6, 7, -15, -16, 17, -12, -13, 14),
        mirror_controls=(1, -2, -3, 8, 9, 10, 11, 4, 5, 6, 7, -15, -16, 17, -12, -13, 14),
    ),
)
"""0.025 s per control step, and 5 s per subgoal: to turn and to walk 3 units at a stroll."""
