import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes
from eihrl_jax.envs import oracle_maze, raster, task
from eihrl_jax.mazes import maze as maze_lib

EAST, WEST, NORTH, SOUTH = map(jnp.int32, range(4))
VIEW = raster.View()
SILHOUETTES = np.random.default_rng(0).random((8, 15, 15)) < 0.1
THREE = mazes.stack([mazes.load(name) for name in ("random", "g3", "spiral")])
WIDE = "\n".join(
    ["#" * 25]
    + ["#" + "." * 23 + "#"] * 11
    + ["#" + "." * 11 + "S" + "." * 11 + "1"]
    + ["#" + "." * 23 + "#"] * 11
    + ["#" * 25]
)


def make(maze, *, sigma=0.3, reward="sparse", **movement):
    return oracle_maze.OracleMaze(
        mazes.load(maze) if isinstance(maze, str) else maze,
        jnp.asarray(SILHOUETTES),
        view=VIEW,
        movement=oracle_maze.Movement(sigma=sigma, **movement),
        reward=reward,
    )


@functools.partial(jax.jit, static_argnums=0)
def rollout(env, maze, actions):
    """Steps one environment per row of `maze` [B] through actions [T, B]; states are [T, B]."""

    def step(state, action):
        following = jax.vmap(env.step)(state, action)
        return following, following

    first = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), len(maze)), maze)
    return first, jax.lax.scan(step, first, actions)[1]


def move_slowly(wall, xy, displacement, movement):
    """Moves the body as `OracleMaze.move` does, testing the whole square with NumPy's own loops."""

    def is_free(x, y):
        r = movement.body_radius
        columns = range(int(np.floor((x - r) / 3)), int(np.floor((x + r) / 3)) + 1)
        rows = range(int(np.floor((-y - r) / 3)), int(np.floor((-y + r) / 3)) + 1)
        is_inside = min(rows) >= 0 and min(columns) >= 0
        is_inside &= max(rows) < wall.shape[0] and max(columns) < wall.shape[1]
        return is_inside and not wall[np.ix_(rows, columns)].any()

    (x, y), path = xy.astype(np.float64), []
    dx, dy = displacement / movement.num_substeps
    for _ in range(movement.num_substeps):
        x += dx if is_free(x + dx, y) else 0.0
        y += dy if is_free(x, y + dy) else 0.0
        path.append((x, y))
    return np.array(path)


def test_movement_agrees_with_a_slow_one_that_tests_the_whole_body():
    env = make(THREE, body_radius=0.6)
    rng = np.random.default_rng(1)
    nav, xy = jax.jit(jax.vmap(functools.partial(task.start, env.table)))(
        jax.random.split(jax.random.key(0), 200)
    )
    displacement = rng.normal(0, 2.5, (200, 2)).astype(np.float32)
    paths = jax.jit(jax.vmap(env.move))(nav, xy, jnp.asarray(displacement))
    walls = np.asarray(jax.jit(jax.vmap(functools.partial(task.drawn_maze, env.table)))(nav).wall)
    for wall, start, move, path in zip(walls, np.asarray(xy), displacement, paths, strict=True):
        assert path == pytest.approx(move_slowly(wall, start, move, env.movement), abs=1e-4)


@pytest.mark.parametrize("anchored", [False, True])
def test_offsets_add_up_unless_subgoals_are_anchored(anchored):
    """To and fro on open floor, 100 times: 0.3 units each time, or 0.3 in all."""
    env = make(mazes.parse(WIDE), sigma=0.3, anchored=anchored)
    actions = jnp.tile(jnp.arange(2), 50)[:, None] * jnp.ones((1, 400), jnp.int32)
    _, states = rollout(env, jnp.zeros(400, jnp.int32), actions)
    offset = np.asarray(states.inner.xy[-1]) - np.asarray(maze_lib.cell_xy(jnp.array([12, 12])))
    expected = 0.3 if anchored else 3.0
    assert offset[:, 0].std() == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(
    ("offset", "expected"),
    [((0.0, 0.0), (0.0, 0.0)), ((0.6, -0.3), (0.0, 0.0)), ((1.2, 0.9), (0.4, 0.3))],
)
def test_an_anchor_is_the_middle_of_the_cell_but_no_more_than_a_unit_away(offset, expected):
    centre = maze_lib.cell_xy(jnp.array([2, 5]))
    anchor = task.anchor(centre + jnp.array(offset))
    np.testing.assert_allclose(anchor, centre + jnp.array(expected), atol=1e-5)


