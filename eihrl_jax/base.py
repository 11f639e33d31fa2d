"""What every layer shares: the types in which environments and agents meet, the frame, errors.

Frame: the outer top-left corner of a maze is (0, 0), x points right along the columns, y points
up, so row `i` and column `j` of the text lie around ((j + 1/2) * CELL, -(i + 1/2) * CELL). Lengths
are in MuJoCo units, called units.
"""

import difflib
import pathlib
from collections.abc import Iterable, Mapping
from typing import Generic, Literal, Protocol, TypeAlias, TypeVar, get_args, runtime_checkable

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Key, PyTree

CELL = 3.0
"""Side of a maze cell, and the nominal length of one subgoal, in units (paper, Table 4)."""

SIGMA = 0.3
"""Standard deviation of oracle movement per axis, in units, where nothing else is asked for."""

NUM_DIRECTIONS = 4
"""Subgoals x+, x-, y+, y- (paper, Sec. 2), in this order everywhere."""

DIRECTIONS_XY = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Unit vector of each subgoal."""

PRETRAINED = pathlib.Path(__file__).parent / "pretrained"
"""Folder of what the package ships of trained robots and policies."""

Reward = Literal["sparse", "dense"]
"""Reward of a task: for reaching goals, or for nearness to the current one (paper, App. D)."""

REWARDS: tuple[Reward, ...] = get_args(Reward)

MovementName = Literal["oracle", "full"]
"""What moves the robot: "oracle": the simulator its torso; "full": physics and a low level."""

MOVEMENTS: tuple[MovementName, ...] = get_args(MovementName)

Knows = Literal["nothing", "goal", "map"]
"""What is on a high level's map at the start: nothing, the goals, or everything."""

EngineName = Literal["mujoco", "mjx"]
"""Physics: MuJoCo's C code on the processor, or MJX, which JAX compiles for an accelerator."""

ENGINES: tuple[EngineName, ...] = get_args(EngineName)

QUICK_COMPILE = {"xla_backend_optimization_level": 1}
"""Compiler options of programs that run rarely, such as resets.

They compile in about half the time, with the same results bit for bit (reset of the ant in U, one
core of an Intel Xeon: 3.9 instead of 8.3 s).
"""

TIME_UNIT = 1_000.0
"""Control steps in which the time of a `GoalObs` grows by one (HIGL's released code)."""


Params: TypeAlias = PyTree[Array]
"""Parameters of networks: nested dicts of arrays, or tuples of such dicts."""

# Of environments and what wraps them: their own pytree, and what they show.
InnerT = TypeVar("InnerT")
ObsT = TypeVar("ObsT")


