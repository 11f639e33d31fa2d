"""The shell around every command line: presets, options, errors in one line, exit codes.

Exit codes: 0 done, 2 the user's mistake, 130 interrupted with Ctrl-C.
"""

import contextlib
import ctypes
import dataclasses
import errno
import functools
import io
import itertools
import os
import pathlib
import re
import shlex
import sys
import typing
from collections.abc import Mapping, Sequence
from typing import NoReturn, TypeVar

import jax
import tyro

from eihrl_jax import base
from eihrl_jax.cli import command as command_lib
from eihrl_jax.cli import output
from eihrl_jax.runs import stopping
from eihrl_jax.training import parallel

ConfigT = TypeVar("ConfigT")

_FULL = (errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOSPC)
"""What is wrong with a disk; whoever writes on it may not know a name."""

_M_ARENA_MAX, _MAX_HEAPS = -8, 2
"""Name of an option of glibc, and its value here."""


def run(command: command_lib.Command, argv: Sequence[str], program: str) -> None:
    """Parses a command line and does what it says; ends the process on an error.

    Args:
      command: which one.
      argv: its arguments.
      program: how it was called, for its help text.
    """
    # NaN is a value here, of what hasn't been measured yet, and all numbers are of 32 bits.
    jax.config.update("jax_debug_nans", False)
    jax.config.update("jax_enable_x64", False)
    stopping.not_lost()
    try:
        words = _in_full(_in_todays_words(argv, command.earlier), _options(command.config_type))
        config = _parse(command, words, program)
        # All before the first computation, with which JAX fixes its devices and starts its threads.
        _share_heaps()
        _set_compilation_cache()
        if command.uses_all_cores:
            parallel.use_cpu_cores()
        command.main(config)
    except base.UserError as error:
        fail(str(error))
    except OSError as error:
        # Without the name of a place the error may be ours: it keeps its traceback.
        if error.filename is None and error.errno not in _FULL:
            raise
        place = "" if error.filename is None else f"{error.filename!s:.300}: "
        fail(f"{place}{error.strerror}")
    except KeyboardInterrupt as stop:
        print(_farewell(stop, command, argv, program), file=sys.stderr)
        sys.exit(output.INTERRUPTED)


def _share_heaps() -> None:
    """Lets all threads share a few heaps of glibc, unless the user says how many.

    Each would get one of its own, up to eight for every core, and keep there what it has freed: a
    process that trains again and again would take up half as much memory once more.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        with contextlib.suppress(AttributeError, TypeError):  # another library of C
            ctypes.CDLL(None).mallopt(_M_ARENA_MAX, _MAX_HEAPS)


def _farewell(
    stop: KeyboardInterrupt, command: command_lib.Command, argv: Sequence[str], program: str
) -> str:
    """Returns the last words after Ctrl-C: what was kept, and what goes on from there."""
    if not isinstance(stop, base.Stopped):
        return "interrupted"
    words = [*shlex.split(program), *argv]
    # Commands of many runs go on by themselves.
    fields = {field.name for field in dataclasses.fields(command.config_type)}
    if "resume" in fields and "--resume" not in argv:
        words.append("--resume")
    return f"stopped: {stop}\ngo on with: {shlex.join(words)}"


def fail(message: str) -> NoReturn:
    """Ends the process with one line about the user's mistake."""
    print(f"error: {base.printable(message)}", file=sys.stderr)
    sys.exit(2)


def _in_todays_words(argv: Sequence[str], earlier: Mapping[tuple[str, str], str]) -> list[str]:
    """Returns the arguments in today's spelling, see `Command.earlier`."""
    words, option = [], ""
    for word in argv:
        if word.startswith("--"):
            # `--option=value` is one word, which both replacements concern.
            name, equals, value = word.partition("=")
            # The parser takes underscores for hyphens, and so did the earlier spellings.
            option = earlier.get(("", name.replace("_", "-")), name)
            words.append(option + equals + earlier.get((option, value), value))
        else:
            # Of the last option, which may have several values.
            words.append(earlier.get((option, word), word))

    return words


