"""The rules about who imports whom, and about sizes, hold in every file; sources are only parsed.

A file that breaks one is named with its line. CONTRIBUTING tells the layers.
"""

import ast
import collections
import graphlib
import pathlib

import pytest

ROOT = pathlib.Path(__file__).parents[1]
PACKAGE = "eihrl_jax"

LAYERS = (
    {"base"},
    {"storage"},
    {"config"},
    {"ops"},
    {"mazes"},
    {"robots"},
    {"physics"},
    {"envs", "networks", "runs", "theory"},
    {"agents", "baselines", "brax"},
    {"evaluation", "training"},
    {"drawing"},
    {"gym", "reporting"},
    {"benchmarks", "datasets", "studies"},
    {"cli"},
    {"experiments"},
)
"""From the bottom up: a module imports its own part and those below."""

APART = [
    ("benchmarks", "studies"),
    ("envs", "agents"),
    ("envs", "networks"),
    ("envs", "runs"),
    ("envs", "theory"),
    ("evaluation", "training"),
    ("gym", "reporting"),
    ("networks", "runs"),
    ("networks", "theory"),
    ("runs", "theory"),
]
"""Parts that never import each other; `envs` and `agents` meet in `base`."""

ONLY_IN = {
    # The benchmark compares the engine with MuJoCo alone.
    "mujoco": (
        "eihrl_jax/physics/",
        "eihrl_jax/robots/",
        "eihrl_jax/envs/postures.py",
        "eihrl_jax/benchmarks/physics.py",
        "eihrl_jax/drawing/opengl.py",
    ),
    "orbax": ("eihrl_jax/runs/arrays.py",),
    "tensorboardX": ("eihrl_jax/runs/",),
    "brax": ("eihrl_jax/brax/", "eihrl_jax/benchmarks/neighbours.py"),
    "gymnasium": (
        "eihrl_jax/gym/",
        "eihrl_jax/datasets/",
        "eihrl_jax/benchmarks/low.py",
        "eihrl_jax/benchmarks/neighbours.py",
    ),
    "minari": ("eihrl_jax/datasets/minari_files.py",),
    "matplotlib": ("eihrl_jax/drawing/", "eihrl_jax/reporting/"),
    "PIL": ("eihrl_jax/drawing/", "eihrl_jax/reporting/", "eihrl_jax/mazes/readers/pictures.py"),
    "yaml": ("eihrl_jax/mazes/readers/pictures.py",),
    "stable_baselines3": (
        "eihrl_jax/gym/sb3.py",
        "eihrl_jax/benchmarks/low.py",
        "eihrl_jax/benchmarks/neighbours.py",
    ),
    "tyro": ("eihrl_jax/cli/",),
}
"""Where a package that moves may be imported."""

OPS_MAY_IMPORT = {"jax", "jaxtyping", "chex", "collections", "functools", "math", "typing"}
READS_AND_WRITES = ("read_text", "read_bytes", "write_text", "write_bytes")
RUNS_CODE = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}
EFFECTS = ("jax", "jnp", "np", "numpy", "mujoco", "warnings", "os", "logging", "matplotlib", "plt")
NO_EFFECTS = ("jax.jit", "jax.vmap", "jax.tree_util.register_", "np.dtype", "os.path.")

MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_NESTED_DEFINITIONS = 2
MAX_FOLDER_SHARE = 0.14
MIN_LONG_BODY = 20
"""Lines from which on a body is written in paragraphs."""

FILES = sorted(file for part in (PACKAGE, "experiments") for file in (ROOT / part).rglob("*.py"))
TREES = {file.relative_to(ROOT).as_posix(): ast.parse(file.read_text()) for file in FILES}

every_file = pytest.mark.parametrize("name", TREES)


def part_of(module: str) -> str:
    """Part of the project that a dotted module belongs to, "" for the package itself."""
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == PACKAGE else first


