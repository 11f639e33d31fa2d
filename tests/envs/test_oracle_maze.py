import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eihrl_jax import base, mazes, raster
from eihrl_jax.envs import oracle_maze, task

EAST, WEST, NORTH, SOUTH = map(jnp.int32, range(4))
VIEW = raster.View()
SILHOUETTES = np.random.default_rng(0).random((8, 15, 15)) < 0.1
THREE = mazes.stack([mazes.load(name) for name in ("random", "g3", "spiral")])
ROOM = "\n".join(["#" * 13, "#" + "S" * 11 + "#"] + ["#" + "S" * 11 + "#"] * 10 + ["#####1#######"])


def make(maze, *, sigma=0.3, reward="sparse", **movement):
    return oracle_maze.OracleMaze(
        mazes.load(maze) if isinstance(maze, str) else maze,
        jnp.asarray(SILHOUETTES),
        view=VIEW,
        movement=oracle_maze.Movement(sigma=sigma, **movement),
        reward=reward,
    )


@functools.partial(jax.jit, static_argnums=0)
def rollout(env, keys, actions):
    """Steps one environment per key through actions [T, B]; returns states with axes [T, B]."""

    def step(state, action):
        following = jax.vmap(env.step)(state, action)
        return following, following

    first = jax.vmap(env.reset)(keys)
    return first, jax.lax.scan(step, first, actions)[1]


def random_actions(num_steps, num_envs, seed=0):
    return jnp.asarray(
        np.random.default_rng(seed).integers(4, size=(num_steps, num_envs)), jnp.int32
    )


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
    nav, xy = jax.jit(jax.vmap(functools.partial(task.start, env.course)))(
        jax.random.split(jax.random.key(0), 200)
    )
    displacement = rng.normal(0, 2.5, (200, 2)).astype(np.float32)
    paths = jax.jit(jax.vmap(env.move))(nav, xy, jnp.asarray(displacement))
    walls = np.asarray(jax.jit(jax.vmap(functools.partial(task.drawn_maze, env.course)))(nav).wall)
    for wall, start, move, path in zip(walls, np.asarray(xy), displacement, paths, strict=True):
        assert path == pytest.approx(move_slowly(wall, start, move, env.movement), abs=1e-4)


@pytest.fixture(scope="module")
def walks():
    """First states and states of 100 random decisions of 100 robots in three mazes."""
    env = make(THREE, sigma=0.6, body_radius=0.75)
    keys = jax.random.split(jax.random.key(1), 100)
    return env, *rollout(env, keys, random_actions(100, 100))


def test_the_body_never_enters_a_wall_nor_leaves_the_grid(walks):
    env, _, states = walks
    corners = jnp.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    at = states.inner.xy[:, :, None] + (env.movement.body_radius - 1e-4) * corners[None, None]
    code_at = jax.vmap(jax.vmap(functools.partial(task.code_at, env.course)))
    assert (jax.jit(code_at)(states.inner.nav, at) < 128).all()


def test_a_batch_holds_different_mazes(walks):
    _, first, states = walks
    assert len(np.unique(first.inner.nav.maze)) == 3
    assert (states.inner.nav.maze == first.inner.nav.maze[None]).all()


def test_postures_are_drawn_uniformly_for_every_decision_and_shown(walks):
    _, _, states = walks
    posture = np.asarray(states.inner.posture)
    counts = np.bincount(posture.ravel(), minlength=8)
    assert ((counts - 1250) ** 2 / 1250).sum() < 24.4  # chi-square of 7, once in a thousand
    assert (posture[1:] == posture[:-1]).mean() == pytest.approx(1 / 8, abs=0.02)
    assert (np.asarray(states.obs)[..., 2] == SILHOUETTES[posture]).all()


def test_observation_and_metrics_fit_the_state(walks):
    env, _, states = walks
    assert (states.obs == states.final_obs).all()
    assert (states.metrics["return"] == jnp.cumsum(states.reward, 0)).all()
    expected = jax.vmap(functools.partial(task.success, env.course))(
        jax.tree.map(lambda leaf: leaf[-1], states.inner.nav)
    )
    assert (states.metrics["success"][-1] == expected).all()


