"""Checks for `__post_init__` of the configs: each names the option, its value and the limit."""

import math
from collections.abc import Collection, Sequence

from eihrl_jax import base


def in_range(
    name: str,
    value: float,
    low: float | None = None,
    high: float | None = None,
    *,
    above: float | None = None,
    below: float | None = None,
) -> None:
    """Checks that a number is finite and inside its limits.

    Args:
      name: the option as it is called in the config.
      value: its value.
      low: smallest value allowed.
      high: greatest value allowed.
      above: open limit: the value must be greater.
      below: open limit: the value must be smaller.

    Raises:
      UserError: the value is outside.

    >>> in_range("gamma", 0.97, 0.0, 1.0)
    >>> in_range("gamma", 1.5, 0.0, 1.0)
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: gamma = 1.5 must be at least 0.0 and at most 1.0
    """
    # In the order and the words of the message.
    limits = {"at least": low, "at most": high, "greater than": above, "smaller than": below}
    # Asked for first: where there is no limit, infinity and NaN would pass.
    is_inside = (
        (isinstance(value, int) or math.isfinite(value))  # nan compares with nothing
        and (low is None or value >= low)
        and (high is None or value <= high)
        and (above is None or value > above)
        and (below is None or value < below)
    )

    if not is_inside:
        wanted = [f"{word} {limit}" for word, limit in limits.items() if limit is not None]
        raise base.UserError(f"{name} = {value} must be {' and '.join(wanted) or 'finite'}")


def one_of(name: str, value: str, choices: Collection[str]) -> None:
    """Checks that a word is one of the known ones.

    Raises:
      UserError: it isn't.

    >>> one_of("reward", "sparse", ("sparse", "dense"))
    >>> one_of("reward", "fat", ("sparse", "dense"))
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: reward = 'fat' must be one of sparse, dense
    """
    if value not in choices:
        raise base.UserError(f"{name} = {value!r} must be one of {', '.join(choices)}")


def distinct(name: str, values: Sequence[object]) -> None:
    """Checks that a list holds something, and nothing twice.

    Raises:
      UserError: it doesn't.

    >>> distinct("mazes", ("u", "s", "u"))
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: mazes names 'u' more than once
    """
    if not values:
        raise base.UserError(f"{name} is empty; give at least one")
    repeated = [value for i, value in enumerate(values) if value in values[:i]]
    if repeated:
        raise base.UserError(f"{name} names {repeated[0]!r} more than once")


def each_of(name: str, values: Sequence[str], choices: Collection[str]) -> None:
    """Checks that a list holds known words, at least one, none twice.

    Raises:
      UserError: it doesn't.
    """
    distinct(name, values)
    for value in values:
        one_of(name, value, choices)


def divides(name: str, value: int, other_name: str, other: int) -> None:
    """Checks that `other` is a whole multiple of `value`.

    Raises:
      UserError: it isn't.

    >>> divides("num_minibatches", 3, "num_envs", 64)
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: num_minibatches = 3 must divide num_envs = 64
    """
    if value <= 0 or other % value:  # by zero `%` would raise an error of its own
        raise base.UserError(f"{name} = {value} must divide {other_name} = {other}")


def measured_alone(measured: object, step: float, sigma: float) -> None:
    """Checks that step and sigma of oracle movement aren't asked for beside a measurement of them.

    Raises:
      UserError: they are.
    """
    # A default counts as not asked for: a config can't tell the two apart.
    if measured is not None and (step, sigma) != (base.CELL, base.SIGMA):
        raise base.UserError(
            f"step = {step} and sigma = {sigma} can't be set together with measured = {measured}"
        )
