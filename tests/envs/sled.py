"""A stand-in for physics, of which a test knows what it does."""

import dataclasses
import enum

import jax.numpy as jnp

from eihrl_jax import base, robots
from eihrl_jax.physics import scene

K = 5
"""Control steps per subgoal."""


class Sled:
    """Stands in for physics: the torso moves by a fifth of a cell times the first two controls."""

    def __init__(self):
        """Takes the ant's shape, with few control steps per subgoal."""
        self.robot = dataclasses.replace(robots.load("ant"), steps_per_subgoal=K)
        self.model = scene.build(self.robot)

    def step(self, state, ctrl, walls_xy, is_running):
        """Moves; the third control tips the robot over, the fourth breaks the simulation."""
        del walls_xy
        qpos = state.qpos.at[:2].add(base.CELL / K * ctrl[:2])
        turned = jnp.array([0.0, 1.0, 0.0, 0.0])
        qpos = qpos.at[3:7].set(jnp.where(ctrl[2] > 0.5, turned, qpos[3:7]))
        qpos = qpos.at[7].set(jnp.where(ctrl[3] > 0.5, jnp.nan, qpos[7]))
        return state.replace(qpos=jnp.where(is_running, qpos, state.qpos))


class Disc(Sled):
    """Stands in for a point, both controls of which move it; nothing else can happen to it."""

    def __init__(self):
        """Takes the point's shape, with few control steps per subgoal."""
        self.robot = dataclasses.replace(robots.load("point"), steps_per_subgoal=K)
        self.model = scene.build(self.robot)

    def step(self, state, ctrl, walls_xy, is_running):
        """Moves by a fifth of a cell times the controls."""
        del walls_xy
        qpos = state.qpos + base.CELL / K * ctrl
        return state.replace(qpos=jnp.where(is_running, qpos, state.qpos))


class Deed(enum.IntEnum):
    """What a `Puppet` does in every step."""

    MOVE = 0
    """As a disc."""
    REST = 1
    """Nothing."""
    JUMP = 2
    """Nearly a cell to the east, as far as a step may be that walls hold."""
    BREAK = 3
    """Its simulation breaks down."""


class Puppet(Disc):
    """Stands in for a point that does what `deed` says, which may be traced: one program for all.

    Attributes:
      deed: what it does in every step.
    """

    deed = Deed.MOVE

    def __init__(self):
        """Makes the point slim, and as far-reaching as what all walls around a cell stand for."""
        super().__init__()
        self.robot = dataclasses.replace(self.robot, reach=base.CELL / 2, body_radius=0.05)

    def step(self, state, ctrl, walls_xy, is_running):
        """Does its deed."""
        moved = super().step(state, ctrl, walls_xy, is_running).qpos
        jumped = state.qpos + jnp.where(is_running, jnp.array([0.95 * base.CELL, 0.0]), 0.0)
        broken = jnp.full_like(moved, jnp.nan)
        qpos = jnp.stack([moved, state.qpos, jumped, broken])[self.deed]
        return state.replace(qpos=qpos)