@pytest.fixture(scope="module")
def decided():
    """First states and states of 100 random decisions of 99 robots in three mazes."""
    env = make(THREE, sigma=0.6, body_radius=0.75)
    actions = np.random.default_rng(0).integers(4, size=(100, 99))
    return env, *rollout(env, jnp.arange(99) % 3, jnp.asarray(actions, jnp.int32))


def test_the_body_never_enters_a_wall_nor_leaves_the_grid(decided):
    env, _, states = decided
    corners = jnp.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    at = states.inner.xy[:, :, None] + (env.movement.body_radius - 1e-4) * corners[None, None]
    code_at = jax.vmap(jax.vmap(functools.partial(task.code_at, env.table)))
    assert (jax.jit(code_at)(states.inner.nav, at) < 128).all()


def test_a_batch_holds_different_mazes(decided):
    _, first, states = decided
    assert (first.inner.nav.maze == jnp.arange(99) % 3).all()
    assert (states.inner.nav.maze == first.inner.nav.maze[None]).all()


def test_postures_are_drawn_uniformly_for_every_decision_and_shown(decided):
    _, _, states = decided
    posture = np.asarray(states.inner.posture)
    counts = np.bincount(posture.ravel(), minlength=8)
    assert (
        (counts - 9900 / 8) ** 2 / (9900 / 8)
    ).sum() < 24.4  # chi-square of 7, once in a thousand
    assert (posture[1:] == posture[:-1]).mean() == pytest.approx(1 / 8, abs=0.02)
    assert (np.asarray(states.obs)[..., 2] == SILHOUETTES[posture]).all()


def test_observation_and_metrics_fit_the_state(decided):
    env, _, states = decided
    assert (states.obs == states.final_obs).all()
    assert (states.metrics["return"] == jnp.cumsum(states.reward, 0)).all()
    expected = jax.vmap(functools.partial(task.success, env.table))(
        jax.tree.map(lambda leaf: leaf[-1], states.inner.nav)
    )
    assert (states.metrics["success"][-1] == expected).all()


@pytest.fixture(scope="module")
def still():
    """States of six decisions without noise: four ways, a corridor, and against a wall."""
    corridor = mazes.parse("#######\n#S.1.2#\n#######", num_decisions=9)
    parts = [mazes.parse(WIDE), corridor, mazes.load("g1", num_decisions=3)]
    env = make(mazes.stack(parts), sigma=0.0)
    ways = [[d] * 6 for d in range(4)] + [[EAST, EAST, WEST, EAST, EAST, EAST], [SOUTH] * 6]
    return rollout(env, jnp.array([0, 0, 0, 0, 1, 2]), jnp.array(ways, jnp.int32).T)


def test_without_noise_a_decision_moves_one_cell(still):
    first, states = still
    xy = jnp.concatenate([first.inner.xy[None], states.inner.xy])[:, :4]
    expected = np.tile(3.0 * np.array(base.DIRECTIONS_XY), (6, 1, 1))
    assert jnp.diff(xy, axis=0) == pytest.approx(expected, abs=1e-4)


def test_an_episode_pays_each_goal_once_and_ends_with_the_last(still):
    states = jax.tree.map(lambda leaf: leaf[:, 4], still[1])
    assert states.reward.tolist() == [0, 1, 0, 0, 0, 1]
    assert states.terminated.tolist() == [False] * 5 + [True]
    assert not states.truncated.any()
    assert states.metrics["success"].tolist() == [0, 0.5, 0.5, 0.5, 0.5, 1]
    assert states.metrics["return"].tolist() == [0, 1, 1, 1, 1, 2]
    assert states.metrics["decisions"].tolist() == [1, 2, 3, 4, 5, 6]


def test_the_time_limit_truncates(still):
    states = jax.tree.map(lambda leaf: leaf[:3, 5], still[1])
    assert states.truncated.tolist() == [False, False, True]
    assert not states.terminated.any()
    assert (states.metrics["success"] == 0).all()


