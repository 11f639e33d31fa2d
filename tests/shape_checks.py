"""The check of shapes and types that pytest puts around every function of the package.

Constructors are left out: JAX rebuilds pytrees with batched arrays, with placeholders and with
partition specs in place of what their fields say of one environment.
"""

from collections.abc import Callable

import beartype

check_calls = beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))


def checked(function: Callable) -> Callable:
    """Returns the function with its arguments and its result checked at every call."""
    return function if function.__name__ == "__init__" else check_calls(function)
