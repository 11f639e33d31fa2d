"""The protocols of all baselines, and a function that makes one from its options."""

from typing import Protocol, TypeVar, runtime_checkable

from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.baselines import flat
from eihrl_jax.baselines.hess import hess
from eihrl_jax.baselines.higl import higl
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as config_lib
from eihrl_jax.config import brax as brax_config
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import higl as higl_config

StateT = TypeVar("StateT")
CarryT = TypeVar("CarryT")


@runtime_checkable
class Actor(Protocol[StateT, CarryT]):
    """What acts, and the state of the run that trains it; functions without state of their own.

    `StateT` is all that a run needs to go on, `CarryT` what the policy remembers from one control
    step of an episode to the next.
    """

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together in a round of acting and learning."""
        ...

    def init(self, key: Key[Array, ""]) -> StateT:
        """Returns the initial state of a run."""
        ...

    def policy(self, state: StateT) -> dict[str, base.Params]:
        """Returns the parameters of the acting networks by name."""
        ...

    def start(self) -> CarryT:
        """Returns the carry at the beginning of an episode."""
        ...

    def act(
        self, policy: dict[str, base.Params], carry: CarryT, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], CarryT]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        ...


@runtime_checkable
class Baseline(Actor[StateT, CarryT], Protocol[StateT, CarryT]):
    """A learner of ours, whose rounds are a function that can be compiled."""

    def advance(self, state: StateT) -> tuple[StateT, dict[str, Float[Array, ""]]]:
        """Acts for a round and learns from it; returns metrics too.

        Metrics that begin with `sum_` are sums over the episodes that ended, `episodes` is their
        number, all others are means.
        """
        ...


@runtime_checkable
class RowLearner(Actor[StateT, CarryT], Protocol[StateT, CarryT]):
    """An external learner that runs by itself and is asked for its results row by row."""

    def begin(self, state: StateT, num_rows: int, log_rounds: int) -> None:
        """Prepares to train for some rows of metrics of so many rounds each."""
        ...

    def next_row(self, state: StateT) -> tuple[StateT, dict[str, Float[Array, ""]]]:
        """Trains for a row; returns the state after it, and metrics as `Baseline.advance`."""
        ...

    def close(self) -> None:
        """Ends training where it is; may be called at any time."""
        ...


def make(world: World, options: config_lib.BaselineConfig) -> Actor:
    """Builds the baseline of the method that its options are of.

    Raises:
      base.UserError: it is one of Brax's, which isn't installed.
    """
    if isinstance(options, config_lib.FlatConfig):
        return flat.FlatDroq(world, options)
    if isinstance(options, hess_config.HessConfig):
        return hess.Hess(world, options)
    if isinstance(options, brax_config.BraxConfig):
        return _brax_agent(world, options)
    # HRAC and HIRO are HIGL with other options, see `config.higl.GUIDANCE`.
    assert isinstance(options, higl_config.HiglConfig)
    return higl.Higl(world, options)


def _brax_agent(world: World, options: brax_config.BraxConfig) -> Actor:
    """Builds one of Brax's learners; Brax takes seconds to import, and may be missing."""
    try:
        from eihrl_jax.brax import agents
    except ImportError as error:
        if error.name not in ("brax", None):
            raise
        needs = f"method = {options.method!r} needs Brax: pip install 'eihrl_jax[brax]'"
        raise base.UserError(needs) from None
    return agents.BraxAgent(world, options)
