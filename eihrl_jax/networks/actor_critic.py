"""Builds the high level's network from its options."""

import flax.linen as nn

from eihrl_jax.config import high
from eihrl_jax.networks import patch_actor_critic, search


def make(options: high.Network) -> nn.Module:
    """Builds the network, which maps what the high level sees to logits and a value."""
    if options.kind == "search":
        return search.SearchActorCritic(
            options.num_iterations,
            options.look_ahead,
            options.cell_features,
            options.value_features,
            options.around,
        )
    return patch_actor_critic.PatchActorCritic(options.tile, options.tile_features, options.hidden)


def takes_any_map(network: nn.Module) -> bool:
    """Returns whether the network takes a map of any size, not only of the one in training."""
    return isinstance(network, search.SearchActorCritic)


def in_use(network: nn.Module) -> nn.Module:
    """Returns the network without the limits that only training needs.

    Training has a small map, on which ways are short; elsewhere they may be as long as they are.
    """
    if isinstance(network, search.SearchActorCritic):
        return network.clone(num_moves=None)
    return network
