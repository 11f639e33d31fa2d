"""Levels from their folders, and the environments in which they are evaluated together."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float, Int, Key

from eihrl_jax import base, mazes
from eihrl_jax.agents import peg_a2c
from eihrl_jax.config import evaluate as evaluate_config
from eihrl_jax.envs import hierarchy, low_obs, oracle_maze, physics_maze, raster, subgoals
from eihrl_jax.evaluation import metas, rollouts
from eihrl_jax.networks import actor_critic, droq
from eihrl_jax.ops import planning
from eihrl_jax.physics import engine as engine_lib
from eihrl_jax.physics import posture, scene
from eihrl_jax.robots import robot as robot_lib
from eihrl_jax.runs import policies

STAND, NOBODY = "stand", "none"
"""Folder, beside a low level's, of the policy that stands the robot up; name for no such policy."""

Probabilities: TypeAlias = Callable[[raster.Picture], Float[Array, "4"]]
"""From a high level's observation to the probability of each direction."""


@dataclasses.dataclass(frozen=True)
class HighLevel:
    """A high level that is ready to act.

    Attributes:
      label: its name in tables.
      policy: from an observation and a key to a direction.
      probabilities: from an observation to the probability of each direction; a pytree like
        `policy`.
      view: what its observations showed in training.
      anchored: whether its subgoals were anchored in training, see `task.anchor`.
      takes_any_map: whether it also takes maps of other sizes than in training.
      is_certain: whether it is deterministic: one direction always has probability 1.
    """

    label: str
    policy: rollouts.HighPolicy
    probabilities: Probabilities
    view: raster.View
    anchored: bool = False
    takes_any_map: bool = False
    is_certain: bool = False

    def view_in(self, stacked: mazes.Maze) -> raster.View:
        """Returns its view in some mazes; a map of any size covers the largest of them."""
        rows, columns = stacked.wall.shape[-2:]
        return self.view.covering(rows, columns) if self.takes_any_map else self.view

    def anchors(self, robot: robot_lib.Robot) -> bool:
        """Returns whether a robot's subgoals are anchored: trained so, and followed so."""
        return self.anchored and robot.anchored


@dataclasses.dataclass(frozen=True)
class RecordableOracle:
    """Oracle movement that also returns a way: straight, in the posture that is shown at its end.

    Attributes:
      env: the environment.
      qpos: float32 [N, nq], the postures whose silhouettes it draws.
    """

    env: oracle_maze.OracleMaze
    qpos: Float[Array, "N nq"]

    def reset(
        self, key: Key[Array, ""], maze: Int[Array, ""] | None = None
    ) -> oracle_maze.EnvState:
        """Draws a new episode, in a given maze or in any; the key is consumed."""
        return self.env.reset(key, maze)

    def trace(
        self, state: oracle_maze.EnvState, action: Int[Array, ""]
    ) -> tuple[oracle_maze.EnvState, hierarchy.Trace]:
        """Follows a direction for one subgoal."""
        following = self.env.step(state, action)
        num = self.env.movement.num_substeps

        # The start is left out: it is where the decision before ended.
        share = jnp.linspace(0.0, 1.0, num + 1)[1:, None]
        way_xy = (1.0 - share) * state.inner.xy[None] + share * following.inner.xy[None]

        # One posture all the way, that of the picture at its end: the oracle has no gait.
        posture = self.qpos[following.inner.posture]
        return following, hierarchy.Trace(
            qpos=jnp.repeat(posture[None], num, axis=0).at[:, :2].set(way_xy),
            is_fallen=jnp.zeros(num, bool),
            is_running=jnp.repeat(~state.is_over, num),
        )


