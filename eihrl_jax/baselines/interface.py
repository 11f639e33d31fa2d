"""What all baselines are to those who train and use them, and how one is made from its options."""

from typing import Protocol, TypeVar, runtime_checkable

from jaxtyping import Array, Float, Key

from eihrl_jax import base
from eihrl_jax.baselines import flat
from eihrl_jax.baselines.hess import hess
from eihrl_jax.baselines.higl import higl
from eihrl_jax.baselines.world import World
from eihrl_jax.config import baselines as config_lib
from eihrl_jax.config import hess as hess_config
from eihrl_jax.config import higl as higl_config

StateT = TypeVar("StateT")
CarryT = TypeVar("CarryT")


@runtime_checkable
class Baseline(Protocol[StateT, CarryT]):
    """The functions of a run, which hold no state.

    `StateT` is all that a run needs to go on, `CarryT` what the policy remembers from one control
    step of an episode to the next.
    """

    @property
    def steps_per_round(self) -> int:
        """Control steps of all environments together that `advance` takes."""
        ...

    def init(self, key: Key[Array, ""]) -> StateT:
        """Returns the state of a run that is about to start."""
        ...

    def advance(self, state: StateT) -> tuple[StateT, dict[str, Float[Array, ""]]]:
        """Acts for a round and learns from it; returns metrics too.

        Metrics that begin with `sum_` are sums over the episodes that ended, `episodes` is their
        number, all others are means.
        """
        ...

    def policy(self, state: StateT) -> dict[str, base.Params]:
        """Returns what acts: the parameters of networks by name."""
        ...

    def start(self) -> CarryT:
        """Returns the carry at the beginning of an episode."""
        ...

    def act(
        self, policy: dict[str, base.Params], carry: CarryT, obs: base.GoalObs
    ) -> tuple[Float[Array, " nu"], CarryT]:
        """Returns controls in [-1, 1] without exploration, and the carry of the next step."""
        ...


def make(world: World, options: config_lib.BaselineConfig) -> Baseline:
    """Builds the baseline of the method that its options are of."""
    if isinstance(options, config_lib.FlatConfig):
        return flat.FlatDroq(world, options)
    if isinstance(options, hess_config.HessConfig):
        return hess.Hess(world, options)
    # HRAC and HIRO are HIGL with other options, see `config.higl.GUIDANCE`.
    assert isinstance(options, higl_config.HiglConfig)
    return higl.Higl(world, options)
