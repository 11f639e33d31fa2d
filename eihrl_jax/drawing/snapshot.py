"""Pictures of a robot in its maze at one moment: by OpenGL where that is there, else ray by ray."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from eihrl_jax.drawing import camera as camera_lib
from eihrl_jax.drawing import opengl, picture, scenery
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.robots import robot as robot_lib

SIZE = (480, 480)
"""Width and height of a picture, pixels."""

_SHADOW = 0.8
"""How far shadows fall beyond a robot, units."""


class Painter:
    """Draws one robot, and remembers the maze that it drew last; a copy of it begins anew."""

    def __init__(self, robot: robot_lib.Robot):
        """Draws nothing yet."""
        self._robot = robot
        self._forget()

    def draw(
        self, maze: maze_lib.Maze, visited: Bool[np.ndarray, "9"], qpos: Float[np.ndarray, " nq"]
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draws the robot in a maze whose door is open, goals that have been visited in green.

        Args:
          maze: one maze, on the host.
          visited: which goals have been.
          qpos: the robot's posture, x and y in units.
        """
        if not opengl.is_there():
            return self._cast(maze, visited, qpos)
        if self._view is None:
            self._view = opengl.View(self._robot, maze.wall.shape, *SIZE)
        return self._view.draw(maze, visited, qpos)

    def _cast(
        self, maze: maze_lib.Maze, visited: Bool[np.ndarray, "9"], qpos: Float[np.ndarray, " nq"]
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draws with the ray caster."""
        drawn = np.asarray(maze.wall).tobytes() + np.asarray(maze.goal).tobytes()
        if self._scenery is None or drawn != self._drawn:
            width, height = self._size
            camera = camera_lib.fit(*maze.wall.shape, width=width, height=height)
            self._scenery, self._drawn = scenery.Scenery(maze, camera), drawn
        if self._capsules is None:
            model = scene.build(self._robot)
            self._capsules = jax.jit(kinematics.capsules(model, self._robot.units_per_metre))

        region = self._scenery.region(np.zeros(2, int), width=self._size[0], height=self._size[1])
        region.paint_goals(visited)
        geoms = jax.device_get(self._capsules(jnp.asarray(qpos, jnp.float32)))
        window, corner = self._window(self._scenery, geoms[0][0])
        behind = scenery.Region(*(leaf[window] for leaf in region))
        picture.place_robot(region.colour[window], self._scenery.camera, corner, behind, geoms)
        return picture.finish(region.colour)

    def _window(
        self, seen: scenery.Scenery, torso_xyz: Float[np.ndarray, "3"]
    ) -> tuple[tuple[slice, slice], Int[np.ndarray, "2"]]:
        """Returns rows and columns in which robot and shadow lie, and the first of each, (x, y)."""
        # As large wherever it is: what draws a robot is compiled for one size.
        reach = self._robot.reach * self._robot.units_per_metre + _SHADOW
        side = min(2 * int(np.ceil(1.15 * reach * seen.pixels_per_unit)), *self._size)
        middle = seen.camera.project(torso_xyz[None])[0]
        corner = np.clip(np.round(middle - side / 2).astype(int), 0, np.array(self._size) - side)
        x, y = corner.tolist()
        return (slice(y, y + side), slice(x, x + side)), corner

    def close(self) -> None:
        """Closes what is open to draw with; another picture opens it again."""
        if self._view is not None:
            self._view.close()
        self._forget()

    @property
    def _size(self) -> tuple[int, int]:
        """Width and height of the large picture, of which a finished pixel is the mean of some."""
        return picture.SUPERSAMPLING * SIZE[0], picture.SUPERSAMPLING * SIZE[1]

    def _forget(self) -> None:
        """Begins anew."""
        self._view: opengl.View | None = None
        self._scenery: scenery.Scenery | None = None
        self._drawn = b""
        self._capsules: jax.stages.Wrapped | None = None

    def __getstate__(self) -> dict[str, robot_lib.Robot]:
        """Returns what a copy needs: what is open to draw with stays here."""
        return {"_robot": self._robot}

    def __setstate__(self, saved: dict[str, robot_lib.Robot]) -> None:
        """Takes over what `__getstate__` returned."""
        self._robot = saved["_robot"]
        self._forget()
