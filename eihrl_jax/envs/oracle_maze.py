"""The high level's training ground: the simulator moves the robot directly (paper, Sec. 3.2).

A decision moves the body by one cell in the chosen direction plus a normal offset on both axes, and
shows the robot in a recorded posture (epsilon-Invariant Randomization). There is no physics, so a
learner can make hundreds of thousands of decisions per second.

Observation: bool [P, P, 3], a top view centred on the torso, north up; channels wall, unvisited
goal, robot; or a map of what has been seen (see `raster`).
Action: int32, index of the direction in `base.DIRECTIONS_XY`.
Reward: sparse, the number of goals entered for the first time; or dense, 1 / (1 + d), d the
distance in units to the current goal, and 1 once all have been visited.
Termination: all goals visited, with sparse reward; truncation: the maze's number of decisions.
Reset: maze, door, start and posture are drawn anew.
"""

import copy
import dataclasses
import functools
import math
from typing import Annotated, TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.config import checks, limits
from eihrl_jax.envs import postures, raster, subgoals, task
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.robots import robot as robot_lib

_ABOVE_MINUS_ONE = -1.0 + 2.0**-24  # where the inverse error function is still finite


@dataclasses.dataclass(frozen=True, kw_only=True)
class Movement:
    """How the simulator moves the robot.

    Attributes:
      step: nominal length of a move, units.
      sigma: standard deviation of the offset on each axis, drawn anew for every decision, units.
      num_substeps: number of equal parts of a move; each stops at walls, one axis after the other.
      body_radius: half the side of the body, a square that can't enter a wall, units.
      anchored: whether moves are measured from the middle of the robot's cell, see `task.anchor`.

    Raises:
      base.UserError: a number is out of its limits.
    """

    step: Annotated[float, limits.Range(0.0, 4 * base.CELL)] = base.CELL
    sigma: Annotated[float, limits.Range(0.0, base.CELL)] = base.SIGMA
    num_substeps: Annotated[int, limits.Range(1, 100)] = 6
    body_radius: Annotated[float, limits.Range(0.0, base.CELL / 2)] = 0.7
    anchored: bool = False

    def __post_init__(self) -> None:
        """Checks each number, and that no part of a move can jump over a wall."""
        limits.check(self, "movement ")
        # A normal float32 draw stays below six standard deviations.
        back = task.MAX_WAY_BACK if self.anchored else 0.0
        longest = (self.step + back + 6 * self.sigma) / self.num_substeps
        if longest >= base.CELL:
            raise base.UserError(
                f"movement num_substeps {self.num_substeps} is too small: a part of a move could "
                f"be {longest:.1f} units long and jump over a wall of {base.CELL}"
            )


