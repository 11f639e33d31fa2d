"""A robot with physics in a maze, with the same task and observation as in `oracle_maze`.

A decision is `begin`, k times `control`, and `end`; `envs.hierarchy` calls them with a low level's
controls.

Observation: bool [P, P, 3], a top view centred on the torso, north up, see `raster`; the silhouette
is that of the robot's real posture. Or a map of what has been seen.
Reward and end of an episode: those of `task`, along the torso's path; dense reward depends on where
a decision ends. A fall has no penalty and doesn't end the episode; an unstable simulation does.
Reset: maze, door and start are drawn anew; the robot stands there with a random heading and noise
on its joints.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.envs import body as body_lib
from eihrl_jax.envs import low_obs, raster, task
from eihrl_jax.mazes import maze as maze_lib
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import engines, kinematics
from eihrl_jax.robots import robot as robot_lib


class Body(struct.PyTreeNode):
    """The robot of an episode.

    Attributes:
      physics: its state.
      visited: bool [9], goals that the torso has been in.
      steps_left: int32, control steps left in the subgoal, k at its beginning.
      is_running: whether the episode goes on; else the robot rests.
      is_fallen: whether it lies on the ground now.
      has_fallen: whether it ever did in this episode.
      is_broken: whether its simulation has become unstable; it rests from then on.
    """

    physics: engine_lib.PhysicsState
    visited: Bool[Array, "9"]
    steps_left: Int[Array, ""]
    is_running: Bool[Array, ""]
    is_fallen: Bool[Array, ""]
    has_fallen: Bool[Array, ""]
    is_broken: Bool[Array, ""]


class Subgoal(struct.PyTreeNode):
    """What stays constant while a subgoal is followed.

    Attributes:
      maze: the episode's maze with its door open.
      nav: state of the task when the subgoal was given.
      start_xy: float32 [2], origin of the subgoal, units: where the torso was, or its anchor.
      direction: int32, the subgoal.
    """

    maze: maze_lib.Maze
    nav: task.Navigation
    start_xy: Float[Array, "2"]
    direction: Int[Array, ""]


class PhysicsMazeState(struct.PyTreeNode):
    """The state of an episode.

    Attributes:
      nav: state of the task.
      body: the robot.
      total_reward: float32, rewards of the episode so far.
    """

    nav: task.Navigation
    body: Body
    total_reward: Float[Array, ""]


EnvState: TypeAlias = base.EnvState[PhysicsMazeState, raster.Picture]


class PhysicsMaze:
    """One maze, or a different one in every episode, with a robot moved by its controls.

    Metrics, so far in the episode: `success` visited goals / goals, `decisions`, `return`, and 0 or
    1 for `fell` and `broke_down`.

    >>> import jax, eihrl_jax
    >>> robot, maze = eihrl_jax.load_robot("point"), eihrl_jax.load_maze("u")
    >>> env = eihrl_jax.PhysicsMaze.of_robot(robot, maze)
    >>> state = jax.jit(env.reset)(jax.random.key(0))
    >>> state.inner.body.physics.qpos.shape  # x and y, units
    (2,)
    """

    def __init__(
        self,
        engine: engine_lib.Engine,
        mazes: maze_lib.Maze,
        *,
        view: raster.View,
        anchored: bool = False,
        reward: base.Reward = "sparse",
    ):
        """Prepares the mazes.

        Args:
          engine: moves the robot.
          mazes: one maze, or several with a leading axis of which each episode draws one.
          view: extent and resolution of the observation.
          anchored: whether subgoals are measured from the middle of the robot's cell, see
            `task.anchor`.
          reward: "sparse" or "dense".

        Raises:
          base.UserError: an unknown reward.
        """
        checks.one_of("reward", reward, base.REWARDS)
        self.robot = engine.robot
        self.table = task.prepare(mazes, view.margin)
        self.view = view
        self._anchored = anchored
        self._reward: base.Reward = reward
        self._engine = engine
        self._jitter = float(self.table.mazes.start_jitter.max())
        # The silhouette is drawn from the real posture at every decision, not from a bank.
        self._capsules = kinematics.capsules(engine.model, engine.robot.units_per_metre)

    @classmethod
    def of_robot(
        cls,
        robot: robot_lib.Robot,
        mazes: maze_lib.Maze,
        *,
        view: raster.View = raster.View(),
        engine: base.EngineName = "mujoco",
        anchored: bool = False,
        reward: base.Reward = "sparse",
    ) -> "PhysicsMaze":
        """Builds the maze for a robot and an engine by name; see the constructor."""
        engine_of_robot = engines.make(robot, engine)
        return cls(engine_of_robot, mazes, view=view, anchored=anchored, reward=reward)

    def reset(
        self,
        key: Key[Array, ""],
        maze: Int[Array, ""] | None = None,
        place: task.Place | None = None,
    ) -> EnvState:
        """Draws a new episode, in a given maze and place or in any; the key is consumed."""
        next_key, start_key, pose_key = jax.random.split(key, 3)
        nav, xy = task.start(self.table, start_key, maze, place)

        no = jnp.zeros((), bool)
        body = Body(
            physics=body_lib.draw_start(
                self._engine, task.drawn_maze(self.table, nav), xy, pose_key, self._jitter
            ),
            visited=nav.visited,
            steps_left=jnp.int32(self.robot.steps_per_subgoal),
            is_running=~no,
            is_fallen=no,
            has_fallen=no,
            is_broken=no,
        )
        inner = PhysicsMazeState(nav=nav, body=body, total_reward=jnp.float32(0.0))
        return self._state(inner, base.Outcome.of_reset(), next_key)

    def begin(self, state: EnvState, direction: Int[Array, ""]) -> tuple[Subgoal, Body]:
        """Begins a decision; in an episode that is over the robot rests until its end."""
        inner = state.inner
        torso_xy = inner.body.physics.qpos[:2]
        subgoal = Subgoal(
            # The door is put into the maze once per decision, not in each of its k control steps.
            maze=task.drawn_maze(self.table, inner.nav),
            nav=inner.nav,
            # The low level observes its displacement from here: no training with anchors is needed.
            start_xy=task.anchor(torso_xy) if self._anchored else torso_xy,
            direction=direction,
        )

        steps_left = jnp.int32(self.robot.steps_per_subgoal)
        return subgoal, inner.body.replace(is_running=~state.is_over, steps_left=steps_left)

    def low_obs(self, subgoal: Subgoal, body: Body) -> low_obs.LowObs:
        """Returns the low level's observation, see `low_obs.observe`."""
        return low_obs.observe(
            body.physics, subgoal.start_xy, body.steps_left, subgoal.direction, self.robot
        )

    def control(self, subgoal: Subgoal, body: Body, ctrl: Float[Array, " nu"]) -> Body:
        """Advances one control step; `ctrl` in [-1, 1].

        The robot rests once the episode is over: with sparse reward after the last goal, and after
        its simulation has become unstable.
        """
        physics, is_broken = body_lib.move(
            self._engine, body.physics, ctrl, subgoal.maze, body.is_running
        )

        # Only for the visited goals: `end` counts the decision and computes its reward.
        nav = subgoal.nav.replace(visited=body.visited)
        nav, outcome = task.advance(self.table, nav, physics.qpos[None, :2], self._reward)
        is_fallen = body_lib.is_fallen(physics.qpos, self.robot)
        return Body(
            physics=physics,
            visited=nav.visited,
            steps_left=body.steps_left - 1,
            is_running=body.is_running & ~is_broken & ~outcome.terminated,
            is_fallen=is_fallen,
            has_fallen=body.has_fallen | is_fallen,
            is_broken=body.is_broken | is_broken,
        )

    def end(self, state: EnvState, body: Body, path_xy: Float[Array, "T 2"]) -> EnvState:
        """Ends a decision: counts it, computes its reward and updates the map.

        Args:
          state: before the decision.
          body: the robot after it.
          path_xy: torso positions after each control step, units.
        """
        nav, outcome = task.advance(self.table, state.inner.nav, path_xy, self._reward)
        outcome = outcome.terminated_if(body.is_broken)
        total_reward = state.inner.total_reward + outcome.reward
        inner = PhysicsMazeState(nav=nav, body=body, total_reward=total_reward)
        return self._state(inner, outcome, state.key)

    def _state(
        self, inner: PhysicsMazeState, outcome: base.Outcome, key: Key[Array, ""]
    ) -> EnvState:
        """Makes the state that `reset` and `end` return."""
        qpos = inner.body.physics.qpos
        # Look first, so that a map shows what is in sight now.
        inner = inner.replace(nav=task.look(self.table, inner.nav, qpos[:2], self.view))

        silhouette = raster.footprint(self._capsules(qpos), qpos[:2], self.view)
        packed = raster.pack(silhouette, self.view)
        metrics = {
            "success": task.success(self.table, inner.nav),
            "decisions": inner.nav.decisions,
            "return": inner.total_reward,
            "fell": inner.body.has_fallen,
            "broke_down": inner.body.is_broken,
        }
        return base.EnvState.of(
            inner=inner,
            obs=task.observe(self.table, inner.nav, qpos[:2], packed, self.view),
            outcome=outcome,
            metrics=metrics,
            key=key,
        )
