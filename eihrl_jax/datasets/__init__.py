"""Episodes of hierarchies as datasets for learners that don't act themselves."""

import importlib.util

from eihrl_jax import base

_NEEDED = ("gymnasium", "h5py", "minari")


def check_installed() -> None:
    """Checks that what writes datasets is there.

    Raises:
      base.UserError: it isn't.
    """
    for name in _NEEDED:
        if importlib.util.find_spec(name) is None:
            raise base.UserError(
                f"dataset needs {name}, which isn't there: pip install 'eihrl_jax[datasets]'"
            )
