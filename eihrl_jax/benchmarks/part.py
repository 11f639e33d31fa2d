"""A part of the benchmark: its measurement, and its rows of the table."""

import dataclasses
from collections.abc import Callable
from typing import Generic, TypeVar

FiguresT = TypeVar("FiguresT")

Figures = dict[str, float]
"""Numbers by name, as they stand in benchmark.json."""

Rows = dict[str, str]
"""The lines of benchmark.md: what was measured, and the result in words."""


@dataclasses.dataclass(frozen=True)
class Part(Generic[FiguresT]):
    """Something that is measured.

    Attributes:
      measure: takes the measurement, and returns JSON values.
      rows: turns those into rows of the table, also after they were read from a file.
      options: of the benchmark that `measure` takes by name.
    """

    measure: Callable[..., FiguresT]
    rows: Callable[[FiguresT], Rows]
    options: tuple[str, ...] = ()