def module_of(name: str) -> str:
    return name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def imports_of(tree: ast.Module) -> list[tuple[int, str]]:
    """Every import of a file, also the late ones, as (line, dotted name)."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


def own_imports(tree: ast.Module) -> list[tuple[int, str]]:
    return [
        (line, module)
        for line, module in imports_of(tree)
        if module.partition(".")[0] in (PACKAGE, "experiments")
    ]


def rank(part: str) -> int:
    ranks = [i for i, layer in enumerate(LAYERS) if part in layer]
    assert ranks, f"{part} is in no layer"
    return ranks[0]


@every_file
def test_imports_go_down(name):
    part = part_of(module_of(name))
    for line, module in own_imports(TREES[name]):
        other = part_of(module)
        if part and other:
            assert rank(other) <= rank(part), f"{name}:{line}: {part} imports {module} above it"


def test_no_files_import_each_other_in_a_circle():
    names = {module_of(name): name for name in TREES}
    graph = {
        names[module]: {
            # What is imported is a module, or something that stands in one.
            names.get(target, names.get(target.rpartition(".")[0], ""))
            for _, target in own_imports(TREES[names[module]])
        }
        - {"", names[module]}
        for module in names
    }
    graphlib.TopologicalSorter(graph).prepare()  # raises where there is a circle


def test_folders_alone_at_the_root_and_none_too_large():
    sizes = collections.Counter()
    for name in TREES:
        sizes["/".join(name.split("/")[:-1][:2])] += len((ROOT / name).read_text().splitlines())
    loose = {name for name in TREES if name.count("/") == 1 and name.startswith(PACKAGE)}
    assert loose == {f"{PACKAGE}/__init__.py", f"{PACKAGE}/base.py"}
    folder, lines = sizes.most_common(1)[0]
    assert lines <= MAX_FOLDER_SHARE * sizes.total(), f"{folder} has {lines} of {sizes.total()}"


@every_file
def test_parts_that_stay_apart(name):
    part = part_of(module_of(name))
    for line, module in own_imports(TREES[name]):
        pair = {part, part_of(module)}
        assert all(pair != set(apart) for apart in APART), f"{name}:{line}: imports {module}"


@every_file
def test_packages_that_move_stay_in_their_place(name):
    for line, module in imports_of(TREES[name]):
        places = ONLY_IN.get(module.partition(".")[0])
        assert places is None or name.startswith(places), f"{name}:{line}: imports {module}"


@every_file
def test_files_are_read_and_written_by_storage(name):
    """It reads nothing but regular files of bounded size, and writes whole ones, all in UTF-8."""
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Attribute) and node.attr in READS_AND_WRITES:
            by = node.value.id if isinstance(node.value, ast.Name) else ""
            assert by in ("reading", "writing"), f"{name}:{node.lineno}: {node.attr}"


@every_file
def test_ops_are_jnp_only(name):
    if part_of(module_of(name)) != "ops":
        return
    for line, module in imports_of(TREES[name]):
        is_own = module.startswith((f"{PACKAGE}.ops", f"{PACKAGE}.base"))
        first = module.partition(".")[0]
        assert is_own or first in OPS_MAY_IMPORT, f"{name}:{line}: imports {module}"
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("print", "open"), f"{name}:{node.lineno}: {node.func.id}"


@every_file
def test_nothing_private_is_imported(name):
    for line, module in own_imports(TREES[name]):
        is_shell = module.startswith("experiments._") and name.startswith("experiments/")
        private = [word for word in module.split(".") if word.startswith("_")]
        assert is_shell or not private, f"{name}:{line}: imports {module}"


@every_file
def test_nothing_is_unpickled_or_evaluated(name):
    for line, module in imports_of(TREES[name]):
        assert module.partition(".")[0] not in RUNS_CODE, f"{name}:{line}: imports {module}"
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Call):
            is_run = isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec", "compile")
            assert not is_run, f"{name}:{node.lineno}: runs text as code"
            for keyword in node.keywords:
                is_false = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
                is_safe = keyword.arg != "allow_pickle" or is_false
                assert is_safe, f"{name}:{node.lineno}: unpickles"


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


class ImportTime(ast.NodeVisitor):
    """Collects what runs when a module is imported: calls, and writes to `os.environ`."""

    def __init__(self):
        self.effects = []

    def visit_FunctionDef(self, node):
        for part in [*node.decorator_list, *node.args.defaults, *node.args.kw_defaults]:
            if part is not None:
                self.visit(part)

    def visit_Lambda(self, node):
        """Its body runs later."""

    def visit_If(self, node):
        if ast.unparse(node.test) != "__name__ == '__main__'":
            self.generic_visit(node)

    def visit_Call(self, node):
        name = dotted(node.func)
        if name.partition(".")[0] in EFFECTS and not name.startswith(NO_EFFECTS):
            self.effects.append((node.lineno, name))
        self.generic_visit(node)

    def visit_Attribute(self, node):
        if dotted(node) == "os.environ":
            self.effects.append((node.lineno, "os.environ"))
        self.generic_visit(node)


@every_file
def test_importing_has_no_effects(name):
    visitor = ImportTime()
    visitor.visit(TREES[name])
    places = [f"{name}:{line}: {what}" for line, what in visitor.effects]
    assert not places, places


@every_file
def test_files_are_short(name):
    lines = len((ROOT / name).read_text().splitlines())
    assert lines <= MAX_FILE_LINES, f"{name} has {lines} lines"


@every_file
def test_functions_are_short(name):
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.FunctionDef):
            lines = node.end_lineno - node.lineno + 1
            place = f"{name}:{node.lineno}: {node.name}"
            assert lines <= MAX_FUNCTION_LINES, f"{place} has {lines} lines"


@every_file
def test_long_bodies_are_written_in_paragraphs(name):
    lines = (ROOT / name).read_text().splitlines()
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.FunctionDef):
            has_docstring = ast.get_docstring(node) is not None
            statements = node.body[1:] if has_docstring else node.body
            body = lines[statements[0].lineno - 1 : node.end_lineno] if statements else []
            breaks = [line for line in body if not line.strip() or line.strip().startswith("#")]
            place = f"{name}:{node.lineno}: {node.name}"
            assert len(body) < MIN_LONG_BODY or breaks, f"{place}: {len(body)} lines, no paragraph"


def nesting(node: ast.AST) -> int:
    """How deep definitions are nested in a node, itself not counted."""
    deepest = 0
    for child in ast.iter_child_nodes(node):
        is_definition = isinstance(child, ast.FunctionDef | ast.ClassDef)
        deepest = max(deepest, nesting(child) + is_definition)
    return deepest


@every_file
def test_definitions_are_hardly_nested(name):
    assert nesting(TREES[name]) <= 1 + MAX_NESTED_DEFINITIONS


@pytest.mark.parametrize(
    ("source", "effect"),
    [
        ("import jax.numpy as jnp\nX = jnp.zeros(3)", "jnp.zeros"),
        ("import jax\njax.config.update('a', 1)", "jax.config.update"),
        ("import os\nos.environ['A'] = 'b'", "os.environ"),
        ("import jax.numpy as jnp\ndef f(x=jnp.ones(3)): ...", "jnp.ones"),
        ("import jax.numpy as jnp\nclass A:\n  x = jnp.ones(3)", "jnp.ones"),
    ],
)
def test_effects_at_import_are_seen(source, effect):
    visitor = ImportTime()
    visitor.visit(ast.parse(source))
    assert [what for _, what in visitor.effects] == [effect]