def _parse(command: command_lib.Command[ConfigT], arguments: list[str], program: str) -> ConfigT:
    """Parses the arguments; `--help` shows the defaults of the chosen preset."""
    messages = io.StringIO()
    parsed_type = command.config_type
    # Options without default are what a command is called with: `eihrl plot RUN RUN`.
    parse = functools.partial(
        tyro.cli, args=arguments, prog=program, config=(tyro.conf.PositionalRequiredArgs,)
    )
    # A preset's values are the parser's defaults, so that it must be known beforehand.
    if command.presets:
        default = command.presets[_chosen(command.presets, arguments, command.option)]
        parsed_type = type(default)
        parse = functools.partial(parse, default=default)

    # The parser's own message is a framed box of many lines; its first paragraph says it all.
    try:
        with contextlib.redirect_stderr(messages):
            return parse(parsed_type)
    except SystemExit as end:
        if end.code:
            message = _one_line(messages.getvalue()).removeprefix(f"{parsed_type.__name__}: ")
            fail(message + _hint(message, _options(parsed_type)))
        raise


def _options(config_type: type, prefix: str = "--") -> list[str]:
    """Lists the options of a command as they are spelled, those of configs inside it as `--a.b`."""
    names = []
    for name, kind in typing.get_type_hints(config_type).items():
        spelled = prefix + name.replace("_", "-")
        is_config = isinstance(kind, type) and dataclasses.is_dataclass(kind)
        names += _options(kind, f"{spelled}.") if is_config else [spelled]
    return names


def _in_full(argv: Sequence[str], options: Sequence[str]) -> list[str]:
    """Returns the arguments with every option's full name.

    Options of a config inside another one are known by their last word too, and what takes several
    values by its singular: `--maze` is the maze in every command.
    """
    words = []
    for word in argv:
        name, equals, value = word.partition("=")
        name = name.replace("_", "-")
        if word.startswith("--") and name not in options:
            short = name.removeprefix("--")
            fits = [
                option
                for option in options
                if re.split(r"--|\.", option)[-1] in (short, f"{short}s", short.removesuffix("s"))
            ]
            # Where several would fit, the user must say which.
            word = fits[0] + equals + value if len(fits) == 1 else word
        words.append(word)
    return words


def _hint(message: str, options: Sequence[str]) -> str:
    """Returns what may have been meant by an option that there isn't, if something is like it."""
    unknown = re.search(r"Unrecognized options: (--[\w.-]+)", message)
    hint = base.did_you_mean(unknown[1], options) if unknown else ""
    return f"; {hint.strip()}" if hint else ""


def _chosen(presets: Mapping[str, object], arguments: list[str], wanted: str) -> str:
    # Without it the first preset; given twice, the last one, as with every option.
    name = next(iter(presets))
    for argument, following in itertools.pairwise([*arguments, ""]):
        option, _, value = argument.partition("=")
        if option == f"--{wanted}":
            name = value or following
    if name not in presets:
        hint = base.did_you_mean(name, presets)
        raise base.UserError(f"--{wanted} {name!r}: {hint}must be one of {', '.join(presets)}")
    return name


def _one_line(box: str) -> str:
    """Reduces a framed message to its first paragraph."""
    words: list[str] = []
    for line in box.splitlines():
        content = line.strip("│ ")
        if line.startswith(("╭", "╰")):
            continue
        if set(content) == {"─"}:
            break  # a rule: what follows repeats the help text
        words += content.split()
    return " ".join(words).removeprefix("Error parsing ")


def _set_compilation_cache() -> None:
    """Lets JAX keep compiled programs between runs, unless the user has chosen a place already."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        home = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
        cache = pathlib.Path(home) / "eihrl_jax"
        cache.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return  # nobody's home, or one that may not be written to
    if os.access(cache, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(cache))
