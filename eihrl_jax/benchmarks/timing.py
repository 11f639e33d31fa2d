"""Times that `experiments.benchmark` compares, taken in turns: other work only lengthens them."""

import math
import time
from collections.abc import Callable
from typing import Any

import jax


def shortest(
    functions: dict[str, Callable[[], Any]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Returns the shortest times of functions called in turns, compilation left out; s.

    Args:
      functions: what is timed, by name; what they return is waited for.
      repeats: measurements of each.
      clock: seconds, of the wall or of the process.
    """
    jax.block_until_ready([function() for function in functions.values()])
    times = dict.fromkeys(functions, math.inf)
    for _ in range(repeats):
        for name, function in functions.items():
            begin = clock()
            jax.block_until_ready(function())
            times[name] = min(times[name], clock() - begin)
    return times
