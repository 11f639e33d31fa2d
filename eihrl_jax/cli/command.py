"""What a command is; a module of its own because listing the commands needs nothing else."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

ConfigT = TypeVar("ConfigT")


@dataclasses.dataclass(frozen=True)
class Command(Generic[ConfigT]):
    """One command.

    Attributes:
      main: what it does.
      config_type: dataclass of its options; its docstring is the help text.
      presets: defaults to choose from by name, the first one being used without it; each is a
        `config_type`, and has the name as the value of `option`.
      option: what the user chooses a preset with.
      uses_all_cores: whether every core of the CPU is a device of JAX.
      earlier: today's spelling of what was renamed and is still understood, by the option that it
        is a value of, "" for an option itself, and the earlier spelling.
    """

    main: Callable[[ConfigT], object]
    config_type: type[ConfigT]
    presets: Mapping[str, ConfigT] = dataclasses.field(default_factory=dict)
    option: str = "preset"
    uses_all_cores: bool = False
    earlier: Mapping[tuple[str, str], str] = dataclasses.field(default_factory=dict)
