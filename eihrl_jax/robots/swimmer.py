"""The swimmer: three links in water, driven at the two joints between them."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="swimmer",
    mjcf=pathlib.Path(__file__).parent / "assets" / "swimmer.xml",
    root="planar",
    physics_step=0.01,
    num_substeps=20,
    steps_per_subgoal=100,
    reach=1.65,  # beyond half a cell, so that eight wall boxes are needed
    body_radius=0.5,
    symmetry=symmetry.Symmetry(
        num_turns=2,
        turn_joints=(2, 1),
        turn_controls=(2, 1),
        mirror_joints=(-1, -2),
        mirror_controls=(-1, -2),
    ),
)
"""0.2 s per control step, and 20 s per subgoal. Trained for subgoals of 10 s, it came 1.7 units
far; 20 s leave it time to turn as well.
`body_radius` is half the width of its undulation, not its length: it swims along corridors."""
