"""Limits that stand beside the fields of a config, and the one check of all of them.

    @limits.dataclass
    class Learner:
        gamma: limits.Fraction = 0.99
        window: Annotated[int, limits.Range(1, 10_000)] | None = None

Only what relates several fields is left to a class's own `__post_init__`.
"""

import dataclasses
import functools
import types
import typing
from collections.abc import Collection, Sequence
from typing import Annotated, Any, Literal, TypeVar

from eihrl_jax.config import checks

ConfigT = TypeVar("ConfigT")
ItemT = TypeVar("ItemT")


@dataclasses.dataclass(frozen=True)
class Range:
    """A finite number inside limits, see `checks.in_range`.

    Attributes:
      low: smallest value allowed.
      high: greatest value allowed.
      above: open limit: the value must be greater.
      below: open limit: the value must be smaller.
    """

    low: float | None = None
    high: float | None = None
    above: float | None = dataclasses.field(default=None, kw_only=True)
    below: float | None = dataclasses.field(default=None, kw_only=True)

    def check(self, name: str, value: float) -> None:
        """Raises a `UserError` that names the option if `value` is outside."""
        checks.in_range(name, value, self.low, self.high, above=self.above, below=self.below)


@dataclasses.dataclass(frozen=True, eq=False)  # An annotation must have a hash; tables have none.
class OneOf:
    """A word that is looked up in a table; known words alone are better a `Literal`.

    Attributes:
      choices: the words.
    """

    choices: Collection[str]

    def check(self, name: str, value: str) -> None:
        """Raises a `UserError` that names the option if `value` is another word."""
        checks.one_of(name, value, self.choices)


@dataclasses.dataclass(frozen=True)
class Distinct:
    """A list that holds something, and nothing twice."""

    def check(self, name: str, value: Sequence[object]) -> None:
        """Raises a `UserError` that names the option if the list is empty or repeats itself."""
        checks.distinct(name, value)


Several = Annotated[tuple[ItemT, ...], Distinct()]
"""At least one of a kind, none twice: `Several[str]`."""

Seed = Annotated[int, Range(0, 2**32 - 1)]
"""Of random numbers: 32 bits, as JAX's keys and NumPy's generators take them."""

Seeds = Several[Seed]

Count = Annotated[int, Range(1, 2**31 - 1)]
"""How many of something there are, in 32 bits, as JAX counts."""

CountFromZero = Annotated[int, Range(0, 2**31 - 1)]

MAX_DECISIONS = 10_000_000
"""Longest time limit of an episode, in subgoals: four times the ways of the largest mazes fit."""

Decisions = Annotated[int, Range(1, MAX_DECISIONS)]

UpToMillion = Annotated[int, Range(1, 1_000_000)]

Fraction = Annotated[float, Range(0.0, 1.0)]
"""A share, a probability, or a discount."""

Rate = Annotated[float, Range(high=1.0, above=0.0)]
"""Of learning, or of a moving average."""

Positive = Annotated[float, Range(above=0.0)]

NonNegative = Annotated[float, Range(0.0)]

BatchSize = Annotated[int, Range(1, 2**20)]

Widths = tuple[Annotated[int, Range(1, 4096)], ...]
"""Of the hidden layers of a network, of which there may be none."""


@typing.dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(dataclasses.field,)
)
def dataclass(config_type: type[ConfigT]) -> type[ConfigT]:
    """Makes a class a frozen dataclass with keyword-only fields, which are checked when it is made.

    The class's own `__post_init__` runs after the check.

    >>> @dataclass
    ... class Learner:
    ...     gamma: Fraction = 0.99
    >>> Learner(gamma=1.5)
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: gamma = 1.5 must be at least 0.0 and at most 1.0
    """
    check_together = getattr(config_type, "__post_init__", None)

    def check_all(self: object) -> None:
        check(self)  # first, so that relations are between values inside their own limits
        if check_together is not None:
            check_together(self)

    # Set before the class becomes a dataclass, whose `__init__` looks for it then.
    config_type.__post_init__ = check_all  # pyright: ignore[reportAttributeAccessIssue]
    return dataclasses.dataclass(frozen=True, kw_only=True)(config_type)


def check(config: object, prefix: str = "") -> None:
    """Checks every field of a dataclass against its annotation.

    Configs inside it have checked themselves.

    Args:
      config: the dataclass.
      prefix: what precedes the fields' names in messages.

    Raises:
      UserError: a field is outside of its limits.
    """
    for name, annotation in _annotations(type(config)):
        _check_value(prefix + name, getattr(config, name), annotation)


@functools.cache
def _annotations(config_type: type) -> tuple[tuple[str, Any], ...]:
    """Lists the names of fields and their annotations, with all that `Annotated` adds."""
    hints = typing.get_type_hints(config_type, include_extras=True)  # inherited ones, too
    return tuple((field.name, hints[field.name]) for field in dataclasses.fields(config_type))


def _check_value(name: str, value: Any, annotation: Any) -> None:
    """Checks a value, or the elements of a tuple; types are left to whoever made the value."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        # `Annotated` may carry what other libraries read; that is passed over.
        inner, *markers = arguments
        for marker in markers:
            if isinstance(marker, Range | OneOf | Distinct):
                marker.check(name, value)
        _check_value(name, value, inner)
    elif origin is Literal:
        checks.one_of(name, value, arguments)
    elif origin is tuple:
        # `tuple[int, ...]` has one kind for all elements.
        kinds = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        for item, kind in zip(value, kinds, strict=True):
            _check_value(name, item, kind)
    elif origin in (typing.Union, types.UnionType) and value is not None:
        # An option that may be left out, else of one kind; None itself has no limits.
        for kind in arguments:
            _check_value(name, value, kind)
