"""Checks of the theory's arguments, numbers or arrays; each names argument, value and limit.

What JAX traces has no value yet and is not checked.
"""

import operator
from types import ModuleType
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.scipy import special as jax_special
from scipy import special as scipy_special

Numbers = Any
"""Numbers or arrays that broadcast: NumPy's are computed in float64, JAX's in their own type."""

REAL_TYPES = (jnp.floating, jnp.integer, jnp.bool_)


def namespace(*values: Any) -> ModuleType:
    """Returns `jax.numpy` if anything is JAX's, else `numpy`."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np


def special(*values: Any) -> Any:
    """Returns the special functions that go with `namespace`."""
    return jax_special if namespace(*values) is jnp else scipy_special


def real(
    name: str, value: Any, low: float = 0.0, high: float = np.inf, *, below: float = np.inf
) -> Any:
    """Returns numbers as floats after checking that they are finite and inside their limits.

    Args:
      name: of the argument.
      value: number or array.
      low: smallest allowed.
      high: greatest allowed.
      below: open limit.

    Raises:
      TypeError: they aren't real numbers.
      ValueError: one is outside.

    >>> real("gamma", 1.5, below=1.0)
    Traceback (most recent call last):
    ...
    ValueError: gamma = 1.5 must be at least 0.0 and smaller than 1.0
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        numbers: Any = float(value)  # stays weakly typed beside JAX's arrays
    elif isinstance(value, jax.Array):
        if not any(jnp.issubdtype(value.dtype, kind) for kind in REAL_TYPES):
            raise TypeError(f"{name} = {value!r} must be a real number or an array of them")
        numbers = value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)
    else:
        numbers = np.asarray(value)
        if not np.isrealobj(numbers) or numbers.dtype.kind not in "fiub":
            raise TypeError(f"{name} = {value!r} must be a real number or an array of them")
        numbers = numbers.astype(np.float64)
    if isinstance(numbers, jax.core.Tracer):
        return numbers
    found = np.asarray(numbers)
    is_inside = np.isfinite(found) & (found >= low) & (found <= high) & (found < below)
    if not is_inside.all():
        wanted = [f"at least {low}"] if np.isfinite(low) else ["finite"]
        wanted += [f"at most {high}"] if np.isfinite(high) else []
        wanted += [f"smaller than {below}"] if np.isfinite(below) else []
        worst = found[~is_inside].flat[0]
        raise ValueError(f"{name} = {worst} must be {' and '.join(wanted)}")
    return numbers


def positive(name: str, value: Any) -> Any:
    """Returns numbers as floats after checking that they are finite and greater than 0.

    Raises:
      TypeError: they aren't real numbers.
      ValueError: one isn't positive.
    """
    numbers = real(name, value, -np.inf)
    if not isinstance(numbers, jax.core.Tracer) and not (np.asarray(numbers) > 0.0).all():
        raise ValueError(f"{name} = {np.asarray(numbers).min()} must be greater than 0")
    return numbers


def count(name: str, value: Any) -> Any:
    """Returns integers, at least 1, as floats.

    Raises:
      TypeError: they aren't of an integer type.
      ValueError: one is below 1.

    >>> count("k", 2.5)
    Traceback (most recent call last):
    ...
    TypeError: k = 2.5 must be an integer or an array of integers
    """
    kind = value.dtype.kind if hasattr(value, "dtype") else np.asarray(value).dtype.kind
    if kind not in "iu":
        raise TypeError(f"{name} = {value!r} must be an integer or an array of integers")
    return real(name, value, 1.0)


def scalar_count(name: str, value: Any) -> int:
    """Returns one integer, at least 1.

    Raises:
      TypeError: it isn't one integer.
      ValueError: it is below 1.
    """
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} = {value!r} must be an integer") from None
    if isinstance(value, bool):
        raise TypeError(f"{name} = {value!r} must be an integer")
    if number < 1:
        raise ValueError(f"{name} = {number} must be at least 1")
    return number


def probabilities(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
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
    if not (np.abs(sums - 1.0) <= 1e-6).all():
        worst = sums.flat[np.abs(sums - 1.0).argmax()]
        raise ValueError(f"{name}: a row sums to {worst}, and must sum to 1 within 1e-6")
    return array / sums


def transition(value: Any) -> np.ndarray:
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


def table(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Returns finite float64 numbers whose last axes have the sizes `shape`, None for any.

    Raises:
      ValueError: another shape, or something that isn't finite.
    """
    array = np.asarray(value, np.float64)
    last = array.shape[max(array.ndim - len(shape), 0) :]
    is_fitting = len(last) == len(shape) and all(
        size is None or size == found for size, found in zip(shape, last, strict=True)
    )
    if not is_fitting:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name} has shape {array.shape}, expected (..., {wanted})")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds {array[~np.isfinite(array)].flat[0]}, must be finite")
    return array