class UserError(ValueError):
    """A user's mistake; its text is one line that names the thing, the value and the limit.

    The command line prints it without a traceback and exits with 2. Of a longer text, in which a
    value from a file stands, the middle is left out.
    """

    def __init__(self, message: object):
        """Takes the text, or another such error, as some libraries raise it again."""
        text = str(message)
        if len(text) > 1_000:
            text = f"{text[:700]} ... {text[-295:]}"
        super().__init__(text)


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Returns a suggestion for an unknown name, "" if no known one is similar.

    >>> did_you_mean("spirel", ["random", "spiral"])
    'did you mean spiral? '
    """
    near = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {near[0]}? " if near else ""


def printable(text: str) -> str:
    r"""Returns a text with unprintable characters as Python's escape sequences.

    Names of files may hold line ends, control codes, and bytes that aren't valid text.

    >>> print(printable("a\nb\x1b[2J"))
    a\nb\x1b[2J
    """
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


class Stopped(KeyboardInterrupt):
    """A job that the user has stopped with Ctrl-C; its text says what was kept."""


class Outcome(struct.PyTreeNode):
    """Reward and end flags of a step.

    Attributes:
      reward: float32, unitless.
      terminated: the episode ended for good; the return after it is 0.
      truncated: the episode was cut by its time limit; never true together with `terminated`.
    """

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]

    @classmethod
    def of_reset(cls) -> "Outcome":
        """Returns what an episode begins with: no reward, and no end."""
        # No constant of the module: importing must make no arrays.
        return cls(jnp.float32(0.0), jnp.zeros((), bool), jnp.zeros((), bool))

    @classmethod
    def of_step(
        cls, reward: Float[Array, ""], terminated: Bool[Array, ""], is_late: Bool[Array, ""]
    ) -> "Outcome":
        """Returns the outcome of a step; the time limit cuts what hasn't ended for good."""
        return cls(reward, terminated, is_late & ~terminated)

    def terminated_if(self, is_ended: Bool[Array, ""]) -> "Outcome":
        """Returns the outcome, but of an episode that has ended for good where `is_ended`."""
        # What has ended for good isn't cut as well: nothing may be bootstrapped from it.
        return self.replace(
            terminated=self.terminated | is_ended, truncated=self.truncated & ~is_ended
        )


class EnvState(struct.PyTreeNode, Generic[InnerT, ObsT]):
    """One environment at one moment, without batch axis; returned by `reset` and `step`.

    Attributes:
      inner: the environment's own pytree.
      obs: observation of this moment (after an auto-reset: of the new episode).
      final_obs: observation that the last action led to; differs from `obs` only right after an
        auto-reset, and is what a bootstrap at a time limit must use.
      reward: see `Outcome`, as are the next two.
      terminated: the episode ended for good.
      truncated: the episode was cut by its time limit.
      metrics: scalars with keys fixed at reset.
      key: random key of this environment.
    """

    inner: InnerT
    obs: ObsT
    final_obs: ObsT
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    metrics: dict[str, Float[Array, ""]]
    key: Key[Array, ""]

    @classmethod
    def of(
        cls,
        *,
        inner: InnerT,
        obs: ObsT,
        outcome: Outcome,
        metrics: Mapping[str, Array],
        key: Key[Array, ""],
    ) -> "EnvState[InnerT, ObsT]":
        """Puts together what `reset` and `step` return: nothing has begun anew yet.

        Args:
          inner: the environment's own pytree.
          obs: of this moment, to which the last action led.
          outcome: of the last action.
          metrics: scalars of any type; stored as float32.
          key: random key of this environment.
        """
        # `final_obs` parts from `obs` only where a wrapper begins a new episode.
        return cls(
            inner=inner,
            obs=obs,
            final_obs=obs,
            reward=outcome.reward,
            terminated=outcome.terminated,
            truncated=outcome.truncated,
            metrics={name: jnp.asarray(value, jnp.float32) for name, value in metrics.items()},
            key=key,
        )

    @property
    def is_over(self) -> Bool[Array, "*batch"]:
        """Whether the episode has ended, either way; of a batch, one entry each."""
        return self.terminated | self.truncated


# Checkable at runtime, as the tests' type checker asks of every protocol.
@runtime_checkable
class Environment(Protocol[InnerT, ObsT]):
    """The contract between environments and learners: pure functions of one environment.

    Batches are made by the caller with `jax.vmap`, so that every environment works alone, in a
    batch, and inside `jax.lax.scan`.
    """

    def reset(self, key: Key[Array, ""]) -> EnvState[InnerT, ObsT]:
        """Draws a new episode; the key is consumed."""
        ...

    def step(self, state: EnvState[InnerT, ObsT], action: Array) -> EnvState[InnerT, ObsT]:
        """Advances one step. Does not reset: see `envs.wrappers.AutoReset`."""
        ...


class GoalObs(struct.PyTreeNode):
    """Observation with the robot's own position and its goal. P: size of the proprioception.

    Attributes:
      xy: float32 [2], the torso's position, units.
      proprioception: float32 [P], qpos without x and y, then qvel; units, radians, per second.
      goal_xy: float32 [2], where the current goal is, units: the centre of its region, or of its
        nearest cell where it is in several parts; once all have been visited, `xy`, in line with
        the dense reward, which is then that of a robot at its goal.
      time: float32, control steps since the episode's start / `TIME_UNIT`.
    """

    xy: Float[Array, "2"]
    proprioception: Float[Array, " P"]
    goal_xy: Float[Array, "2"]
    time: Float[Array, ""]  # scaled, as networks take it as it is


class Transition(struct.PyTreeNode, Generic[ObsT]):
    """One step as learners store it.

    Attributes:
      obs: observation before the action, a pytree.
      action: the action taken.
      reward: scalar, unitless.
      discount: gamma * (1 - terminated); a time limit leaves it at gamma.
      next_obs: observation after the action, `final_obs` at an episode's end.
    """

    obs: ObsT
    action: Array  # of any shape and type: controls, or the index of a direction
    reward: Float[Array, ""]
    discount: Float[Array, ""]
    next_obs: ObsT