def test_without_noise_a_decision_moves_one_cell():
    env = make(mazes.parse(ROOM, start_jitter=0.0), sigma=0.0)
    keys = jax.random.split(jax.random.key(0), 40)
    first, states = rollout(env, keys, jnp.tile(jnp.arange(4, dtype=jnp.int32), 10)[None])
    moved = states.inner.xy[0] - first.inner.xy
    wanted = 3.0 * jnp.tile(jnp.array(base.DIRECTIONS_XY), (10, 1))
    is_far = (jnp.abs(first.inner.xy - jnp.array([[19.5, -19.5]])) < 14).all(-1)
    assert is_far.sum() > 20
    assert jnp.where(is_far[:, None], moved - wanted, 0.0) == pytest.approx(0.0, abs=1e-5)


def test_noise_has_its_standard_deviation_on_both_axes_and_is_fresh():
    text = "\n".join(["#" * 25] + ["#" + "." * 23 + "#"] * 23 + ["#1#######################"])
    middle = text.splitlines()
    middle[12] = "#" + "." * 11 + "S" + "." * 11 + "#"
    env = make(mazes.parse("\n".join(middle)), sigma=0.3)
    num_envs = 1500
    first, states = rollout(
        env, jax.random.split(jax.random.key(0), num_envs), jnp.full((2, num_envs), NORTH)
    )
    xy = jnp.concatenate([first.inner.xy[None], states.inner.xy])
    noise = np.asarray(jnp.diff(xy, axis=0) - jnp.array([[[0.0, 3.0]]]))
    assert noise.mean((0, 1)) == pytest.approx(0.0, abs=0.02)
    assert noise.std((0, 1)) == pytest.approx(0.3, rel=0.05)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.05


def move(env, xy, displacement):
    """Moves in a maze without door candidates."""
    nav = task.Navigation(
        maze=jnp.int32(0),
        door_ij=jnp.array([task.NO_DOOR] * 2),
        visited=jnp.zeros(9, bool),
        decisions=jnp.int32(0),
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


def test_an_episode_pays_each_goal_once_and_ends_with_the_last():
    env = make(mazes.parse("#######\n#S.1.2#\n#######", num_decisions=9), sigma=0.0)
    actions = jnp.stack([EAST, EAST, WEST, EAST, EAST, EAST])[:, None]
    _, states = rollout(env, jax.random.split(jax.random.key(0), 1), actions)
    assert states.reward[:, 0].tolist() == [0, 1, 0, 0, 0, 1]
    assert states.terminated[:, 0].tolist() == [False] * 5 + [True]
    assert not states.truncated.any()
    assert states.metrics["success"][:, 0].tolist() == [0, 0.5, 0.5, 0.5, 0.5, 1]
    assert states.metrics["return"][:, 0].tolist() == [0, 1, 1, 1, 1, 2]
    assert states.metrics["decisions"][:, 0].tolist() == [1, 2, 3, 4, 5, 6]


def test_the_time_limit_truncates():
    env = make(mazes.load("g1", num_decisions=3))
    actions = jnp.full((3, 4), SOUTH)
    _, states = rollout(env, jax.random.split(jax.random.key(0), 4), actions)
    assert states.truncated[:, 0].tolist() == [False, False, True]
    assert not states.terminated.any()
    assert (states.metrics["success"] == 0).all()


def test_dense_reward_of_every_step():
    env = make("g3", reward="dense")
    _, states = rollout(env, jax.random.split(jax.random.key(0), 8), random_actions(6, 8))
    goal_xy = jnp.array([[[13.5, -1.5]]])
    distance = jnp.sqrt(((states.inner.xy - goal_xy) ** 2).sum(-1))
    is_open = ~jnp.cumsum(states.terminated, 0).astype(bool)
    assert jnp.where(is_open, states.reward, 0.0) == pytest.approx(
        np.asarray(jnp.where(is_open, 1 / (1 + distance), 0.0)), rel=1e-5
    )


def test_the_same_key_gives_the_same_episode_alone_and_in_a_batch():
    env = make("random")
    keys = jax.random.split(jax.random.key(3), 3)
    _, states = rollout(env, keys, jnp.full((2, 3), EAST))
    step = jax.jit(env.step)
    alone = step(step(env.reset(keys[1]), EAST), EAST)
    assert alone.inner.xy == pytest.approx(np.asarray(states.inner.xy[1, 1]), abs=1e-5)
    assert (alone.obs == states.obs[1, 1]).mean() > 0.99
    assert (jax.random.key_data(alone.key) == jax.random.key_data(states.key[1, 1])).all()


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
