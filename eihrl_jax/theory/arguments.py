"""The theory's arguments, checked against the annotations of a function; messages name them.

    @arguments.checked
    def bound(total_variation: Shares, k: Counts, gamma: Discounts) -> Floats:
        return total_variation / (1.0 - gamma**k)

Numbers, lists and arrays reach the formula as NumPy arrays, real ones in float64.
"""

import functools
import inspect
import operator
import typing
from collections.abc import Callable
from typing import Annotated, Any, Literal, ParamSpec, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from eihrl_jax.config import checks
from eihrl_jax.config.limits import Range

Inputs = ParamSpec("Inputs")
ResultT = TypeVar("ResultT")

Floats: TypeAlias = Float[np.ndarray, "..."] | float
"""Numbers in float64, or arrays of them, which broadcast."""

Integers: TypeAlias = Int[np.ndarray, "..."] | int

Shares = Annotated[Floats, Range(0.0, 1.0)]
L1Norms = Annotated[Floats, Range(0.0, 2.0)]
Discounts = Annotated[Floats, Range(0.0, below=1.0)]
NonNegatives = Annotated[Floats, Range(0.0)]
Positives = Annotated[Floats, Range(above=0.0)]
Counts = Annotated[Integers, Range(1.0)]

# What isn't an array: the name stands for one number.
Share = Annotated[float, Range(0.0, 1.0)]
Discount = Annotated[float, Range(0.0, below=1.0)]
Real = Annotated[float, Range()]
Positive = Annotated[float, Range(above=0.0)]
Correlation = Annotated[float, Range(above=-1.0, below=1.0)]
Count = Annotated[int, Range(1)]


def checked(function: Callable[Inputs, ResultT]) -> Callable[Inputs, ResultT]:
    """Makes a function convert its arguments, and check them, as their annotations say.

    What may be None, or has no limits, is passed on as it is.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Inputs.args, **kwargs: Inputs.kwargs) -> ResultT:
        # Defaults are left out: they are inside their limits.
        given = signature.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            hint = signature.parameters[name].annotation
            given.arguments[name] = _converted(name, value, hint)
        return function(*given.args, **given.kwargs)

    return call


def real(name: str, value: object, inside: Range) -> Float[np.ndarray, "..."]:
    """Returns numbers in float64 after checking that they are finite and inside their limits.

    Args:
      name: of the argument.
      value: number, list or array.
      inside: the limits.

    Raises:
      TypeError: they aren't real numbers.
      ValueError: one is outside.

    >>> real("gamma", 1.5, Range(0.0, below=1.0))
    Traceback (most recent call last):
    ...
    eihrl_jax.base.UserError: gamma = 1.5 must be at least 0.0 and smaller than 1.0
    """
    # Kinds of NumPy: floating, integer, unsigned, boolean; not complex, not text.
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "fiub":
        raise TypeError(f"{name} = {value!r} must be a real number or an array of them")
    numbers = numbers.astype(np.float64)  # from here on in full precision, whatever was given
    _check(name, numbers, inside)
    return numbers


def count(name: str, value: object, inside: Range) -> Int[np.ndarray, "..."]:
    """Returns integers after checking that they are inside their limits, see `real`.

    >>> count("k", 2.5, Range(1.0))
    Traceback (most recent call last):
    ...
    TypeError: k = 2.5 must be an integer or an array of integers
    """
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "iu":
        raise TypeError(f"{name} = {value!r} must be an integer or an array of integers")
    _check(name, numbers.astype(np.float64), inside)
    return numbers


def scalar(name: str, value: object, inside: Range) -> float:
    """Returns one number in float64 after checking it, see `real`."""
    return float(real(name, value, inside))


def scalar_count(name: str, value: Any, inside: Range) -> int:
    """Returns one integer after checking that it is one and inside its limits, see `real`."""
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} = {value!r} must be an integer") from None
    if isinstance(value, bool):  # to `operator.index` True is 1
        raise TypeError(f"{name} = {value!r} must be an integer")
    inside.check(name, number)
    return number


_CONVERT = {Floats: real, Integers: count, float: scalar, int: scalar_count}
"""What turns a name, a value and its limits into the checked value, by the annotated type."""


def _converted(name: str, value: Any, hint: Any) -> Any:
    """Converts a value to its type hint, which for an optional argument is a union."""
    if typing.get_origin(hint) is Literal:
        checks.one_of(name, value, typing.get_args(hint))
    if value is None and type(None) in typing.get_args(hint):
        return None
    for kind in (hint, *typing.get_args(hint)):
        if typing.get_origin(kind) is Annotated:
            wanted, inside = typing.get_args(kind)
            return _CONVERT[wanted](name, value, inside)
    return value


def _check(name: str, numbers: Float[np.ndarray, "..."], inside: Range) -> None:
    """Checks the extremes, which stand for all: limits are intervals, and a nan is both."""
    if numbers.size:  # an empty array has no extremes
        inside.check(name, numbers.min())
        inside.check(name, numbers.max())


def probabilities(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> np.ndarray:
    """Returns an array whose last axis holds probabilities, in float64 and summing to 1 exactly.

    Args:
      name: of the argument.
      value: numbers, with any number of leading axes before those of `shape`.
      shape: sizes of the last axes, None for any.

    Raises:
      ValueError: another shape, something negative, or rows that don't sum to 1 within 1e-6.
    """
    array = table(name, value, shape)
    if (array < 0.0).any():
        raise ValueError(f"{name} = {array.min()} must be at least 0: it holds probabilities")

    sums = array.sum(-1, keepdims=True)
    error = np.abs(sums - 1.0)
    if not (error <= 1e-6).all():
        worst = sums.flat[error.argmax()]
        raise ValueError(f"{name}: a row sums to {worst}, and must sum to 1 within 1e-6")
    # Exactly 1, so that values are those of a proper policy and not of one that leaks.
    return array / sums


def transition(value: ArrayLike) -> np.ndarray:
    """Returns the transition probabilities [..., S, A, S] of MDPs, see `probabilities`.

    Raises:
      ValueError: another shape, or rows that aren't probabilities.
    """
    array = probabilities("transition", value, (None, None, None))
    if array.shape[-1] != array.shape[-3]:
        raise ValueError(
            f"transition has shape {array.shape}, expected (..., S, A, S) with equal S"
        )
    return array


def table(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> np.ndarray:
    """Returns finite float64 numbers whose last axes have the sizes `shape`, None for any.

    Raises:
      ValueError: another shape, or something that isn't finite.
    """
    array = np.asarray(value, np.float64)
    last = array.shape[max(array.ndim - len(shape), 0) :]
    fits = len(last) == len(shape) and all(
        wanted is None or wanted == size for wanted, size in zip(shape, last, strict=True)
    )

    if not fits:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name} has shape {array.shape}, expected (..., {wanted})")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds {array[~np.isfinite(array)].flat[0]}, must be finite")
    return array
