"""Generated mazes for choosing options, so that no choice is made by results in test mazes."""

from collections.abc import Iterator

from eihrl_jax.mazes import generators, perfect

FIRST_SEED = 1_000
"""Lowest seed of these mazes; those of the perfect suites lie below."""

LOOPS = 0.15
"""Share of the inner cells that are opened where ways shall meet again."""

_SIDES = {"perfect": (13, 17, 25), "loops": (13, 17, 25), "rooms": (13, 21)}
"""Cells a side without the outer wall, by kind."""

_NUM = 6
"""Mazes of each kind and size."""


def texts() -> Iterator[tuple[str, str]]:
    """Draws the mazes, each with its name within the suite: kind, side and number."""
    for kind, sides in _SIDES.items():
        for side in sides:
            for number in range(_NUM):
                seed = FIRST_SEED + number
                if kind == "rooms":
                    text = generators.random_room(seed, side, side)
                else:
                    text = perfect.perfect_maze(seed, side, side, loops=LOOPS * (kind == "loops"))
                yield f"{kind}-{side}-{number}", text
