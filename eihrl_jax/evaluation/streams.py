"""Random keys of evaluated episodes, which don't depend on what else is evaluated."""

import zlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key, UInt32


def streams(
    rows: Int[np.ndarray, "E 3"], names: list[str]
) -> tuple[Key[Array, " E"], Key[Array, " E"]]:
    """Returns each episode's keys for its environment and for its high level.

    The maze enters by its name, so that it does not matter which others are evaluated.

    Args:
      rows: seed, maze and number of each episode.
      names: of the mazes.
    """
    # CRC32, since Python's own hash of a text differs from process to process.
    hashes = np.array(
        [zlib.crc32(name.encode("utf-8", "backslashreplace")) for name in names], np.uint32
    )

    def stream(
        seed: UInt32[Array, ""], maze: UInt32[Array, ""], episode: UInt32[Array, ""]
    ) -> Key[Array, "2"]:
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), maze), episode)
        return jax.random.split(key)

    columns = (rows[:, 0], hashes[rows[:, 1]], rows[:, 2])
    keys = jax.vmap(stream)(*(jnp.asarray(column, jnp.uint32) for column in columns))
    return keys[:, 0], keys[:, 1]
