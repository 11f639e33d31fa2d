"""Limits beside fields: every kind of annotation is checked, in the words of `checks`."""

import dataclasses
import math
from typing import Annotated, Literal

import pytest

from eihrl_jax import base
from eihrl_jax.config import limits


@limits.dataclass
class Inner:
    width: Annotated[int, limits.Range(2, 8)] = 4


@limits.dataclass
class Options:
    rate: limits.Rate = 0.5
    kind: Literal["patch", "planner"] = "patch"
    window: limits.Count | None = None
    widths: limits.Widths = ()
    seeds: limits.Seeds = (0,)
    pair: tuple[limits.Fraction, limits.Count] = (0.0, 1)
    method: Annotated[str, limits.OneOf({"higl": 1, "hess": 2})] = "higl"
    inner: Inner = dataclasses.field(default_factory=Inner)

    def __post_init__(self):
        if self.window == 13:
            raise base.UserError("window = 13 brings no luck")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate": 0.0}, "rate = 0.0 must be at most 1.0 and greater than 0.0"),
        ({"rate": math.nan}, "rate = nan must be at most 1.0 and greater than 0.0"),
        ({"kind": "fat"}, "kind = 'fat' must be one of patch, planner"),
        ({"window": 0}, "window = 0 must be at least 1 and at most 2147483647"),
        ({"widths": (8, 0)}, "widths = 0 must be at least 1 and at most 4096"),
        ({"seeds": ()}, "seeds is empty; give at least one"),
        ({"seeds": (1, 1)}, "seeds names 1 more than once"),
        ({"seeds": (1, -1)}, "seeds = -1 must be at least 0 and at most 4294967295"),
        ({"pair": (0.5, 0)}, "pair = 0 must be at least 1"),
        ({"method": "dqn"}, "method = 'dqn' must be one of higl, hess"),
        # The rules of several fields come after those of each.
        ({"window": 13}, "window = 13 brings no luck"),
        ({"window": 13, "rate": 2.0}, "rate = 2.0"),
    ],
)
def test_a_field_outside_its_limits_is_named(options, message):
    with pytest.raises(base.UserError, match=message):
        Options(**options)


def test_what_is_inside_passes_and_is_kept():
    options = Options(rate=1.0, window=None, widths=(1, 4096), pair=(1.0, 1))
    assert dataclasses.replace(options, window=3).window == 3
    assert options.widths == (1, 4096)
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.rate = 0.1


def test_nested_options_check_themselves():
    with pytest.raises(base.UserError, match="width = 1 must be at least 2 and at most 8"):
        Options(inner=Inner(width=1))


def test_fields_and_rules_are_inherited():
    @limits.dataclass
    class Longer(Options):
        steps: limits.Positive = 1.0

    for options in ({"steps": 0.0}, {"rate": 2.0}, {"window": 13}):
        with pytest.raises(base.UserError, match=next(iter(options))):
            Longer(**options)


def test_messages_may_have_a_prefix():
    @dataclasses.dataclass(frozen=True)
    class Movement:
        step: limits.NonNegative = -1.0

    with pytest.raises(base.UserError, match="movement step = -1.0 must be at least 0.0"):
        limits.check(Movement(), prefix="movement ")
