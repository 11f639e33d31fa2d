"""The swimmer: three links in water, driven at the two joints between them."""

import pathlib

from eihrl_jax.robots import robot, symmetry

ROBOT = robot.Robot(
    name="swimmer",
    mjcf=pathlib.Path(__file__).parent / "assets" / "swimmer.xml",
    root="planar",
    physics_step=0.01,
    num_substeps=10,
    steps_per_subgoal=100,
    reach=1.65,
    body_radius=0.5,
    symmetry=symmetry.Symmetry(
        num_turns=2,
        turn_joints=(2, 1),
        turn_controls=(2, 1),
        mirror_joints=(-1, -2),
        mirror_controls=(-1, -2),
    ),
)
"""Good swimmers of Gymnasium's leader boards return about 360 for 40 s, which is 0.36 units/s, so
one cell takes some 8 s; a subgoal of 10 s leaves time to turn. A guess until one is trained.
`body_radius` is half the width of its undulation, not its length: it swims along corridors."""
