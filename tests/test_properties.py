"""Whatever is given, it is taken or one line is said of it: mazes, maps, robots, options, policies.

A few examples of each are tried with the other tests; `make fuzz` tries as many as FUZZ says, as
numbers of `EXAMPLES`, and then no process may have taken more than a GiB.
"""

import io
import json
import os
import pathlib
import pickle
import re
import resource
import shutil
import time

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from PIL import Image

from eihrl_jax import base, mazes, robots
from eihrl_jax.cli import commands, shell
from eihrl_jax.config import codec
from eihrl_jax.evaluation import loading
from eihrl_jax.mazes import parsing
from eihrl_jax.physics import scene
from eihrl_jax.runs import checkpoint, policies
from eihrl_jax.storage import writing

IS_NIGHT = "FUZZ" in os.environ
EXAMPLES = {
    "mazes": (60, 10_000),
    "maps": (60, 10_000),
    "robots": (12, 2_000),
    "options": (12, 2_000),
    "policies": (6, 2_000),
}
"""How many are tried in the default tests, and at night."""

MAX_BYTES = 2**30
MAX_SECONDS = 5.0  # of the processor, compilation of what a process needs first included


def tried(kind):
    """Settings of a property's test: the same examples every time, but others at night."""
    return hypothesis.settings(
        max_examples=EXAMPLES[kind][IS_NIGHT],
        derandomize=not IS_NIGHT,
        database=None,
        deadline=None,  # the machine may be busy with anything: see `taken`
        suppress_health_check=list(hypothesis.HealthCheck),
        # What is found is small enough as it is, and making it smaller takes minutes.
        phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
    )


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder, and in it the file `executed` if anything of a file was."""
    path = tmp_path_factory.mktemp("properties")
    yield path
    assert not (path / "executed").exists()
    if IS_NIGHT:
        kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f"\nmost memory: {kilobytes / 1024:.0f} MiB, executed: 0")
        assert 1024 * kilobytes <= MAX_BYTES


def taken(call):
    """Returns what a call returns, None where one line was said instead."""
    began = time.process_time()
    try:
        return call()
    except base.UserError as error:
        assert 0 < len(str(error)) < 2_000 and "\n" not in str(error)
    except OSError as error:
        assert error.filename is not None
    finally:
        assert time.process_time() - began < MAX_SECONDS
    return None


# Any bytes: pieces of a file that is right are changed, doubled, left out, or others put in.

ODD = [b"\0", b"\xff\xfe", b"\n\n", b"-1", b"1e999", b"9" * 400, b"[" * 3000, b'"', b"&", b"null"]
PIECES = (
    st.binary(max_size=6) | st.sampled_from(ODD) | st.from_regex(rb"-?[0-9]{1,9}", fullmatch=True)
)
PLACES = st.floats(0.0, 1.0, exclude_max=True)
EDITS = st.lists(st.tuples(PLACES, st.integers(0, 12), PIECES, st.booleans()), max_size=4)


def edited(data, edits):
    for place, length, piece, is_doubled in edits:
        at = int(place * (len(data) + 1))
        kept = data[at : at + length] * is_doubled
        data = data[:at] + kept + piece + data[at + length :]
    return data


# Values of JSON and TOML.

WORDS = st.sampled_from(
    ["", "ant", "free", "planar", "oracle", "x" * 300, "../a", "a\nb", "é", "0"]
)
NUMBERS = st.floats(width=64) | st.integers(-(2**70), 2**70) | st.sampled_from([0, 1, -1, 1e-308])
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | WORDS | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=2),
    max_leaves=4,
)


def places_of(value, path=()):
    """Lists the paths of all that stands in a JSON value."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    inner = [(*path, key) for key, _ in pairs]
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, each in pairs:
        if isinstance(each, dict | list):
            inner += places_of(each, (*path, key))
    return inner


def replaced(value, changes):
    """Puts other values into a copy of a JSON value, or leaves some out."""
    value = json.loads(json.dumps(value))
    for place, new, is_left_out in changes:
        paths = places_of(value)
        if not paths:
            break
        *path, last = paths[int(place * len(paths))]
        inner = value
        for key in path:
            inner = inner[key]
        if is_left_out:
            del inner[last]
        else:
            inner[last] = new
    return value


CHANGES = st.lists(st.tuples(PLACES, VALUES, st.booleans()), min_size=1, max_size=3)


# Mazes.


