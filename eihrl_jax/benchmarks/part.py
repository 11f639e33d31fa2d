"""A part of the benchmark: what it measures, and how it tells that."""

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
      measure: takes the measurement; what it returns can be written as JSON.
      rows: tells what `measure` returned, also after it was read from a file.
      options: of the benchmark that `measure` takes by name.
    """

    measure: Callable[..., FiguresT]
    rows: Callable[[FiguresT], Rows]
    options: tuple[str, ...] = ()
