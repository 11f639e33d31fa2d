"""Configs survive JSON; what doesn't fit is named."""

import dataclasses
import json
import math
import pathlib
from typing import Literal

import pytest

from eihrl_jax import base
from eihrl_jax.config import checks, codec


@dataclasses.dataclass(frozen=True, kw_only=True)
class Inner:
    sizes: tuple[int, ...] = (1, 2)
    pair: tuple[float, str] = (0.5, "a")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    rate: float = 0.1
    engine: Literal["mjx", "mujoco"] = "mjx"
    maze: str | None = None
    run: pathlib.Path = pathlib.Path("runs/x")
    resume: bool = False
    inner: Inner = Inner()

    def __post_init__(self):
        checks.in_range("rate", self.rate, 0.0, 1.0)


def test_json_round_trip():
    options = Config(rate=1.0, maze="u", inner=Inner(sizes=(), pair=(2.0, "b")))
    assert codec.from_json(Config, codec.to_json(options)) == options


def test_options_left_out_keep_their_defaults():
    assert codec.from_json(Config, '{"rate": 1}') == Config(rate=1.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rat": 1.0}, "unknown option 'rat'; known: rate, engine"),
        ({"rate": "fast"}, "rate = 'fast' must be float"),
        ({"rate": True}, "rate = True must be float"),
        ({"rate": 2.0}, "rate = 2.0 must be at least 0.0 and at most 1.0"),
        ({"engine": "ode"}, "engine = 'ode' must be one of mjx, mujoco"),
        ({"maze": 3}, "maze = 3 must be str or null"),
        ({"inner": 3}, "inner = 3 must be an object"),
        ({"inner": {"sizes": 3}}, "sizes = 3 must be a list"),
        ({"inner": {"sizes": [1.5]}}, r"sizes\[0\] = 1.5 must be int"),
        ({"inner": {"pair": [1.0]}}, "must have 2 elements"),
    ],
)
def test_what_does_not_fit_is_named(values, message):
    with pytest.raises(base.UserError, match=message):
        codec.from_json(Config, json.dumps(values))


def test_text_that_is_no_json():
    with pytest.raises(base.UserError, match=r"x/config.json is no JSON"):
        codec.from_json(Config, "{", source="x/config.json")


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1, 1.1])
def test_numbers_outside_their_limits(value):
    with pytest.raises(base.UserError, match=r"rate = .* must be at least 0.0 and at most 1.0"):
        checks.in_range("rate", value, 0.0, 1.0)


def test_open_limits():
    checks.in_range("rate", 0.5, above=0.0, below=1.0)
    with pytest.raises(base.UserError, match=r"greater than 0.0 and smaller than 1.0"):
        checks.in_range("rate", 0.0, above=0.0, below=1.0)


def test_unknown_word():
    with pytest.raises(base.UserError, match="reward = 'fat' must be one of sparse, dense"):
        checks.one_of("reward", "fat", ("sparse", "dense"))


def test_divides():
    checks.divides("a", 4, "b", 8)
    with pytest.raises(base.UserError, match="a = 0 must divide b = 8"):
        checks.divides("a", 0, "b", 8)
