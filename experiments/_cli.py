"""The shell around every command line: presets, options, errors in one line, exit codes.

Exit codes: 0 done, 2 the user's mistake, 130 interrupted with Ctrl-C.
"""

import contextlib
import errno
import functools
import io
import itertools
import os
import pathlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import jax
import tyro

from eihrl_jax import base

ConfigT = TypeVar("ConfigT")

_PLACE_ERRORS = (
    errno.EACCES,
    errno.EEXIST,
    errno.EISDIR,
    errno.ENOSPC,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
)
"""What is wrong with the place that files are to be read from or written to."""


def run(
    main: Callable[[ConfigT], None],
    config_type: type[ConfigT],
    presets: Mapping[str, ConfigT] | None = None,
    argv: Sequence[str] | None = None,
    *,
    option: str = "preset",
) -> None:
    """Parses the command line into a config and hands it to `main`; ends the process on an error.

    Args:
      main: what the command does.
      config_type: dataclass of the options; its docstring is the help text.
      presets: defaults to choose from by name, the first one being used without it; each is a
        `config_type`, and has the name as the value of `option`.
      argv: the arguments, those of the process by default.
      option: what the user chooses with.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        _set_compilation_cache()
        main(_parse(config_type, presets or {}, arguments, option))
    except base.UserError as error:
        _fail(str(error))
    except OSError as error:
        if error.errno not in _PLACE_ERRORS:
            raise
        _fail(f"{error.filename}: {error.strerror}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def _parse(
    config_type: type[ConfigT],
    presets: Mapping[str, ConfigT],
    arguments: list[str],
    option: str,
) -> ConfigT:
    """Parses the arguments; `--help` shows the defaults of the chosen preset."""
    messages = io.StringIO()
    parsed_type: type[ConfigT] = config_type
    parse = functools.partial(tyro.cli, config_type, args=arguments, prog=_program())
    if presets:
        default = presets[_chosen(presets, arguments, option)]
        parsed_type = type(default)
        parse = functools.partial(
            tyro.cli, parsed_type, default=default, args=arguments, prog=_program()
        )
    try:
        with contextlib.redirect_stderr(messages):
            return parse()
    except SystemExit as end:
        if end.code:
            _fail(_one_line(messages.getvalue()).removeprefix(f"{parsed_type.__name__}: "))
        raise


def _chosen(presets: Mapping[str, object], arguments: list[str], wanted: str) -> str:
    name = next(iter(presets))
    for argument, following in itertools.pairwise([*arguments, ""]):
        option, _, value = argument.partition("=")
        if option == f"--{wanted}":
            name = value or following
    if name not in presets:
        raise base.UserError(f"--{wanted} {name!r} must be one of {', '.join(presets)}")
    return name


def _one_line(box: str) -> str:
    """Reduces a framed message to its first paragraph."""
    words: list[str] = []
    for line in box.splitlines():
        content = line.strip("│ ")
        if line.startswith(("╭", "╰")):
            continue
        if set(content) == {"─"}:
            break
        words += content.split()
    return " ".join(words).removeprefix("Error parsing ")


def _fail(message: str) -> None:
    print(f"error: {message}", file=sys.stderr)
    sys.exit(2)


def _program() -> str:
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return f"python -m {spec.name}" if spec else pathlib.Path(sys.argv[0]).name


def _set_compilation_cache() -> None:
    """Lets JAX keep compiled programs between runs, unless the user has chosen a place already."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(cache / "eihrl_jax"))
