"""What `import eihrl_jax` shows: all of it there, documented with examples, and nothing done."""

import ast
import pathlib
import subprocess
import sys

import pytest

import eihrl_jax

NAMES = sorted(name for name in eihrl_jax.__all__ if not name.startswith("_"))


def test_what_one_works_with_is_there():
    assert set(NAMES) >= {
        *("load_maze", "load_robot", "load_high", "load_low"),
        *("Maze", "OracleMaze", "PhysicsMaze", "Hierarchy"),
        *("train_low", "train_high", "evaluate", "presets"),
    }
    assert set(dir(eihrl_jax)) == set(eihrl_jax.__all__)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(pathlib.Path(eihrl_jax.__file__).read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    imported = {
        (f"{node.module}.{alias.name}".removeprefix("eihrl_jax."), alias.asname)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert imported == {(place, name) for name, place in eihrl_jax._PLACES.items()}


@pytest.mark.parametrize("name", NAMES)
def test_each_name_has_an_example(name):
    """`test_docs` runs them."""
    assert ">>>" in getattr(eihrl_jax, name).__doc__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'load_mase'"):
        eihrl_jax.load_mase  # noqa: B018


def test_using_every_name_touches_no_device():
    code = (
        "import sys, eihrl_jax\n"
        "assert 'jax' not in sys.modules\n"
        "for name in eihrl_jax.__all__: getattr(eihrl_jax, name)\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
