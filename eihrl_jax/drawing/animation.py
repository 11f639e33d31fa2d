"""Animations of a robot in a maze: the maze at a slant, and what the high level sees."""

import functools
import pathlib
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image, ImageDraw

from eihrl_jax import base
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import film, palette, picture, scenery
from eihrl_jax.drawing import panel as panel_lib
from eihrl_jax.drawing import shots as shots_lib
from eihrl_jax.evaluation import recording as recording_lib
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import kinematics
from eihrl_jax.runs import progress as progress_lib

MAZE_SIZE = (560, 512)
"""Width and height of the maze's picture, pixels."""

_MAX_FRAMES = 240  # 12 s; longer ones make files that pages load slowly
_ARROW = (
    (0.75, 0.07),
    (1.45, 0.07),
    (1.45, 0.24),
    (1.95, 0.0),
    (1.45, -0.24),
    (1.45, -0.07),
    (0.75, -0.07),
)
"""Outline of the subgoal's arrow, pointing to x+ from the torso, units."""

_N = picture.SUPERSAMPLING

_Geoms = tuple[Float[np.ndarray, "*F G 3"], Float[np.ndarray, "*F G 3"], Float[np.ndarray, "*F G"]]
"""Ends and radii of a robot's geoms, units, in one or in F frames, on the host."""


def save(
    path: pathlib.Path,
    recording: recording_lib.Recording,
    capsules: Callable[[jax.Array], kinematics.Capsules],
    *,
    title: str,
    reach: float,
    camera: evaluate_config.Camera = "auto",
) -> None:
    """Draws an episode as GIF or MP4.

    Args:
      path: where it goes; its ending tells the format.
      recording: the episode.
      capsules: from `qpos` to the robot's geoms, see `kinematics.capsules`.
      title: what stands above the panel.
      reach: greatest distance of any part of the robot from its torso's xy, units.
      camera: whether it follows the robot.

    Raises:
      base.UserError: see `film.check`.
    """
    film.check(path)
    num_frames = len(_shown(len(recording.qpos)))
    with progress_lib.Progress(f"drawing {path.name}", num_frames, unit="frames") as progress:

        def drawn() -> Iterator[UInt8[np.ndarray, "H W 3"]]:
            frames = render(recording, capsules, title=title, reach=reach, camera=camera)
            for number, frame in enumerate(frames, 1):
                progress.update(number)
                yield frame

        film.save(path, drawn())


