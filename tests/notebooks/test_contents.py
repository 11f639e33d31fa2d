"""Every notebook defines nothing of its own, keeps its outputs, and has a test that runs it.

Each is run in a file of its own: compilation takes most of a minute.
"""

import ast
import pathlib

import pytest

from tests.notebooks import files

HERE = pathlib.Path(__file__).parent
MAX_BYTES = 600_000
every_notebook = pytest.mark.parametrize("name", files.NAMES)


def definitions(source):
    """What a cell defines: functions, classes, and lambdas that are given a name."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.NamedExpr):
            has_lambda = node.value and any(isinstance(n, ast.Lambda) for n in ast.walk(node.value))
            found += ["lambda"] if has_lambda else []
    return found


def private_names(source):
    """Names with a leading underscore that a cell takes from elsewhere."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute):
            found.append(node.attr)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found += [word for alias in node.names for word in alias.name.split(".")]
            found += (getattr(node, "module", None) or "").split(".")
    return [name for name in found if name.startswith("_")]


def test_there_are_notebooks():
    assert files.NAMES


@every_notebook
def test_nothing_is_defined_and_nothing_private_is_used(name):
    for number, cell in enumerate(files.code_cells(files.read(name)), 1):
        assert not definitions(cell.source), f"{name}: code cell {number}"
        assert not private_names(cell.source), f"{name}: code cell {number}"


@every_notebook
def test_is_kept_as_a_whole_run_leaves_it(name):
    cells = files.code_cells(files.read(name))
    counts = [cell.execution_count for cell in cells]
    kinds = {output.output_type for cell in cells for output in cell.outputs}
    assert counts == list(range(1, len(cells) + 1)), f"{name}: run it as a whole"
    assert "display_data" in kinds
    assert "error" not in kinds
    assert files.path(name).stat().st_size < MAX_BYTES


@every_notebook
def test_outputs_name_no_place(name):
    """Of the machine on which they were made."""
    for cell in files.code_cells(files.read(name)):
        for output in cell.outputs:
            assert "/tmp/" not in str(output.get("text", "")), f"{name}: {output.text}"


def test_each_is_run():
    assert {f"test_{name}.py" for name in files.NAMES} | {"test_contents.py"} == {
        path.name for path in HERE.glob("test_*.py")
    }


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(): ...", ["f"]),
        ("if True:\n    class A: ...", ["A"]),
        ("f = lambda x: x", ["lambda"]),
        ("f = [lambda x: x]", ["lambda"]),
        ("x: int", []),
        ("sorted(xs, key=lambda x: -x)", []),
    ],
)
def test_definitions_are_seen(source, found):
    assert definitions(source) == found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("a._b", ["_b"]),
        ("from a import _b", ["_b"]),
        ("import a._b", ["_b"]),
        ("from a._b import c", ["_b"]),
        ("for _ in range(3): a.b", []),
    ],
)
def test_private_names_are_seen(source, found):
    assert private_names(source) == found
