"""MuJoCo's own renderer, which needs OpenGL: the robot as its model has it, among drawn walls."""

import functools
import math
import warnings
import weakref

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eihrl_jax import base
from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import layout, palette
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import scene
from eihrl_jax.robots import robot as robot_lib

_GOAL_HEIGHT = 0.02  # units, so that goals lie on the floor and not in it


@functools.cache
def is_there() -> bool:
    """Returns whether this process has OpenGL: without a display by MUJOCO_GL=egl or osmesa."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW warns that there is no display
            context = mujoco.GLContext(8, 8)
            # It has no other sign of failure, and a renderer without context ends the process.
            is_open = bool(getattr(context, "_context", None))
            context.free()
            return is_open
    # Every way to OpenGL that is missing fails in its own way.
    except (ImportError, AttributeError, OSError, RuntimeError):
        return False


class View:
    """An open renderer that sees a whole maze."""

    def __init__(self, robot: robot_lib.Robot, shape: tuple[int, ...], width: int, height: int):
        """Opens a renderer, for which OpenGL must be there.

        Args:
          robot: what is drawn.
          shape: rows and columns of the mazes.
          width: of the picture, pixels.
          height: of the picture, pixels.
        """
        self._metres = 1.0 / robot.units_per_metre
        camera = camera_lib.fit(*shape, width=width, height=height)
        low, high = camera_lib.drawn_area(*shape)
        centre = (low + high) / 2 * self._metres
        distance = float(np.linalg.norm(camera.position * self._metres - centre))

        # A model of its own, whose camera sees as far and as wide as the maze is.
        model = scene.build(robot)
        model.stat.extent = distance
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.global_.fovy = math.degrees(2 * math.atan(height / 2 / camera.focal))
        model.vis.headlight.ambient[:] = model.vis.headlight.diffuse[:] = 0.5
        floor = model.geom(scene.FLOOR).id
        model.geom_rgba[floor] = [*palette.rgb(palette.FLOOR), 1.0]

        self._camera = mujoco.MjvCamera()
        self._camera.lookat[:] = centre
        self._camera.distance = distance
        self._camera.azimuth = 90.0
        self._camera.elevation = -math.degrees(camera_lib.PITCH)
        self._data = mujoco.MjData(model)
        self._model = model
        self._renderer = mujoco.Renderer(model, height, width)
        # Also when Python ends, before the modules go that closing needs.
        self.close = weakref.finalize(self, self._renderer.close)

    def draw(
        self, maze: maze_lib.Maze, visited: Bool[np.ndarray, "9"], qpos: Float[np.ndarray, " nq"]
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draws a robot in a maze, see `snapshot.Painter.draw`."""
        self._data.qpos[:] = qpos
        self._data.qpos[:2] *= self._metres
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)

        area = camera_lib.drawn_area(*maze.wall.shape)
        for cells in layout.wall_rectangles(np.asarray(maze.wall)):
            low, high = _box(cells, camera_lib.WALL_HEIGHT)
            self._add_box(np.clip(low, *area), np.clip(high, *area), palette.WALL)
        goal = np.asarray(maze.goal)
        for number in np.unique(goal[goal > 0]).tolist():
            colour = palette.GOAL_ACHIEVED if visited[number - 1] else palette.GOAL
            for cells in layout.wall_rectangles(goal == number):
                self._add_box(*_box(cells, _GOAL_HEIGHT), colour)
        return self._renderer.render()

    def _add_box(
        self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], colour: str
    ) -> None:
        """Adds a box to what is drawn, which physics knows nothing of; corners in units."""
        drawn = self._renderer.scene
        if drawn.ngeom == drawn.maxgeom:
            return
        mujoco.mjv_initGeom(
            drawn.geoms[drawn.ngeom],
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=((high - low) / 2 * self._metres).astype(np.float64),
            pos=((high + low) / 2 * self._metres).astype(np.float64),
            mat=np.eye(3).ravel(),
            rgba=np.array([*palette.rgb(colour), 1.0], np.float32),
        )
        drawn.ngeom += 1


def _box(
    cells: Int[np.ndarray, "4"], height: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Returns lower and upper corner of a box on a rectangle of cells, units."""
    i0, j0, i1, j1 = base.CELL * cells
    return np.array([j0, -i1, 0.0]), np.array([j1, -i0, height])