@pytest.fixture(scope="module")
def noisy():
    """First states and states of two decisions to the north of 1500 robots, dense reward."""
    env = make(mazes.parse(WIDE), sigma=0.3, reward="dense")
    return rollout(env, jnp.zeros(1500, jnp.int32), jnp.full((2, 1500), NORTH))


def test_noise_has_its_standard_deviation_on_both_axes_and_is_fresh(noisy):
    first, states = noisy
    xy = jnp.concatenate([first.inner.xy[None], states.inner.xy])
    noise = np.asarray(jnp.diff(xy, axis=0) - jnp.array([[[0.0, 3.0]]]))
    assert noise.mean((0, 1)) == pytest.approx(0.0, abs=0.02)
    assert noise.std((0, 1)) == pytest.approx(0.3, rel=0.05)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.05


def test_dense_reward(noisy):
    _, states = noisy
    offset = np.asarray(states.inner.xy) - [73.5, -37.5]
    expected = 1 / (1 + np.hypot(offset[..., 0], offset[..., 1]))
    assert states.reward == pytest.approx(expected, rel=1e-5)
    assert states.metrics["return"][-1] == pytest.approx(expected.sum(0), rel=1e-5)


def move(env, xy, displacement):
    """Moves in a maze without door candidates."""
    nav = task.Navigation(
        maze=jnp.int32(0),
        door_ij=jnp.array([task.NO_DOOR] * 2),
        visited=jnp.zeros(9, bool),
        decisions=jnp.int32(0),
        start_ij=jnp.zeros(2, jnp.int32),
    )
    return jax.jit(env.move)(nav, jnp.array(xy), jnp.array(displacement))


def test_a_wall_stops_one_axis_and_not_the_other():
    env = make(mazes.parse("######\n#S...#\n#....#\n#...1#\n######"), body_radius=0.7)
    path = move(env, [4.0, -4.0], [-3.0, -3.0])
    assert path[-1] == pytest.approx(np.array([4.0, -7.0]))
    assert path.shape == (6, 2)


def test_a_body_fits_through_a_door_and_stops_behind_it():
    path = move(make("g1"), [16.5, -4.5], [0.0, 9.0])
    assert path[-1, 1] == pytest.approx(-1.5, abs=0.01)


def test_a_step_alone_is_a_step_in_a_batch(decided):
    env, _, states = decided
    before, after = (jax.tree.map(lambda leaf, t=t: leaf[t, 5], states) for t in (3, 4))
    action = np.random.default_rng(0).integers(4, size=(100, 99))[4, 5]
    alone = jax.jit(env.step)(before, jnp.int32(action))
    assert alone.inner.xy == pytest.approx(np.asarray(after.inner.xy), abs=1e-5)
    assert (alone.obs == after.obs).all()
    assert (jax.random.key_data(alone.key) == jax.random.key_data(after.key)).all()


@pytest.mark.parametrize(
    ("option", "value"),
    [("step", -1.0), ("sigma", 3.1), ("num_substeps", 0), ("body_radius", 1.6), ("sigma", np.nan)],
)
def test_movement_out_of_range(option, value):
    with pytest.raises(base.UserError, match=f"movement {option} = {value}"):
        oracle_maze.Movement(**{option: value})


def test_parts_of_a_move_must_not_jump_over_a_wall():
    with pytest.raises(base.UserError, match="num_substeps 1 is too small"):
        oracle_maze.Movement(num_substeps=1)


def test_what_does_not_fit_together():
    with pytest.raises(base.UserError, match=r"reward = 'fat' must be one of sparse, dense"):
        make("u", reward="fat")
    with pytest.raises(base.UserError, match=r"body_radius 1\.1 is above 1"):
        make("u", body_radius=1.1)
    with pytest.raises(base.UserError, match=r"shape \(2, 9, 9\) do not fit .* 15 x 15"):
        oracle_maze.OracleMaze(
            mazes.load("u"),
            jnp.zeros((2, 9, 9), bool),
            view=VIEW,
            movement=oracle_maze.Movement(),
        )