def load_high(
    name: str, *, greedy: bool | None = None, knows: base.Knows | None = None
) -> HighLevel:
    """Loads a high level.

    Args:
      name: run folder, policy folder or shipped name; "uniform" for uniform directions; "frontier"
        for the nearest cell that hasn't been seen; "shortest" for the shortest way to a goal.
      greedy: take the most likely direction instead of a sample; None: as its preset says.
      knows: what is on its map from the start; None: as in its training.

    Raises:
      base.UserError: there is none, it is damaged, or it has no map to show what it is to know.

    >>> high = load_high("best-random-0")
    >>> picture = jnp.zeros(high.view.obs_shape, bool)
    >>> direction = high.policy(picture, jax.random.key(0))  # an index of `base.DIRECTIONS_XY`
    """
    if name in evaluate_config.UNIFORM_NAMES:
        policy = jax.tree_util.Partial(_uniform_direction)
        probabilities = jax.tree_util.Partial(_uniform_probabilities)
        return HighLevel(evaluate_config.UNIFORM, policy, probabilities, raster.View())

    if name in (evaluate_config.FRONTIER, evaluate_config.SHORTEST):
        policy = jax.tree_util.Partial(_towards_the_unseen)
        probabilities = jax.tree_util.Partial(_probabilities_towards_the_unseen)
        # Five cells a side are in sight, as of preset `best`.
        known = "map" if name == evaluate_config.SHORTEST else knows or "nothing"
        view = raster.View(extent=15.0, pixels=25, map_radius=8, knows=known)
        return HighLevel(
            name, policy, probabilities, view, anchored=True, takes_any_map=True, is_certain=True
        )

    path = policies.find(name, "high")
    params, meta = policies.load(path, kind="high")

    # The folder says what to build; shapes are then compared, so that a damaged one is named.
    told = metas.read(meta, metas.High, path)
    movement = metas.read(meta.get("movement", {}), metas.Movement, path)
    view = told.view if knows is None else dataclasses.replace(told.view, knows=knows)
    network = actor_critic.make(told.network)
    metas.check_params(
        params, lambda: network.init(jax.random.key(0), jnp.zeros(view.obs_shape, bool)), path
    )

    # A pytree of the parameters: policies that differ in them alone share what is compiled.
    learned = _Learned(actor_critic.in_use(network), told.greedy if greedy is None else greedy)
    return HighLevel(
        name,
        jax.tree_util.Partial(learned, params),
        jax.tree_util.Partial(learned.probabilities, params),
        view,
        movement.anchored,
        takes_any_map=actor_critic.takes_any_map(network),
        is_certain=learned.greedy,
    )


@dataclasses.dataclass(frozen=True)
class _Learned:
    """Chooses as a network does; two are equal where their networks are, whatever the parameters.

    Attributes:
      network: the actor-critic.
      greedy: take the most likely direction instead of a sample.
    """

    network: nn.Module
    greedy: bool

    def __call__(
        self, params: base.Params, obs: raster.Picture, key: Key[Array, ""]
    ) -> Int[Array, ""]:
        if self.greedy:
            return peg_a2c.mode(self.network, params, obs)
        return peg_a2c.sample(self.network, params, obs, key)

    def probabilities(self, params: base.Params, obs: raster.Picture) -> Float[Array, "4"]:
        """Returns the probability with which each direction is chosen."""
        if self.greedy:
            return _certain(peg_a2c.mode(self.network, params, obs))
        logits, _ = self.network.apply(params, obs)
        return jax.nn.softmax(logits)


def load_low(name: str, robot: robot_lib.Robot, *, stand: str | None = None) -> hierarchy.LowPolicy:
    """Loads a robot's low level; it acts deterministically.

    Args:
      name: run folder, policy folder or shipped name.
      robot: whose it must be.
      stand: the low level that takes over while the robot is down, like `name`; "none" for nobody;
        None: the one in the folder `stand` beside it, if there is one.

    Raises:
      base.UserError: there is none, it is damaged, or another robot's, or one of another version.

    >>> from eihrl_jax import robots
    >>> policy = load_low("point", robots.load("point"))  # from a `LowObs` and a key to controls
    """
    path = policies.find(name, "low")
    walk = _one_low(path, robot)
    beside = path.parent / STAND
    if stand is None and beside.is_dir():
        stand = str(beside)
    if stand is None or stand == NOBODY:
        return walk

    height = posture.standing_height(scene.build(robot))
    return hierarchy.getting_up(walk, _one_low(policies.find(stand, "low"), robot), robot, height)


