"""Configs as JSON: frozen dataclasses of numbers, words, paths, tuples and other such dataclasses.

`from_json` builds nothing but the given class and what its annotations name, so a config file from
a stranger can't run code.
"""

import dataclasses
import json
import pathlib
import types
import typing
from typing import Any, TypeAlias, TypeVar

from eihrl_jax import base
from eihrl_jax.config import checks
from eihrl_jax.storage import reading

ConfigT = TypeVar("ConfigT")

Json: TypeAlias = Any
"""A JSON value, of which only the annotation says what it should be."""

Hint: TypeAlias = Any
"""An annotation: a class, or what `typing` makes of some."""


def to_json(config: Any) -> str:
    """Returns a config, any dataclass, as JSON text; paths become text and tuples become lists."""
    return json.dumps(dataclasses.asdict(config), indent=2, default=str) + "\n"


def from_json(config_type: type[ConfigT], text: str, *, source: str = "config") -> ConfigT:
    """Builds a config from JSON text; options that the text leaves out keep their defaults.

    Names in a dataclass's `RETIRED` are passed over: options that it had once.

    Args:
      config_type: the dataclass to build.
      text: what `to_json` returned.
      source: where the text comes from, for the error.

    Raises:
      UserError: no JSON, an unknown option, a value of the wrong type or outside its limits.
    """
    values = reading.parse_json(text, source)
    try:
        return _build(config_type, values, source)
    except base.UserError:
        raise
    except (TypeError, ValueError) as error:
        raise base.UserError(f"{source} doesn't fit: {error}") from None


def _build(annotation: Hint, value: Json, name: str) -> Any:
    """Turns a JSON value into what its annotation asks for."""
    # What is made of several classes first: they have no `type` to compare with.
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        return _build_union(arguments, value, name)
    if origin is typing.Literal:
        checks.one_of(name, value if isinstance(value, str) else repr(value), arguments)
        return value
    if origin is tuple:
        return _build_tuple(arguments, value, name)
    if dataclasses.is_dataclass(annotation):
        return _build_dataclass(annotation, value, name)

    # JSON has no paths, and writes 1.0 as 1 where it wasn't this module that wrote it.
    if annotation is pathlib.Path and isinstance(value, str):
        return pathlib.Path(value)
    if annotation is float and type(value) is int:
        return float(value)
    # No `isinstance`: to Python True is an int.
    if type(value) is not annotation:
        raise base.UserError(f"{name} = {value!r} must be {_type_name(annotation)}")
    return value


def _build_union(arguments: tuple[Hint, ...], value: Json, name: str) -> Any:
    """Returns what the first alternative makes of the value that takes it."""
    for argument in arguments:
        if dataclasses.is_dataclass(argument) and isinstance(value, dict):
            return _build(argument, value, name)  # with what is wrong inside of it
        try:
            return _build(argument, value, name)
        except base.UserError:
            continue

    names = " or ".join(_type_name(argument) for argument in arguments)
    raise base.UserError(f"{name} = {value!r} must be {names}")


def _build_tuple(arguments: tuple[Hint, ...], value: Json, name: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise base.UserError(f"{name} = {value!r} must be a list")
    # `tuple[int, ...]` is as long as the list, `tuple[int, int]` has its own length.
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        arguments = (arguments[0],) * len(value)
    if len(arguments) != len(value):
        raise base.UserError(f"{name} = {value!r} must have {len(arguments)} elements")

    pairs = zip(arguments, value, strict=True)
    return tuple(_build(each, item, f"{name}[{i}]") for i, (each, item) in enumerate(pairs))


def _build_dataclass(annotation: Hint, value: Json, name: str) -> Any:
    if not isinstance(value, dict):
        raise base.UserError(f"{name} = {value!r} must be an object of options")
    hints = typing.get_type_hints(annotation)  # limits left out: the class checks them itself

    # A misspelled option would else keep its default without a word; what a class has had once and
    # has no more is passed over.
    known = [field.name for field in dataclasses.fields(annotation) if field.init]
    retired = getattr(annotation, "RETIRED", ())
    value = {key: item for key, item in value.items() if key not in retired}
    unknown = [key for key in value if key not in known]
    if unknown:
        raise base.UserError(
            f"{name}: unknown option {unknown[0]!r:.80}; known: {', '.join(known)}"
        )

    # Through the constructor, so that what is read is checked like what is typed in.
    return annotation(**{key: _build(hints[key], item, key) for key, item in value.items()})


def _type_name(annotation: Hint) -> str:
    return "null" if annotation is type(None) else getattr(annotation, "__name__", str(annotation))