class OracleMazeState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      nav: state of the task.
      xy: float32 [2], position of the torso, units.
      posture: int32, row of the bank of silhouettes that is shown.
      total_reward: float32, rewards of the episode so far.
    """

    nav: task.Navigation
    xy: Float[Array, "2"]
    posture: Int[Array, ""]
    total_reward: Float[Array, ""]


EnvState: TypeAlias = base.EnvState[OracleMazeState, raster.Picture]


class OracleMaze:
    """One maze, or a different one in every episode, with oracle movement.

    >>> import jax, eihrl_jax
    >>> robot, maze = eihrl_jax.load_robot("ant"), eihrl_jax.load_maze("u")
    >>> env = eihrl_jax.OracleMaze.of_robot(robot, maze)
    >>> state = jax.jit(env.reset)(jax.random.key(0))
    >>> state.obs.shape
    (15, 15, 3)
    """

    def __init__(
        self,
        mazes: maze_lib.Maze,
        silhouettes: Bool[Array, "N P P"],
        *,
        view: raster.View,
        movement: Movement,
        reward: base.Reward = "sparse",
    ):
        """Prepares mazes and silhouettes.

        Args:
          mazes: one maze, or several with a leading axis of which each episode draws one.
          silhouettes: the robot in N postures, see `raster.footprint`.
          view: extent and resolution of the observation.
          movement: how the robot is moved.
          reward: "sparse" or "dense".

        Raises:
          base.UserError: an unknown reward, silhouettes of another resolution, or a body that
            could begin an episode inside a wall.
        """
        checks.one_of("reward", reward, base.REWARDS)
        if silhouettes.ndim != 3 or silhouettes.shape[1:] != (view.pixels, view.pixels):
            raise base.UserError(
                f"silhouettes of shape {silhouettes.shape} do not fit a view of "
                f"{view.pixels} x {view.pixels} pixels"
            )

        self.table = task.prepare(mazes, view.margin)
        # Starts are drawn around a cell's middle; neighbouring cells may be walls.
        room = base.CELL / 2 - float(self.table.mazes.start_jitter.max())
        if movement.body_radius > room:
            raise base.UserError(
                f"movement body_radius {movement.body_radius} is above {room:.3f}, the room "
                "between a start and the walls beside its cell"
            )

        self.view = view
        self.movement = movement
        self.reward: base.Reward = reward
        self._num_postures = jnp.int32(silhouettes.shape[0])
        pack = functools.partial(raster.pack, view=view)
        self._silhouettes = jax.vmap(pack)(jnp.asarray(silhouettes))

    @classmethod
    def of_robot(
        cls,
        robot: robot_lib.Robot,
        mazes: maze_lib.Maze,
        *,
        view: raster.View = raster.View(),
        gait: subgoals.Gait | None = None,
        num_substeps: int = Movement.num_substeps,
        anchored: bool = Movement.anchored,
        reward: base.Reward = "sparse",
    ) -> "OracleMaze":
        """Builds the maze for a robot, with its postures and its body's radius.

        Args:
          robot: the robot.
          mazes: see the constructor.
          view: see the constructor.
          gait: what the oracle imitates; None: a cell per subgoal, `base.SIGMA`, shipped postures.
          num_substeps: see `Movement`.
          anchored: see `Movement`.
          reward: see the constructor.

        Raises:
          base.UserError: a number is out of its limits.
        """
        if gait is None:
            gait = subgoals.gait(robot, None, base.CELL, base.SIGMA)

        movement = Movement(
            step=gait.step,
            sigma=gait.sigma,
            num_substeps=num_substeps,
            body_radius=robot.body_radius * robot.units_per_metre,
            anchored=anchored,
        )
        # Drawn once: a decision needs a look-up, but no kinematics.
        silhouettes = postures.footprints(robot, gait.bank, view)
        return cls(mazes, silhouettes, view=view, movement=movement, reward=reward)

    def covering(self) -> "OracleMaze":
        """Returns the same with a map of the whole mazes, see `raster.View.covering`."""
        whole = copy.copy(self)
        rows, columns = self.table.mazes.wall.shape[-2:]
        whole.view = self.view.covering(rows, columns)
        whole.table = task.prepare(self.table.mazes, whole.view.margin)
        return whole

    def reset(
        self,
        key: Key[Array, ""],
        maze: Int[Array, ""] | None = None,
        place: task.Place | None = None,
    ) -> EnvState:
        """Draws a new episode, in a given maze and place or in any; the key is consumed."""
        next_key, start_key, posture_key = jax.random.split(key, 3)
        nav, xy = task.start(self.table, start_key, maze, place)

        inner = OracleMazeState(
            nav=nav,
            xy=xy,
            posture=task.pick(jax.random.uniform(posture_key), self._num_postures),
            total_reward=jnp.float32(0.0),
        )
        return self._state(inner, base.Outcome.of_reset(), next_key)

    def step(self, state: EnvState, action: Int[Array, ""]) -> EnvState:
        """Moves the robot in direction `action`."""
        inner = state.inner
        next_key, draw_key = jax.random.split(state.key)

        # One draw for offset and posture, because on CPU random bits are a large part of the cost.
        draws = jax.random.uniform(draw_key, (3,), minval=_ABOVE_MINUS_ONE, maxval=1.0)
        # Paper, Sec. 3.2: epsilon is normal; sqrt(2) erf^-1 makes a normal draw of a uniform one.
        noise = self.movement.sigma * math.sqrt(2.0) * jax.lax.erf_inv(draws[:2])
        displacement = self.movement.step * jnp.array(base.DIRECTIONS_XY)[action] + noise
        if self.movement.anchored:
            displacement += task.anchor(inner.xy) - inner.xy
        path_xy = self.move(inner.nav, inner.xy, displacement)

        nav, outcome = task.advance(self.table, inner.nav, path_xy, self.reward)
        inner = OracleMazeState(
            nav=nav,
            xy=path_xy[-1],
            posture=task.pick(0.5 * (draws[2] + 1.0), self._num_postures),
            total_reward=inner.total_reward + outcome.reward,
        )
        return self._state(inner, outcome, next_key)

    def observe(self, inner: OracleMazeState) -> raster.Picture:
        """Draws what the high level sees."""
        silhouette = self._silhouettes[inner.posture]
        return task.observe(self.table, inner.nav, inner.xy, silhouette, self.view)

    def move(
        self,
        nav: task.Navigation,
        xy: Float[Array, "2"],
        displacement: Float[Array, "2"],
    ) -> Float[Array, "T 2"]:
        """Moves the body in equal parts; on either axis a part that would enter a wall is left out.

        Args:
          nav: the episode, which says where walls are.
          xy: position of the torso, units.
          displacement: the whole move if nothing is in the way, units.

        Returns:
          Position after each part, units.
        """
        num, radius = self.movement.num_substeps, self.movement.body_radius
        part = displacement / num
        reach = part + jnp.sign(part) * radius  # from the torso to the body's leading edges
        corners = jnp.array([-radius, radius])

        def advance(xy: Float[Array, "2"], _: None) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
            # A body narrower than a cell is in a wall if an end of its leading edge is. The y axis
            # looks from where the x axis has moved to, so that no corner is cut.
            x, y = xy
            edge = jnp.stack([jnp.broadcast_to(x + reach[0], 2), y + corners], -1)
            x = jnp.where(self._is_blocked(nav, edge), x, x + part[0])
            edge = jnp.stack([x + corners, jnp.broadcast_to(y + reach[1], 2)], -1)
            y = jnp.where(self._is_blocked(nav, edge), y, y + part[1])
            xy = jnp.stack([x, y])
            return xy, xy

        _, path_xy = jax.lax.scan(advance, xy, None, length=num)
        return path_xy

    def _is_blocked(self, nav: task.Navigation, edge: Float[Array, "2 2"]) -> Bool[Array, ""]:
        """Returns whether one of the ends of the body's leading edge would be in a wall."""
        one, other = task.code_at(self.table, nav, edge)
        return (one | other) >= maze_lib.WALL

    def _state(
        self, inner: OracleMazeState, outcome: base.Outcome, key: Key[Array, ""]
    ) -> EnvState:
        """Makes the state that `reset` and `step` return."""
        # Look first, so that a map shows what is in sight now.
        inner = inner.replace(nav=task.look(self.table, inner.nav, inner.xy, self.view))

        metrics = {
            "success": task.success(self.table, inner.nav),
            "decisions": inner.nav.decisions,
            "return": inner.total_reward,
        }
        return base.EnvState.of(
            inner=inner, obs=self.observe(inner), outcome=outcome, metrics=metrics, key=key
        )
