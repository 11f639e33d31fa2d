import pathlib
import sys
import types

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from eihrl_jax import base, mazes
from eihrl_jax.drawing import (
    animation,
    curves,
    film,
    heatmap,
    layout,
    palette,
    panel,
    picture,
    raycast,
    scenery,
)
from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import shots as shots_lib
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.evaluation import whereabouts
from eihrl_jax.reporting import learning_curve

TEXT = """\
####1###
#......#
#.##...#
#S.....#
########
"""


@pytest.fixture(scope="module")
def maze():
    return mazes.parse(TEXT)


@pytest.fixture(scope="module")
def scene(maze):
    return scenery.Scenery(maze, camera_lib.fit(*maze.wall.shape, width=320, height=224))


@pytest.fixture(scope="module")
def region(scene):
    return scene.region(np.array([0, 0]), width=320, height=224)


def pixel(scene, x, y, z):
    """Returns row and column of a point of the world in the picture."""
    at = scene.camera.project(np.array([[x, y, z]]))[0]
    return int(at[1]), int(at[0])


def opened(path):
    """Returns a picture as an array."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def ray(x, y, z):
    one = jnp.ones((1, 1))
    return x * one, y * one, z * one


def test_camera_projects_where_its_rays_go():
    camera = camera_lib.fit(9, 9, width=300, height=200)
    direction = camera.rays(np.array([40, 60]), height=5, width=7)[:, 3, 2]
    np.testing.assert_allclose(np.linalg.norm(direction), 1.0, rtol=1e-6)
    at = camera.project(camera.position[None] + 30.0 * direction[None])
    np.testing.assert_allclose(at[0], (42.5, 63.5), atol=0.02)


def test_whole_maze_is_in_the_picture():
    camera = camera_lib.fit(9, 14, width=300, height=200)
    low, high = camera_lib.drawn_area(9, 14)
    corners = np.array(np.meshgrid(*np.stack([low, high], -1))).reshape(3, -1).T
    at = camera.project(corners)
    assert (at >= 0).all()
    assert (at <= (300, 200)).all()


def test_pixels_show_what_a_ray_meets_that_is_followed_step_by_step():
    maze = mazes.load("spiral")
    rows, columns = maze.wall.shape
    scene = scenery.Scenery(maze, camera_lib.fit(rows, columns, width=700, height=700))
    corner, size = np.array([130, 240]), 96  # across the border of tiles
    region = scene.region(corner, width=size, height=size)
    # From the height of the walls down, all pixels at once.
    ray = scene.camera.rays(corner, height=size, width=size).astype(float)
    start = scene.camera.position[:, None, None]
    top, floor = ((z - start[2]) / ray[2] for z in (camera_lib.WALL_HEIGHT, 0.0))
    is_met = np.zeros((size, size), bool)
    distance = floor.copy()
    for part in np.linspace(0.0, 1.0, 600):
        at = top + part * (floor - top)
        x, y, _ = start + at * ray
        i, j = (-y // base.CELL).astype(int), (x // base.CELL).astype(int)
        is_wall = np.asarray(maze.wall)[i.clip(0, rows - 1), j.clip(0, columns - 1)]
        distance = np.where(is_wall & ~is_met, at, distance)
        is_met |= is_wall
    assert 0.2 < is_met.mean() < 0.8
    assert (region.is_floor == ~is_met).mean() > 0.998  # edges fall to either side
    assert np.median(np.abs(region.distance - distance)) < 1e-3
    assert np.quantile(np.abs(region.distance - distance), 0.99) < 5e-3


@pytest.mark.parametrize(
    ("height", "distance"), [(0.0, 4.5), (1.0, 4.5), (1.3, 4.6), (1.6, raycast.FAR)]
)
def test_ray_meets_side_and_cap_of_a_capsule(height, distance):
    start, end = jnp.array([[5.0, 0.0, -1.0]]), jnp.array([[5.0, 0.0, 1.0]])
    origin = (jnp.zeros(()), jnp.zeros(()), jnp.float32(height))
    hit = raycast.capsules(origin, ray(1.0, 0.0, 0.0), start, end, jnp.array([0.5]))
    assert hit.distance[0, 0] == pytest.approx(distance, abs=1e-5)
    if distance < raycast.FAR:
        normal = np.array([float(n[0, 0]) for n in hit.normal])
        centre = np.array([5.0, 0.0, min(height, 1.0)])
        np.testing.assert_allclose(centre + 0.5 * normal, (distance, 0.0, height), atol=1e-5)


def test_rectangles_cover_the_walls_once(maze):
    wall = np.asarray(maze.wall)
    covered = np.zeros(wall.shape, int)
    for i0, j0, i1, j1 in layout.wall_rectangles(wall):
        covered[i0:i1, j0:j1] += 1
    np.testing.assert_array_equal(covered, wall)
    assert len(layout.wall_rectangles(wall)) < wall.sum() / 2


def test_walls_goals_and_floor_are_where_the_maze_has_them(maze, scene, region):
    for i, j in np.ndindex(*maze.wall.shape):
        x, y = (j + 0.5) * base.CELL, -(i + 0.5) * base.CELL
        on_ring = i in (0, 4) or j in (0, 7)
        if maze.wall[i, j] and not on_ring:
            row, column = pixel(scene, x, y, camera_lib.WALL_HEIGHT)
            assert not region.is_floor[row, column]
            red, _, blue = region.colour[row, column].astype(float)
            assert blue / red == pytest.approx(0x8C / 0x66, rel=0.02)
        elif not on_ring:
            row, column = pixel(scene, x, y, 0.0)
            assert region.is_floor[row, column]
            assert region.goal[row, column] == 0
    row, column = pixel(scene, 4.5 * base.CELL, -base.CELL + 0.6, 0.0)
    assert region.goal[row, column] == 1


def test_robot_is_drawn_where_it_is_and_seen_through_walls(scene, region):
    def drawn(x, y):
        canvas = region.colour.copy()
        centre = np.array([[x, y, 0.3]], np.float32)
        ball = (centre, centre, np.array([0.3], np.float32))
        picture.place_robot(canvas, scene.camera, np.array([0, 0]), region, ball)
        row, column = pixel(scene, x, y, 0.3)
        return canvas, (canvas != region.colour).any(-1), row, column

    canvas, differs, row, column = drawn(6 * base.CELL, -2.5 * base.CELL)
    rows, columns = np.nonzero(differs)
    assert np.hypot(rows - row, columns - column).max() < 1.3 * scene.pixels_per_unit
    red = np.array(palette.rgb(palette.ROBOT)) * 255
    assert np.abs(canvas[row, column] - red).max() < 80

    # A wall is mixed with what it hides, and there is no shadow on it.
    through, differs, row, column = drawn(2.5 * base.CELL, -2.5 * base.CELL)
    hidden, wall = through[row, column].astype(int), region.colour[row, column].astype(int)
    assert hidden[0] > wall[0] and hidden[2] < wall[2]
    assert hidden[0] < canvas.max()
    assert differs.sum() < (canvas != region.colour).any(-1).sum()


def test_finished_picture_averages():
    canvas = np.zeros((4, 6, 3), np.uint8)
    canvas[:2, :2] = 255
    canvas[2, 2] = 255
    image = picture.finish(canvas)
    assert image.shape == (2, 3, 3)
    assert image[0, 0, 0] == 255
    assert image[1, 1, 0] == 64


def test_a_camera_follows_a_robot_that_is_small_and_rests_in_between():
    maze = mazes.parse("#" * 40 + "\n#S" + "." * 36 + "1#\n" + "#" * 40)
    x = np.linspace(4.5, 112.0, 200)
    xy = np.stack([x, np.full(200, -4.5)], -1)
    size = (1120, 1024)
    shots = shots_lib.plan(maze, xy, 1.0, "auto", size)
    assert not shots.is_whole and (shots.corners % 2 == 0).all()
    at = shots.camera.project(np.concatenate([xy, np.zeros((200, 1))], 1)) - shots.corners
    assert (at > 0).all() and (at < size).all()
    moves = np.abs(np.diff(shots.corners[:, 0]))
    assert 0.9 < (moves == 0).mean() < 0.98  # a file holds the whole picture of the other frames
    assert shots.corners[-1, 0] - shots.corners[0, 0] > 2 * size[0]

    # All of a small maze is seen, of a large one if that is wanted.
    assert shots_lib.plan(mazes.load("u"), xy[:3], 1.0, "auto", size).is_whole
    whole = shots_lib.plan(maze, xy, 1.0, "whole", size)
    assert whole.is_whole and not whole.corners.any()


def ball(qpos):
    centre = jnp.array([[0.0, 0.0, 0.3]]).at[0, :2].set(qpos[:2])
    return centre, centre, jnp.array([0.4])


@pytest.fixture(scope="module")
def recording(maze):
    path = [(1.5, -10.5), (4.5, -10.5), (13.5, -10.5), (13.5, -4.5), (13.5, -2.0)]
    qpos = np.array(path, np.float32)
    patch = np.zeros((2, 5, 5, 3), bool)
    patch[:, 0, :, 0] = True
    return recording_lib.Recording(
        maze=maze,
        qpos=qpos,
        decision=np.array([0, 0, 0, 1, 1]),
        direction=np.array([0, 2]),
        patch=patch,
        is_fallen=np.zeros(5, bool),
    )


def test_animation_has_a_frame_per_move(tmp_path, recording, capsys):
    path = tmp_path / "episode.gif"
    animation.save(path, recording, ball, title="mine", reach=0.5)
    assert "drawing episode.gif: 100 % | 5/5 frames" in capsys.readouterr().out
    with Image.open(path) as image:
        assert image.n_frames == 5
        assert image.info["loop"] == 0
    assert path.stat().st_size < 300_000


@pytest.mark.parametrize("camera", ["whole", "follow"])
def test_goal_changes_colour_when_it_is_reached(recording, camera):
    frames = list(animation.render(recording, ball, title="mine", reach=1.0, camera=camera))
    size = (2 * animation.MAZE_SIZE[0], 2 * animation.MAZE_SIZE[1])
    shots = shots_lib.plan(recording.maze, recording.qpos[:, :2], 1.0, camera, size)
    assert shots.is_whole == (camera == "whole")
    seen = (shots.camera.project(np.array([[14.5, -2.6, 0.0]])) - shots.corners) / 2
    before, after = (
        frame[int(row), int(column)].astype(int)
        for frame, (column, row) in zip(frames[-2:], seen[-2:], strict=True)
    )
    assert before[0] > before[1]  # amber
    assert after[1] > after[0]  # green


def test_mp4_is_written_where_its_package_is_there(tmp_path, monkeypatch, recording):
    sent = []

    def write_frames(path, size, **_):
        pathlib.Path(path).touch()
        assert size == (animation.MAZE_SIZE[0] + panel.WIDTH, animation.MAZE_SIZE[1])
        while True:
            sent.append((yield))

    path = tmp_path / "episode.mp4"
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(base.UserError, match="mp4 needs the package imageio-ffmpeg"):
        animation.save(path, recording, ball, title="mine", reach=0.5)
    assert not path.exists()
    module = types.ModuleType("imageio_ffmpeg")
    module.write_frames = write_frames
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", module)
    animation.save(path, recording, ball, title="mine", reach=0.5)
    assert path.exists() and len(sent) == 5 + 35  # the last one stays for as long as in a GIF
    with pytest.raises(base.UserError, match=r"must end in \.gif or \.mp4"):
        film.check(tmp_path / "episode.avi")


def test_heatmap_shows_visits_and_walls(tmp_path, maze):
    bins = whereabouts.BINS_PER_CELL
    share = np.zeros((5 * bins, 8 * bins))
    share[bins : 2 * bins, bins : 2 * bins] = 1.0
    visits = heatmap.Visits("$x_{$ of mine", maze, share)
    heatmap.save(tmp_path / "one.png", visits)
    heatmap.save_together(tmp_path / "all.png", [visits, visits])
    pixels = opened(tmp_path / "one.png").reshape(-1, 3)
    wall = np.round(255 * palette.rgb(palette.WALL))
    assert (np.abs(pixels - wall) <= 1).all(-1).mean() > 0.1
    assert opened(tmp_path / "all.png").shape[1] > 800


def test_heatmap_of_nothing_is_drawn(tmp_path, maze):
    bins = whereabouts.BINS_PER_CELL
    visits = heatmap.Visits("mine", maze, np.zeros((5 * bins, 8 * bins)))
    heatmap.save(tmp_path / "none.png", visits)


def test_smoothing_keeps_a_constant_and_narrows_at_the_ends():
    np.testing.assert_allclose(curves.smooth(np.full(7, 3.0), 5), 3.0)
    np.testing.assert_allclose(curves.smooth(np.arange(5.0), 3), [0.5, 1, 2, 3, 3.5])


def test_curve_is_read_and_drawn(tmp_path):
    path = tmp_path / "metrics.csv"
    path.write_text("step,decisions,success\n1,100,0.1\n2,200,\n3,300,0.5\n")
    points = curves.read(path, "decisions", "success")
    np.testing.assert_array_equal(points, [[100, 0.1], [300, 0.5]])
    panels = [
        curves.Panel(y_label="success", groups={"one": [points], "other": [points + 1.0]}),
        curves.Panel(y_label="reward", groups={"other": [points, 2.0 * points]}, y_range=(0, 9)),
    ]
    curves.save_panels(tmp_path / "curve.png", panels, x_label="decisions")
    picture = opened(tmp_path / "curve.png")
    # The first line is in one panel, the second in both.
    colours = [tuple(bytes.fromhex(colour[1:])) for colour in palette.CURVE[:2]]
    middle = len(picture) // 2
    for half, wanted in ((picture[:middle], [True, True]), (picture[middle:], [False, True])):
        assert [bool((half == colour).all(-1).any()) for colour in colours] == wanted


def test_groups_of_curves_are_drawn_as_far_as_the_shortest_goes(tmp_path):
    rising = np.stack([np.arange(1.0, 9.0), np.arange(8.0)], -1)
    path = tmp_path / "spread.png"
    groups = {"one": [rising, rising[:5] + 1.0], "other": [rising]}
    curves.save_spread(path, groups, x_label="updates", y_label="distance")
    assert opened(path).shape[1] > 500


def test_curves_are_compared_at_the_same_places_and_no_farther():
    line = np.array([[0.0, 0.0], [10.0, 10.0], [20.0, 20.0]])
    other = np.array([[5.0, 1.0], [15.0, 3.0]])
    x, y = curves.aligned([line, other])
    np.testing.assert_array_equal(x, [5.0, 15.0])
    np.testing.assert_array_equal(y, [[5.0, 15.0], [1.0, 3.0]])
    x, y = curves.aligned([line, line + np.array([0.0, 1.0])])
    np.testing.assert_array_equal(y, [line[:, 1], line[:, 1] + 1.0])


def test_a_label_keeps_its_line_in_pictures_that_are_seen_together(tmp_path):
    rising = np.stack([np.arange(1.0, 9.0), np.arange(8.0)], -1)
    has = {}
    for name, groups in {"both": ("one", "other"), "one": ("one",), "other": ("other",)}.items():
        drawn = {group: [rising] for group in groups}
        path = tmp_path / f"{name}.png"
        curves.save_spread(path, drawn, x_label="x", y_label="y", labels=("one", "other"))
        pixels = {tuple(row) for row in opened(path).reshape(-1, 3).tolist()}
        wanted = [tuple(bytes.fromhex(colour[1:])) for colour in palette.CURVE[:3]]
        has[name] = [colour in pixels for colour in wanted]
    assert has == {
        "both": [True, True, False],
        "one": [True, False, False],
        "other": [False, True, False],
    }


def test_curves_upon_each_other_all_show_at_zero_too(tmp_path):
    nothing = np.stack([np.arange(1.0, 9.0), np.zeros(8)], -1)
    path = tmp_path / "nothing.png"
    groups = {"one": [nothing], "other": [nothing], "third": [nothing]}
    curves.save_spread(path, groups, x_label="x", y_label="y")
    picture = opened(path)
    below_legend = picture[len(picture) // 5 :]
    for colour in palette.CURVE[:3]:
        drawn = (below_legend == tuple(bytes.fromhex(colour[1:]))).all(-1)
        assert drawn.sum() > 100


def test_learning_curve_of_a_run(tmp_path):
    rows = ["step,num_decisions,success,eval/success", "1,100,0.1,", "2,200,nan,0.3", "3,300,0.5,"]
    (tmp_path / "config.json").write_text('{"task": {"reward": "sparse"}}')
    (tmp_path / "metrics.csv").write_text(rows[0] + "\n")
    learning_curve.renew(tmp_path)  # before there is a number
    path = tmp_path / "learning_curve.png"
    assert not path.exists()
    (tmp_path / "metrics.csv").write_text("\n".join(rows))
    learning_curve.renew(tmp_path)
    assert opened(path).shape[1] > 500


@pytest.mark.parametrize(
    ("text", "message"),
    [("a,b\n1,2\n", "no column"), ("decisions,success\n", "no values"), (None, "can't be read")],
)
def test_unusable_metrics_are_refused(tmp_path, text, message):
    path = tmp_path / "metrics.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(base.UserError, match=message):
        curves.read(path, "decisions", "success")


def test_a_gif_keeps_its_pixels_and_holds_only_what_changes(tmp_path):
    """Noise can't be compressed: a file of it is as large as what is written."""
    noise = np.random.default_rng(0).integers(0, 8, (64, 64)).astype(np.uint8) * 36
    frames = [np.stack([noise] * 3, -1) for _ in range(12)]
    for number, frame in enumerate(frames):
        frame[:, number] = frame[:, -number - 1] = 255  # far apart: most between them stays

    film.save(tmp_path / "a.gif", frames)
    film.save(tmp_path / "first.gif", frames[:1])
    size, first = ((tmp_path / name).stat().st_size for name in ("a.gif", "first.gif"))
    assert size < 3 * first
    with Image.open(tmp_path / "a.gif") as read:
        for number, frame in enumerate(frames):
            read.seek(number)
            assert np.abs(np.asarray(read.convert("RGB")).astype(int) - frame).max() < 16