def _one_low(path: pathlib.Path, robot: robot_lib.Robot) -> hierarchy.LowPolicy:
    """Returns the policy in a folder."""
    params, meta = policies.load(path, kind="low", robot=robot.name)

    # Policies from before there were fingerprints don't say.
    told = metas.read(meta, metas.Low, path)
    model, full_range = scene.build(robot), told.low_input.full_range
    fingerprint = scene.fingerprint(model, robot, full_range=full_range)
    if told.fingerprint not in (None, fingerprint):
        raise base.UserError(
            f"{path} is a policy of another version of robot {robot.name!r}: its model or its "
            "times have changed since; train it again"
        )

    # As above: first what the folder says, then whether its parameters fit that.
    options = told.low_input
    actor = droq.Actor(told.num_actions, told.hidden)
    features = jnp.zeros((1, told.num_features))
    metas.check_params(params, lambda: actor.init(jax.random.key(0), features)["params"], path)

    def policy(obs: low_obs.LowObs, key: Key[Array, ""]) -> Float[Array, " nu"]:
        del key  # The mean of the actor acts, without noise.
        mean, _ = actor.apply({"params": params}, low_obs.features(obs, robot, options))
        return low_obs.ctrl_from_action(jnp.tanh(mean), obs, robot, options)

    return policy


def oracle_env(
    robot: robot_lib.Robot,
    stacked: mazes.Maze,
    view: raster.View,
    *,
    gait: subgoals.Gait,
    anchored: bool = False,
    reward: base.Reward = "sparse",
) -> RecordableOracle:
    """Returns oracle movement in several mazes.

    Args:
      robot: whose postures are shown and whose radius stops at walls.
      stacked: mazes with a leading axis.
      view: what the high level sees.
      gait: what the oracle imitates.
      anchored: whether subgoals count from the middle of the robot's cell.
      reward: "sparse" or "dense".

    Raises:
      base.UserError: a number is out of its limits.
    """
    env = oracle_maze.OracleMaze.of_robot(
        robot, stacked, view=view, gait=gait, anchored=anchored, reward=reward
    )
    return RecordableOracle(env, gait.bank.qpos)


def full_env(
    engine: engine_lib.Engine,
    stacked: mazes.Maze,
    view: raster.View,
    low_policy: hierarchy.LowPolicy,
    *,
    anchored: bool = False,
    reward: base.Reward = "sparse",
) -> hierarchy.Hierarchy:
    """Returns the full hierarchy in several mazes: a robot with physics and its low level.

    Args:
      engine: of the robot.
      stacked: the mazes.
      view: of the high level.
      low_policy: the low level.
      anchored: whether subgoals are anchored, see `task.anchor`.
      reward: "sparse" or "dense".
    """
    env = physics_maze.PhysicsMaze(engine, stacked, view=view, anchored=anchored, reward=reward)
    return hierarchy.Hierarchy(env, low_policy)


def _uniform_direction(obs: raster.Picture | None, key: Key[Array, ""]) -> Int[Array, ""]:
    """Chooses any direction, whatever it sees (the paper's RAND-H)."""
    del obs
    return jax.random.randint(key, (), 0, base.NUM_DIRECTIONS)


def _uniform_probabilities(obs: raster.Picture) -> Float[Array, "4"]:
    """Returns the same probability for every direction, whatever it sees."""
    del obs
    return jnp.full(base.NUM_DIRECTIONS, 1.0 / base.NUM_DIRECTIONS)


def _probabilities_towards_the_unseen(obs: raster.Picture) -> Float[Array, "4"]:
    """Returns the probabilities of `_towards_the_unseen`, which is deterministic."""
    return _certain(_towards_the_unseen(obs, jax.random.key(0)))


def _certain(direction: Int[Array, ""]) -> Float[Array, "4"]:
    """Returns probability 1 for one direction, 0 for the others."""
    return jax.nn.one_hot(direction, base.NUM_DIRECTIONS)


def _towards_the_unseen(obs: raster.Picture, key: Key[Array, ""]) -> Int[Array, ""]:
    """Heads for the nearest goal in view, or else for the nearest cell that hasn't been seen.

    Source: frontier-based exploration (Yamauchi 1997).
    """
    del key
    wall, goal, robot, unseen = (obs[..., channel] for channel in range(4))
    worth = jnp.where(unseen, 0.0, planning.NOWHERE)
    worth = jnp.where(goal, planning.GOAL, worth)
    ways = planning.search(worth, ~wall, robot)
    return jnp.argmax(ways.value).astype(jnp.int32)