@st.composite
def grids(draw):
    """Rows of cells, mostly with a closed ring."""
    rows, columns = draw(st.integers(1, 7)), draw(st.integers(1, 7))
    cells = st.sampled_from("#.........SS*DG12345" if draw(st.booleans()) else "...S1")
    inside = [[draw(cells) for _ in range(columns)] for _ in range(rows)]
    ring = draw(st.sampled_from(["#", "#", "#", "D", "1", "."]))
    lines = ["#" * (columns + 2), *(f"#{''.join(row)}#" for row in inside), "#" * (columns + 2)]
    at = draw(st.integers(0, columns + 1))
    lines[0] = lines[0][:at] + ring + lines[0][at + 1 :]
    head = draw(st.sampled_from(["", "", "decisions 9\n", "decisions -1\n", "jitter nan\n"]))
    return head + draw(st.sampled_from(["\n", "\r\n", "\r"])).join(lines)


@tried("mazes")
@hypothesis.given(grids() | st.text("#.S1DG* \n\r\t\x0bx", max_size=80) | st.text(max_size=40))
def test_any_text_is_a_maze_or_one_line_is_said_of_it(text):
    maze = taken(lambda: parsing.parse(text, on_host=True))
    if maze is not None:
        again = parsing.parse(parsing.text_of(maze), on_host=True)
        for name, value in vars(maze).items():
            np.testing.assert_array_equal(getattr(again, name), value)


