"""Walls near the robot: the right boxes are chosen, and they stop an ant whatever it does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import kinematics, scene, walls

ROOMS = {
    "corners": "####\n#S.#\n#.1#\n####",
    "door": "#####\n#S..#\n##.##\n#..1#\n#####",
    "post": "#####\n#S..#\n#.#.#\n#..1#\n#####",
}

jit_nearby = jax.jit(walls.nearby, static_argnums=2)


def near(maze, xy, num_walls=3):
    """Set of the centres of the walls near a position."""
    found = np.asarray(jit_nearby(maze, jnp.array(xy), num_walls))
    assert found.shape == (num_walls, 2)
    return {tuple(row) for row in found.tolist() if tuple(row) != scene.PARKED_XY}


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ((0.4, 0.4), {(7.5, -1.5), (4.5, 1.5), (7.5, 1.5)}),
        ((-0.4, 0.4), {(1.5, -1.5), (4.5, 1.5), (1.5, 1.5)}),
        ((0.4, -0.4), {(7.5, -1.5), (4.5, -4.5), (7.5, -4.5)}),
        ((-0.4, -0.4), {(1.5, -1.5), (4.5, -4.5), (1.5, -4.5)}),
    ],
)
def test_three_walls_are_those_of_the_nearest_corner(offset, expected):
    maze = mazes.parse("###\n#S#\n#1#\n###")
    solid = maze.replace(wall=jnp.ones_like(maze.wall))
    xy = (4.5 + offset[0], -1.5 + offset[1])
    assert near(solid, xy) == expected


def test_free_cells_are_parked():
    maze = mazes.parse(ROOMS["corners"])
    assert near(maze, (4.5, -4.5), 8) == {(1.5, -1.5), (4.5, -1.5), (7.5, -1.5), (1.5, -4.5)} | {
        (1.5, -7.5)
    }
    assert near(maze, (5.5, -5.5)) == set()


def test_outside_the_grid_everything_is_wall():
    maze = mazes.parse(ROOMS["corners"])
    for xy in ((-20.0, 30.0), (1e4, -1e4)):
        assert len(near(maze, xy)) == 3 and len(near(maze, xy, 8)) == 8


def test_three_walls_are_all_that_a_short_robot_can_touch():
    """Every wall cell within reach of a robot is among its boxes, its own cell left out."""
    maze = mazes.load("g3")
    reach = 1.5
    rng = np.random.default_rng(0)
    wall_ij = np.argwhere(np.asarray(maze.wall))
    centres = np.stack([wall_ij[:, 1] + 0.5, -(wall_ij[:, 0] + 0.5)], 1) * base.CELL
    positions = rng.uniform((3.0, -24.0), (24.0, -3.0), (300, 2)).astype(np.float32)
    listed = jax.vmap(walls.nearby, in_axes=(None, 0, None))(maze, jnp.asarray(positions), 3)
    for xy, near_xy in zip(positions, np.asarray(listed).tolist(), strict=True):
        beyond = np.maximum(np.abs(centres - xy) - base.CELL / 2, 0.0)
        distance = np.linalg.norm(beyond, axis=1)
        touchable = {tuple(c) for c in centres[(distance > 0) & (distance < reach)].tolist()}
        assert touchable <= {tuple(c) for c in near_xy}, xy


def launch(ant, maze, ctrls, seed):
    """Throws ants [N] from anywhere free in any direction; returns qpos [T, N, nq]."""
    num = ctrls.shape[1]
    rng = np.random.default_rng(seed)
    free = np.argwhere(~np.asarray(maze.wall))
    cells = free[rng.integers(len(free), size=num)]
    centre = np.stack([cells[:, 1] + 0.5, -(cells[:, 0] + 0.5)], 1) * base.CELL
    qpos = np.repeat(ant.model.key_qpos[0][None], num, 0)
    qpos[:, :2] = centre + rng.uniform(-0.8, 0.8, (num, 2))
    qpos[:, 2] = 0.6
    yaw, heading = rng.uniform(-np.pi, np.pi, (2, num))
    speed = rng.uniform(3.0, 5.0, num)
    qpos[:, 3], qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    qvel = np.zeros((num, ant.model.nv))
    qvel[:, 0], qvel[:, 1] = speed * np.cos(heading), speed * np.sin(heading)
    start = jax.vmap(engine_lib.reset)(jnp.asarray(qpos), jnp.asarray(qvel))
    near_all = jax.vmap(walls.nearby, in_axes=(None, 0, None))

    def step(state, ctrl):
        state = jax.vmap(ant.step)(state, ctrl, near_all(maze, state.qpos[:, :2], 3))
        return state, state.qpos

    return jax.jit(lambda start, ctrls: jax.lax.scan(step, start, ctrls)[1])(start, ctrls)


@pytest.mark.parametrize("room", ROOMS)
def test_an_ant_neither_passes_nor_climbs_a_wall(ant, room):
    """64 ants, 200 control steps: 32 push with full random torques, 32 hold each for a second.

    They are thrown at 3 to 5 units/s; a trained ant walks at about 1.5 units/s. Torsos were seen up
    to 1.5 units high, which a jump on open floor reaches too; walls are 3 high. No part is deeper
    in a wall than a leg is thick, once the first contact is over (measured: 0.02 in 99 % of steps).
    """
    maze = mazes.parse(ROOMS[room])
    rng = np.random.default_rng(7)
    fast = rng.choice([-1.0, 1.0], (200, 32, ant.model.nu))
    held = np.repeat(rng.choice([-1.0, 1.0], (20, 32, ant.model.nu)), 10, 0)
    ctrls = jnp.asarray(np.concatenate([fast, held], 1), jnp.float32)
    qpos = launch(ant, maze, ctrls, seed=3)
    assert jnp.isfinite(qpos).all()
    is_inside = jax.vmap(mazes.maze.is_wall, in_axes=(None, 0))(maze, qpos[..., :2].reshape(-1, 2))
    assert not is_inside.any()
    assert qpos[..., 2].max() < 2.0
    moved = jnp.abs(qpos[-1, :, :2] - qpos[0, :, :2]).max(1)
    assert jnp.median(moved) > 0.5
    some = qpos[10::5].reshape(-1, qpos.shape[-1])
    depth = np.asarray(jax.jit(jax.vmap(lambda qpos: deepest(ant, maze, qpos)))(some))
    assert np.quantile(depth, 0.99) < 0.08


def deepest(ant, maze, qpos):
    """How deep the deepest end of a capsule is in a wall, negative while all are outside."""
    start, end, radius = kinematics.capsules(ant.model)(qpos)
    points = jnp.concatenate([start[:, :2], end[:, :2]])
    rows, columns = maze.wall.shape
    i, j = jnp.mgrid[:rows, :columns].astype(jnp.float32)
    beyond = jnp.maximum(
        jnp.abs(points[:, 0, None, None] - base.CELL * (j + 0.5)[None]),
        jnp.abs(points[:, 1, None, None] + base.CELL * (i + 0.5)[None]),
    )
    outside = jnp.where(maze.wall[None], beyond - base.CELL / 2, jnp.inf).min((1, 2))
    return (jnp.concatenate([radius, radius]) - outside).max()
