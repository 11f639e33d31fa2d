"""Times that `experiments.benchmark` compares, taken in turns: other work only lengthens them."""

import time
from collections.abc import Callable, Iterator
from typing import TypeVar

import jax
from jaxtyping import PyTree

StateT = TypeVar("StateT")
InputT = TypeVar("InputT")


def shortest(
    functions: dict[str, Callable[[], PyTree]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Returns the shortest of the times of `in_turns`."""
    return {name: min(times) for name, times in in_turns(functions, repeats, clock).items()}


def in_turns(
    functions: dict[str, Callable[[], PyTree]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Returns the times of functions called in turns, compilation left out; s.

    Args:
      functions: what is timed, by name; what they return is waited for.
      repeats: measurements of each.
      clock: seconds, of the wall or of the process.
    """
    # The first calls compile.
    jax.block_until_ready([function() for function in functions.values()])

    # In turns, so that a slow spell of the machine meets all of them.
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            begin = clock()
            jax.block_until_ready(function())
            times[name].append(clock() - begin)
    return times


def successive(
    function: Callable[[StateT], StateT], state: StateT, repeats: int
) -> Iterator[tuple[StateT, float]]:
    """Calls a compiled function with what it returned last; yields that and the call's seconds.

    The first call warms up. The function may consume its argument: read what is needed of a state
    before asking for the next one.
    """
    for _ in range(repeats):
        begin = time.perf_counter()
        state = jax.block_until_ready(function(state))
        yield state, time.perf_counter() - begin


def rolled(
    step: Callable[[StateT, InputT], StateT], state: StateT, inputs: InputT
) -> Callable[[], StateT]:
    """Returns a function that steps a state through inputs [T, ...] in one compiled program."""
    # Inputs are arguments: as constants of the program XLA could compute with them at compile time.
    roll = jax.jit(
        lambda state, inputs: jax.lax.scan(lambda s, x: (step(s, x), None), state, inputs)[0]
    )
    return lambda: roll(state, inputs)