def render(
    recording: recording_lib.Recording,
    capsules: Callable[[jax.Array], kinematics.Capsules],
    *,
    title: str,
    reach: float,
    camera: evaluate_config.Camera = "auto",
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Yields the pictures of an episode, uint8 [height, width, 3]; see `save`."""
    maze, xy = recording.maze, recording.qpos[:, :2]
    steps = _shown(len(xy))
    visited = _visited(maze, xy)
    size = _N * MAZE_SIZE[0], _N * MAZE_SIZE[1]
    shots = shots_lib.plan(maze, xy[steps], reach, camera, size)
    scene = scenery.Scenery(maze, shots.camera)
    geoms = jax.jit(jax.vmap(capsules))(jnp.asarray(recording.qpos[steps], jnp.float32))
    geoms = jax.device_get(geoms)
    windows = _windows(shots.camera, geoms, scene.pixels_per_unit, size)
    path = shots.camera.project(np.concatenate([xy, np.full((len(xy), 1), 0.02)], 1))

    @functools.cache
    def panel(decision: int, is_fallen: bool, achieved: tuple[bool, ...]) -> Image.Image:
        about = {"decision": decision, "is_fallen": is_fallen, "num_achieved": sum(achieved)}
        drawn = panel_lib.draw(recording, title, MAZE_SIZE[1], **about)
        if not shots.is_whole:
            panel_lib.add_plan(drawn, maze, np.array(achieved))
        return drawn

    stage, before = None, 0
    for frame, step in enumerate(steps):
        corner, decision = shots.corners[frame], int(recording.decision[step])
        # Drawn anew only when the camera has moved or a goal has been reached.
        if stage is None or stage.is_other(corner, visited[step]):
            stage, before = _Stage(scene, corner, visited[step]), 0
        stage.add_trail(path[before : step + 1])
        before = step

        arrow = None
        if recording.direction is not None:
            arrow = _arrow(scene, xy[step], int(recording.direction[decision]))
        geom = jax.tree.map(lambda leaf, frame=frame: leaf[frame], geoms)
        image = stage.with_robot(windows[frame], arrow, geom)

        page = Image.new("RGB", (MAZE_SIZE[0] + panel_lib.WIDTH, MAZE_SIZE[1]))
        page.paste(Image.fromarray(image), (0, 0))
        is_fallen = bool(recording.is_fallen[step])
        page.paste(panel(decision, is_fallen, tuple(visited[step].tolist())), (MAZE_SIZE[0], 0))
        if not shots.is_whole:
            panel_lib.mark_robot(page, MAZE_SIZE[0], maze, xy[step])
        yield np.asarray(page)


def _shown(num_steps: int) -> list[int]:
    """Returns the moves that are shown: long episodes skip some; the last one always is."""
    stride = max(1, -(-num_steps // _MAX_FRAMES))
    return [*range(0, num_steps - 1, stride), num_steps - 1]


@jax.jit
def _goals_at(maze: maze_lib.Maze, xy: Float[jax.Array, "T 2"]) -> Int[jax.Array, " T"]:
    return jax.vmap(functools.partial(maze_lib.goal_at, maze))(xy)


def _visited(maze: maze_lib.Maze, xy: Float[np.ndarray, "T 2"]) -> Bool[np.ndarray, "T 9"]:
    """Returns for each move which goals have been visited up to then."""
    number = np.asarray(_goals_at(maze, jnp.asarray(xy, jnp.float32)))
    here = number[:, None] == np.arange(1, maze_lib.MAX_GOALS + 1)
    return np.logical_or.accumulate(here, 0)


def _arrow(
    scene: scenery.Scenery, xy: Float[np.ndarray, "2"], direction: int
) -> Float[np.ndarray, "P 2"]:
    """Returns the outline of the arrow of a subgoal in the picture."""
    cos, sin = base.DIRECTIONS_XY[direction]
    outline = xy + np.array(_ARROW) @ np.array([[cos, sin], [-sin, cos]])
    return scene.camera.project(np.concatenate([outline, np.full((len(outline), 1), 0.02)], 1))


class _Stage:
    """The part of a maze that the camera sees, with the way so far; the robot comes and goes.

    All that doesn't move is drawn once, and the finished picture is kept beside the large one.
    """

    def __init__(
        self, scene: scenery.Scenery, corner: Int[np.ndarray, "2"], visited: Bool[np.ndarray, "9"]
    ):
        """Draws the maze.

        Args:
          scene: the maze and who sees it.
          corner: first column and row of the window.
          visited: goals that have been reached.
        """
        self._scene, self._corner, self._visited = scene, corner, visited
        width, height = _N * MAZE_SIZE[0], _N * MAZE_SIZE[1]
        self._region = scene.region(corner, width=width, height=height)
        self._region.paint_goals(visited)

        self._canvas = self._region.colour.copy()
        self._trail = Image.new("L", (width, height))
        self._image = picture.finish(self._canvas)

    def is_other(self, corner: Int[np.ndarray, "2"], visited: Bool[np.ndarray, "9"]) -> bool:
        """Returns whether another part is to be seen, or other goals have been reached."""
        return bool((corner != self._corner).any() or (visited != self._visited).any())

    def add_trail(self, path: Float[np.ndarray, "N 2"]) -> None:
        """Adds a piece of the way, in pixels of the large picture; walls hide it."""
        width = max(3, round(0.13 * self._scene.pixels_per_unit))
        points = path - self._corner
        low, high = points.min(0) - width, points.max(0) + width
        box = self._box(low, high)
        # Of a long way the piece that is seen is short.
        is_near = ((points > -width) & (points < np.array(self._trail.size) + width)).all(1)
        pen, r = ImageDraw.Draw(self._trail), width / 2
        for i in np.flatnonzero(is_near).tolist():
            # Round ends, where one line of the trail joins the next.
            x, y = points[i].tolist()
            pen.line([*points[max(i - 1, 0)].tolist(), x, y], fill=255, width=width)
            pen.ellipse((x - r, y - r, x + r, y + r), fill=255)

        if box is not None:
            self._canvas[box] = self._region.colour[box]
            is_trail = np.asarray(self._trail.crop(_bounds(box))) > 0
            where = self._region.is_floor[box] & is_trail
            _lay(self._canvas[box], where, palette.TRAIL, opacity=0.75)
            self._image[_halved(box)] = picture.finish(self._canvas[box])

    def with_robot(
        self,
        window: Int[np.ndarray, "2 2"],
        arrow: Float[np.ndarray, "P 2"] | None,
        geoms: _Geoms,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Returns the finished picture with the robot and the arrow of its subgoal.

        Args:
          window: first and last pixel + 1 of the large picture between which the robot lies.
          arrow: outline in these pixels; None for a baseline.
          geoms: its parts.
        """
        image, canvas = self._image.copy(), self._canvas
        # Shifted where it would reach beyond the picture: what draws it takes one size.
        size = window[1] - window[0]
        first = np.clip(window[0] - self._corner, 0, np.array(self._trail.size) - size)
        robot = _slices(first, first + size)
        box = robot
        if arrow is not None:
            outline = arrow - self._corner
            low, high = np.minimum(first, outline.min(0)), np.maximum(first + size, outline.max(0))
            box = self._box(low, high) or robot

        part = canvas[box].copy()
        if arrow is not None:
            mask = Image.new("L", part.shape[1::-1])
            points = (outline - _first(box)).tolist()
            ImageDraw.Draw(mask).polygon([(x, y) for x, y in points], fill=255)
            where = self._region.is_floor[box] & (np.asarray(mask) > 0)
            _lay(part, where, palette.ARROW, opacity=0.9)

        # The robot's own window lies within.
        inner = _slices(first - _first(box), first - _first(box) + size)
        behind = scenery.Region(*(leaf[robot] for leaf in self._region))
        picture.place_robot(part[inner], self._scene.camera, self._corner + first, behind, geoms)
        image[_halved(box)] = picture.finish(part)
        return image

    def _box(
        self, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
    ) -> tuple[slice, slice] | None:
        """Returns what of a rectangle is seen, its sides even; None for nothing."""
        height, width = self._canvas.shape[:2]
        x0, y0 = (2 * int(max(at, 0) // 2) for at in low)
        x1, y1 = (
            min(2 * int(at // 2 + 1), most) for at, most in zip(high, (width, height), strict=True)
        )
        return (slice(y0, y1), slice(x0, x1)) if x0 < x1 and y0 < y1 else None


def _windows(
    camera: camera_lib.Camera, geoms: _Geoms, scale: float, size: tuple[int, int]
) -> Int[np.ndarray, "F 2 2"]:
    """Returns first and last pixel + 1 of a robot and its shadow in F frames, all equally large."""
    start, end, radius = (np.nan_to_num(np.asarray(leaf)) for leaf in geoms)
    # A shadow lies where the light's rays through a point meet the floor.
    slope = np.array(scenery.LIGHT) / scenery.LIGHT[2]
    ends = np.concatenate([start, end], 1)
    both = np.concatenate([ends, ends - ends[..., 2:] * slope], 1)
    at = camera.project(both.reshape(-1, 3)).reshape(*both.shape[:2], 2)
    around = 1.2 * scale * np.concatenate([radius] * 4, 1)[..., None]
    low, high = (at - around).min(1), (at + around).max(1)

    # One size for all, in steps that few robots and mazes need many of.
    side = 32 * np.ceil((high - low).max(0) / 32).astype(int)
    side = np.minimum(side, size)
    first = 2 * np.round(((low + high) / 2 - side / 2) / 2).astype(int)
    return np.stack([first, first + side], 1)


def _slices(low: Int[np.ndarray, "2"], high: Int[np.ndarray, "2"]) -> tuple[slice, slice]:
    """Returns rows and columns of a rectangle between two corners, each column and row."""
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _first(box: tuple[slice, slice]) -> Int[np.ndarray, "2"]:
    """Returns column and row of a rectangle's first pixel."""
    return np.array([box[1].start, box[0].start])


def _bounds(box: tuple[slice, slice]) -> tuple[int, int, int, int]:
    """Returns left, top, right and bottom of a rectangle."""
    rows, columns = box
    return columns.start, rows.start, columns.stop, rows.stop


def _halved(box: tuple[slice, slice]) -> tuple[slice, slice]:
    """Returns a rectangle in the finished picture."""
    rows, columns = (slice(part.start // _N, part.stop // _N) for part in box)
    return rows, columns


def _lay(
    canvas: UInt8[np.ndarray, "H W 3"],
    where: Bool[np.ndarray, "H W"],
    colour: str,
    *,
    opacity: float,
) -> None:
    """Lays a colour over some pixels, in place."""
    own = opacity * 255.0 * palette.rgb(colour) + 0.5
    canvas[where] = ((1.0 - opacity) * canvas[where] + own).astype(np.uint8)
