"""Environments as pure functions of one environment; batches are made with `jax.vmap`."""
