"""The point: a disc pushed along x and y, the quickest robot to learn."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="point",
    mjcf=pathlib.Path(__file__).parent / "assets" / "point.xml",
    root="slide",
    physics_step=0.02,
    num_substeps=5,
    steps_per_subgoal=25,
    reach=0.5,
    body_radius=0.5,
    # No joints to rename; of its two pushes that along y turns round.
    symmetry=symmetry.Symmetry(mirror_joints=(), mirror_controls=(1, -2)),
)
"""Terminal speed is 2 units per second, so one cell takes at least 1.5 s of a subgoal's 2.5 s."""