class Executed:
    """Its pickle leaves a file where a test looks for it."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return pathlib.Path.touch, (self.path,)


def saved(save):
    stream = io.BytesIO()
    save(stream)
    return stream.getvalue()


def samples(executed):
    """Files of every kind that are read as mazes, and some that want to be executed."""
    pixels = np.full((8, 9), 255, np.uint8)
    pixels[3, :6] = 0
    wall = [[1, 1, 1, 1, 1], [1, "r", 0, "g", 1], [1, 1, 0, "c", 1], [1, 1, 1, 1, 1]]
    header = b"version 1\n"
    ros = b"image: a.pgm\nresolution: 0.5\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\n"
    ros += b"occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    objects = np.array([[Executed(executed)]], dtype=object)
    apply = f"!!python/object/apply:os.system ['touch {executed}']"
    return [
        b"decisions 30\njitter 0.25\n#######\n#S.1.2#\n#######\n",
        b"#####\n#G*.#\n#SS.#\n#####\n",
        b".....\n..#..\n>.#.G\n",
        b'"0 0 0",\n"0 1 0",\ngoal_pos = (2, 1)\nagent_pos = (0, 1)\n',
        json.dumps({"wall_map": ["0 0", "1 0"], "goal_pos": [0, 0], "agent_pos": [1, 1]}).encode(),
        json.dumps(wall).encode(),
        rb"#####\#GOO#\###O#\#OOO#\#####",
        b"type octile\nheight 3\nwidth 4\nmap\n..@.\n.TG.\nS.W.\n",
        header + b"0\tmap\t4\t3\t0\t0\t1\t2\t3.5\n",
        ros,
        ros.replace(b"a.pgm", apply.encode()),
        saved(lambda file: np.save(file, np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]]))),
        saved(lambda file: np.save(file, objects, allow_pickle=True)),
        pickle.dumps(Executed(executed)),
        *(
            saved(lambda file, kind=kind: Image.fromarray(pixels).save(file, kind))
            for kind in ("PNG", "PPM", "BMP", "JPEG")
        ),
    ]


@tried("maps")
@hypothesis.given(st.data())
def test_any_file_is_a_maze_or_one_line_is_said_of_it(place, data):
    files = samples(place / "executed")
    (place / "a.pgm").write_bytes(b"P5\n4 3\n255\n" + bytes(range(0, 240, 20)))
    (place / "map").write_bytes(b"type octile\nheight 3\nwidth 4\nmap\n....\n.TG.\nS...\n")
    content = files[data.draw(st.integers(0, len(files) - 1))]
    (place / "file").write_bytes(edited(content, data.draw(EDITS)))
    taken(lambda: mazes.load(place / "file", on_host=True))


# Robots.

DESCRIPTION = {
    "name": "mine",
    "mjcf": "point.xml",
    "root": "slide",
    "physics_step": 0.02,
    "num_substeps": 5,
    "steps_per_subgoal": 10,
    "reach": 0.5,
    "body_radius": 0.5,
    "cell": 3.0,
    "max_speed": 5.0,
    "keyframe": "stand",
    "qpos_noise": 0.0,
}
NUMBER = re.compile(rb'(?<=[" ])-?[0-9.]+(?=[" ])')


def toml(values):
    """Writes values as TOML, as far as it knows them."""
    return "".join(
        f"{key} = {json.dumps(value).replace('NaN', 'nan').replace('Infinity', 'inf')}\n"
        for key, value in values.items()
    )


@tried("robots")
@hypothesis.given(st.data())
def test_any_description_is_a_robot_or_one_line_is_said_of_it(place, data):
    model = robots.load("point").mjcf.read_bytes()
    text = toml(DESCRIPTION).encode()
    what = data.draw(st.sampled_from(["values", "text", "model", "numbers"]))
    if what == "values":
        text = toml(replaced(DESCRIPTION, data.draw(CHANGES))).encode("utf-8", "surrogatepass")
    elif what == "text":
        text = edited(text, data.draw(EDITS))
    elif what == "model":
        model = edited(model, data.draw(EDITS))
    else:
        spans = [found.span() for found in NUMBER.finditer(model)]
        begin, end = spans[data.draw(st.integers(0, len(spans) - 1))]
        odd = st.sampled_from(
            [b"nan", b"inf", b"-1", b"1e30", b"1e-308", b"0", b"", b"1 2 3", b"x"]
        )
        model = model[:begin] + data.draw(odd) + model[end:]
    (place / "point.xml").write_bytes(model)
    (place / "mine.toml").write_bytes(text)
    robot = taken(lambda: robots.load(str(place / "mine.toml")))
    if robot is not None:
        taken(lambda: scene.build(robot))


# Options.

COMMANDS = ("train_high", "train_low", "train_baseline", "evaluate", "maze")
ARGUMENTS = WORDS | st.text(max_size=6) | NUMBERS.map(str) | st.sampled_from(["None", "True", "1"])


@tried("options")
@hypothesis.given(st.data())
def test_any_options_are_taken_or_one_line_is_said_of_them(data):
    command = commands.COMMANDS[data.draw(st.sampled_from(COMMANDS))]()
    config_type = command.config_type
    if data.draw(st.booleans()) and command.presets:
        preset = next(iter(command.presets.values()))
        config = json.loads(codec.to_json(preset))
        text = json.dumps(replaced(config, data.draw(CHANGES)))
        taken(lambda: codec.from_json(type(preset), text))
        return

    names = [*shell._options(config_type), "--preset", "--unknown", "-x"]
    words = []
    for name in data.draw(st.lists(st.sampled_from(names), max_size=3)):
        words += [name, *data.draw(st.lists(ARGUMENTS, max_size=2))]
    shown, said = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(shell.sys, "stdout", shown)
        patched.setattr(shell.sys, "stderr", said)
        try:
            shell._parse(command, shell._in_full(words, shell._options(config_type)), "test")
        except SystemExit as end:
            assert end.code == 0 or said.getvalue().count("\n") == 1, said.getvalue()
            assert end.code == 0 or said.getvalue().startswith("error: ")
        except base.UserError as error:
            assert "\n" not in str(error)


# Policies and checkpoints.

LOADS = {
    "best-random-0": ("high", loading.load_high),
    "point": ("low", lambda path: loading.load_low(path, robots.load("point"))),
}


@tried("policies")
@hypothesis.given(st.data())
def test_any_folder_is_a_policy_or_one_line_is_said_of_it(place, data):
    name = data.draw(st.sampled_from(list(LOADS)))
    kind, load = LOADS[name]
    origin, path = policies.find(name, kind), place / "policy"
    writing.discard(path)
    if data.draw(st.booleans()):
        # Whole, and odd.
        params, meta = policies.load(origin, kind=kind)
        meta = replaced({"kind": kind, **meta}, data.draw(CHANGES))
        checkpoint.write(path, {"params": params}, files={"meta.json": json.dumps(meta)})
        taken(lambda: load(str(path)))
        return

    shutil.copytree(origin, path)
    files = sorted(file for file in path.rglob("*") if file.is_file())
    file = files[data.draw(st.integers(0, len(files) - 1))]
    before, edits = file.read_bytes(), data.draw(EDITS)
    if data.draw(st.booleans()):
        file.write_bytes(edited(before, edits))
    else:
        file.unlink()
    if file.is_file() and file.read_bytes() == before:
        return
    loaded = taken(lambda: load(str(path)))
    # A description may have other spaces; nothing else may be read that was changed.
    assert loaded is None or file.name == "manifest.json"
