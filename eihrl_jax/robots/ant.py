"""The ant: eight torque-driven joints, the robot of the paper's main experiments."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="ant",
    mjcf=pathlib.Path(__file__).parent / "assets" / "ant.xml",
    root="free",
    physics_step=0.02,
    num_substeps=5,
    steps_per_subgoal=25,  # Paper: Table 4.
    reach=1.25,
    body_radius=0.7,
    healthy_z=(0.2, 1.0),  # as Gym's ant
    # Hip and ankle of four legs: a quarter turn puts each leg in the place of the next.
    symmetry=symmetry.Symmetry(
        num_turns=4,
        turn_joints=(3, -4, 5, 6, 7, -8, 1, 2),
        turn_controls=(3, -4, 5, 6, 7, -8, 1, 2),
        mirror_joints=(-7, 8, -5, 6, -3, 4, -1, 2),
        mirror_controls=(-7, 8, -5, 6, -3, 4, -1, 2),
    ),
)
"""0.1 s per control step as in the HIRO line of ant mazes; 25 per subgoal (paper, Table 4)."""
