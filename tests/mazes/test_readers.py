"""Every kind of file is recognised by its content; what is wrong with it is told in one line."""

import io
import json
import math
import struct
import time
import zlib

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies
from PIL import Image

from eihrl_jax import base, mazes
from eihrl_jax.config import limits, reading
from eihrl_jax.mazes import generators, parsing, paths

JAXUED = ".....\n..#..\n>.#.G\n"
MINIMAX = '"0 0 0 0 0",\n"0 0 1 0 0",\n"0 0 1 0 0",\ngoal_pos = (4, 2)\nagent_pos = (0, 2)\n'
MAZE_MAP = [[1, 1, 1, 1, 1], [1, "r", 0, "g", 1], [1, 1, 0, "c", 1], [1, 1, 1, 1, 1]]
D4RL = r"#####\#GOO#\###O#\#OOO#\#####"
MAP = "type octile\nheight 3\nwidth 4\nmap\n..@.\n.TG.\nS.W.\n"
SCEN = "version 1\n0\tfolder/a.map\t4\t3\t0\t0\t1\t2\t3.5\n1\ta.map\t4\t3\t1\t0\t0\t2\t3.5\n"
YAML = "image: a.pgm\nresolution: 0.1\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\n"
YAML += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


def pgm(pixels: np.ndarray) -> bytes:
    rows, columns = pixels.shape
    return b"P5\n%d %d\n255\n" % (columns, rows) + pixels.astype(np.uint8).tobytes()


def png_of_size(width: int, height: int) -> bytes:
    """A picture that promises pixels which it doesn't have."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b""))


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


ROOM = np.full((10, 12), 255)
ROOM[4, :8] = 0  # a wall with a way around its right end
ROOM[:, 11] = 205  # unknown


@pytest.fixture
def read(tmp_path):
    """Writes a file of a name that says nothing, and files beside it, and reads it."""

    def load(content: str | bytes, beside: dict[str, str | bytes] | None = None, **options):
        for name, what in {"file": content, **(beside or {})}.items():
            data = what.encode() if isinstance(what, str) else what
            (tmp_path / name).write_bytes(data)
        return mazes.load(tmp_path / "file", options=reading.ReadingConfig(**options))

    return load


def rows(maze: mazes.Maze) -> list[str]:
    return [row for row in parsing.text_of(maze).split("\n") if row.startswith(("#", "D"))]


LEVEL = ["#######", "#.....#", "#..#..#", "#S.#.1#", "#######"]


@pytest.mark.parametrize(
    ("content", "expected", "limit"),
    [
        (JAXUED, LEVEL, 70),
        (MINIMAX, LEVEL, 70),
        ("\ufeff" + JAXUED.replace("\n", "\r\n"), LEVEL, 70),
        (json.dumps({"wall_map": ["0 0 0", "1 1 0"], "goal_pos": [0, 0], "agent_pos": [2, 1]}),
         ["#####", "#1..#", "###S#", "#####"], 40),
        (json.dumps(MAZE_MAP), ["#####", "#S.G#", "##.*#", "#####"], 24),
        (npy(np.array(MAZE_MAP)), ["#####", "#S.G#", "##.*#", "#####"], 24),
        (npy(np.array([[1, 0], [0, 0]])), ["####", "##*#", "#**#", "####"], 24),
        (D4RL, ["#####", "#1SS#", "###S#", "#SSS#", "#####"], 24),
        ("decisions 99\njitter 0.25\n#####\n#S.1#\n#####\n", ["#####", "#S.1#", "#####"], 99),
    ],
)  # fmt: skip
def test_each_kind_is_read_for_what_it_is(read, content, expected, limit):
    maze = read(content)
    assert rows(maze) == expected
    assert maze.num_decisions == limit


def test_several_goals_of_minimax_are_candidates(read):
    maze = read(MINIMAX.replace("(4, 2)", "[(4, 2), (3, 0)]"))
    assert rows(maze)[1:4] == ["#...G.#", "#..#..#", "#S.#.G#"]


def test_a_transposed_list_has_its_columns_as_rows(read):
    assert rows(read(json.dumps(MAZE_MAP), transposed=True)) == [
        "####",
        "#S##",
        "#..#",
        "#G*#",
        "####",
    ]


def test_a_map_takes_start_and_goal_from_the_scenarios_beside_it_or_from_the_command(read):
    assert rows(read(MAP, {"file.scen": SCEN})) == [
        "######",
        "#.S#.#",
        "#.#..#",
        "#1.#.#",
        "######",
    ]
    assert rows(read(MAP, {"file.scen": SCEN}, scenario=1))[1] == "#S.#.#"
    assert rows(read(SCEN, {"a.map": MAP}))[1] == "#.S#.#"
    chosen = read(MAP, {"file.scen": SCEN}, start=(2, 3), goal=(1, 4))
    assert rows(chosen)[1:4] == ["#..#1#", "#.#S.#", "#..#.#"]


def test_pixels_become_cells_and_metres_places(read):
    beside = {"a.pgm": pgm(ROOM)}
    # Cells of two pixels from the lower left; what is unknown is wall, and the box is cut there.
    places = {"places": "metres", "start": (-0.9, -1.1), "goal": (-0.9, -1.9)}
    maze = read(YAML, beside, cell_metres=0.2, **places)
    assert maze.wall.shape == (7, 7)
    assert paths.cells(np.asarray(maze.wall)[1:-1, 1:-1]) == [(2, j) for j in range(4)]
    assert rows(maze)[1][1] == "S" and rows(maze)[5][1] == "1"
    # A robot of 0.15 m keeps away from obstacles and the edge.
    grown = read(YAML, beside, cell_metres=0.1, robot_radius=0.1, places="metres",
                 start=(-0.75, -1.15), goal=(-0.75, -1.85))  # fmt: skip
    assert not np.asarray(grown.wall)[1:-1, 1:-1][:, -1].any()
    assert grown.wall.shape == (10, 11)
    # Unknown as floor, and without metres a pixel is a cell.
    open_map = read(pgm(ROOM), unknown="free", start=(1, 12), goal=(10, 1))
    assert open_map.wall.shape == (12, 14)
    assert not np.asarray(open_map.wall)[1:-1, 12].any()


def test_a_ros_map_may_be_turned_negated_or_raw(read):
    start_and_goal = {"start": (-1.05, -1.95), "goal": (-1.65, -1.95), "places": "metres"}
    turned = YAML.replace("0.0]", f"{math.pi / 2}]")
    maze = read(turned, {"a.pgm": pgm(ROOM)}, cell_metres=0.1, **start_and_goal)
    assert rows(maze)[-2][1] == "S" and rows(maze)[5][1] == "#" and rows(maze)[4][1] == "1"
    negated = read(YAML.replace("negate: 0", "negate: 1"), {"a.pgm": pgm(255 - ROOM)},
                   cell_metres=0.1, start=(1, 1), goal=(10, 1))  # fmt: skip
    raw = read(YAML + "mode: raw\n", {"a.pgm": pgm(np.where(ROOM == 255, 0, 100))},
               cell_metres=0.1, start=(1, 1), goal=(10, 1))  # fmt: skip
    assert (negated.wall == raw.wall).all()


@pytest.mark.parametrize("kind", ["PNG", "PPM", "BMP"])
@pytest.mark.parametrize("mode", ["L", "RGB", "P", "1", "I;16"])
def test_pictures_of_all_modes_say_the_same(read, kind, mode):
    if mode == "I;16":
        if kind == "BMP":
            return
        picture = Image.fromarray(np.where(ROOM == 255, 65535, 0).astype(np.uint16))
    else:
        picture = Image.fromarray(np.where(ROOM == 255, 255, 0).astype(np.uint8))
        picture = picture.convert(mode)
    if kind == "PPM" and mode == "P":
        return
    stream = io.BytesIO()
    picture.save(stream, kind)
    maze = read(stream.getvalue(), start=(1, 1), goal=(10, 1))
    assert maze.wall.shape == (12, 13)
    assert paths.cells(np.asarray(maze.wall)[1:-1, 1:-1]) == [(4, j) for j in range(8)]


MALFORMED = [
    # content, files beside it, options; what the line names
    ("#####\n#S.1#\u2000\n#####\n", {}, {}, "unknown character '\\u2000' at row 2, column 6"),
    ("#####\n#S.1#\x0c#####\n", {}, {}, "unknown character '\\x0c' at row 2, column 6"),
    ("; my maze\n#####\n#S.1#\n#####\n", {}, {}, "unknown character ';' at row 1"),
    ("decisions x\n###\n", {}, {}, "number of rows = 1"),
    ("decisions 4.5\n#####\n#S.1#\n#####\n", {}, {}, "decisions '4.5' is not a whole number"),
    ("decisions 0\n#####\n#S.1#\n#####\n", {}, {}, "num_decisions = 0"),
    ("jitter nan\n#####\n#S.1#\n#####\n", {}, {}, "start_jitter = nan"),
    ("####\n#*.#\n####\n", {}, {}, "the only start, at row 2, column 2, may be the goal"),
    ("#####\n#SG.G\n#####\n", {}, {}, "'G' at row 2, column 5 leaves the outer ring open"),
    ("#####\n#S#G#\n#####\n", {}, {}, "to the candidate at row 2, column 4"),
    (JAXUED.replace(">", "."), {}, {}, "leaves the outer ring open"),
    (JAXUED.replace("G", ">"), {}, {}, "2 agents, a JaxUED level has 1"),
    (JAXUED.replace("#", "G"), {}, {}, "3 goals G, a JaxUED level has 1"),
    (JAXUED.replace("G", "G."), {}, {}, "row 3 has 6 columns, but row 1 has 5"),
    ("..#\n>#G\n", {}, {}, "no way from the start at row 2, column 1 to goal 1 at row 2, column 3"),
    (MINIMAX.replace("(4, 2)", "(2, 2)"), {}, {}, "goal at row 3, column 3 is in a wall"),
    (MINIMAX.replace("(4, 2)", "(5, 2)"), {}, {}, "goal at row 3, column 6 is outside the maze"),
    (MINIMAX.replace("(4, 2)", "(0, 2)"), {}, {}, "start and goal are both at row 3, column 1"),
    (MINIMAX.replace("agent_pos = (0, 2)", ""), {}, {}, "no start"),
    (MINIMAX.replace("goal_pos = (4, 2)", ""), {}, {}, "no goal"),
    ("0 1 0\n0 2 0\nagent_pos = (0, 0)", {}, {}, "unknown cell '2' at row 2, column 2"),
    ('{"wall_map": 3}', {}, {}, "without a list 'wall_map'"),
    ('{"walls": []}', {}, {}, "without a list 'wall_map'"),
    ('{"wall_map": [[[0]]]}', {}, {}, "unknown cell '[0]' at row 1, column 1"),
    ("[[1, 1", {}, {}, "no JSON"),
    ("[[1, 'r']]", {}, {}, "no JSON"),
    ("[" * 100_000, {}, {}, "no JSON"),
    ("[[" + "1" * 5_000 + "]]", {}, {}, "no JSON"),
    ("[]", {}, {}, "a list of lists"),
    ("[[]]", {}, {}, "1 rows of 0 cells"),
    ("[[1, 2]]", {}, {}, "unknown cell '2' at row 1, column 2"),
    ('[[0, "s"]]', {}, {}, "unknown cell 's'"),
    ("[[0, null]]", {}, {}, "unknown cell 'None'"),
    ("[[0, 0], [0]]", {}, {}, "row 2 has 1 columns, but row 1 has 2"),
    ("[[1, 1], [1, 1]]", {}, {}, "no start"),
    ("[[0, 1, 0]]", {}, {}, "no way from the start at row 1, column 1"),
    (json.dumps([[0] * 2100]), {}, {}, "at most 2050"),
    (npy(np.zeros((3, 3, 3))), {}, {}, "shape (3, 3, 3)"),
    (npy(np.zeros((3, 3), complex)), {}, {}, "an array of complex128"),
    (npy(np.array([[0, 0.5]])), {}, {}, "unknown cell '0.5'"),
    (npy(np.array([[None]], dtype=object)), {}, {}, "an array of object"),
    (npy(np.zeros((3, 3)))[:-1], {}, {}, "must be whole"),
    (npy(np.zeros((3, 3)))[:40], {}, {}, "damaged .npy"),
    (npy(np.zeros((3, 3))).replace(b"(3, 3)", b"(9**9,"), {}, {}, "damaged .npy"),
    (D4RL.replace("G", "x"), {}, {}, "unknown character 'x' at row 2, column 2; known are # O 0"),
    (D4RL.replace("O#", "GG#"), {}, {}, "row 2 has 6 columns"),
    (D4RL.replace("O#", "G#"), {}, {}, "goals G, a string of D4RL has at most 1"),
    ("type tile\n" + MAP.partition("\n")[2], {}, {}, "must be 'type octile'"),
    ("type octile\nheight 3\n", {}, {}, "the header of a MovingAI map"),
    (MAP.replace("height 3", "height 4"), {}, {}, "3 rows, but height is 4"),
    (MAP.replace("width 4", "width 5"), {}, {}, "row 1 has 4 columns, but width is 5"),
    (MAP.replace("width 4", "width -4"), {}, {}, "width is '-4'"),
    (MAP.replace("width 4", "width 99999"), {}, {}, "width = 99999 must be"),
    (MAP.replace("T", "x"), {}, {}, "unknown character 'x' at row 2, column 2"),
    (MAP, {}, {}, "no start"),
    (MAP, {"file.scen": SCEN}, {"scenario": 3}, "scenario = 3, but there are 2"),
    (MAP, {"file.scen": SCEN.replace("version 1", "version 2")}, {}, "must be 'version 1'"),
    (MAP, {"file.scen": SCEN.replace("\t4\t3", "\t5\t3")}, {}, "of a map of 3 x 5, but this"),
    (MAP, {"file.scen": SCEN.replace("\t1\t0\t0", "\t2\t0\t0")}, {}, "start at row 1, column 3"),
    (MAP, {"file.scen": SCEN.replace("\t3.5", "")}, {}, "has 8 fields, must have 9"),
    (MAP, {"file.scen": SCEN.replace("\t1\t0", "\tx\t0")}, {}, "scenario with 'x'"),
    (MAP, {"file.scen": "version 1\n"}, {}, "but there are 0"),
    (SCEN, {}, {}, "no such file"),
    (MAP, {}, {"start": (1, 3), "goal": (1, 1)}, "start = 1 3 is in a wall"),
    (MAP, {}, {"start": (1, 1), "goal": (9, 1)}, "goal = 9 1 is outside the maze"),
    (MAP, {}, {"start": (0, 1), "goal": (2, 1)}, "start = 0 1 is in a wall"),
    (MAP, {}, {"start": (math.nan, 1.0)}, "start = nan 1 is outside the maze"),
    (MAP, {}, {"start": (1, 1), "goal": (1, 1)}, "goal = 1 1 is the start"),
    (MAP, {}, {"start": (1, 1), "places": "metres"}, "knows no metres"),
    (MAP, {}, {"start": (1, 1)}, "no goal"),
    ("image: no.pgm\nresolution: 1.0\n", {}, {}, "image 'no.pgm': No such file"),
    (YAML, {"a.pgm": b"text"}, {}, "not a picture in format PNG"),
    (YAML, {"a.pgm": b"GIF89a..."}, {}, "a picture in format GIF"),
    (YAML, {"a.pgm": b"P5\n9 9\n255\n12"}, {}, "a damaged picture"),
    (YAML, {"a.pgm": b""}, {}, "image 'a.pgm': not a picture in format"),
    (YAML, {"a.pgm": pgm(ROOM)}, {"cell_metres": 0.05}, "cell_metres = 0.05 must be at least"),
    (YAML, {"a.pgm": pgm(ROOM * 0)}, {}, "no free cell"),
    (YAML.replace("0.196", "0.8"), {"a.pgm": pgm(ROOM)}, {}, "free_thresh = 0.8 must be at most"),
    (YAML.replace("0.65", "6.5"), {"a.pgm": pgm(ROOM)}, {}, "occupied_thresh = 6.5 must be"),
    (YAML.replace("0.65", "high"), {}, {}, "occupied_thresh = 'high' must be a number"),
    (YAML.replace("n: 0.1", "n: -0.1"), {}, {}, "resolution = -0.1 must be at most 1000.0"),
    (YAML.replace("n: 0.1", "n: .nan"), {}, {}, "resolution = 'nan' must be a number"),
    (YAML.replace("[-1.0, -2.0, 0.0]", "3"), {}, {}, "origin = '3' must be x, y and yaw"),
    (YAML.replace("negate: 0", "negate: [x]"), {}, {}, "negate = \"['x']\" must be 0 or 1"),
    (YAML + "mode: other\n", {}, {}, "mode = 'other' must be one of trinary"),
    (YAML + "x: !!python/object/apply:os.system ['touch pwned']\n", {}, {}, "YAML has a tag"),
    (YAML + "x: !!binary aGk=\n", {}, {}, "YAML has a tag, anchor or alias at line 7"),
    (YAML + "x: &a [1]\ny: *a\n", {}, {}, "YAML has a tag, anchor or alias at line 7"),
    (YAML + "x: [\n", {}, {}, "not YAML"),
    (YAML + "x: 2001-99-99\n", {}, {}, "not YAML of a map"),
    (YAML + "x: " + "[" * 9_000 + "\n", {}, {}, "YAML is nested more than 20 deep"),
    (YAML + "x: " + "a" * 70_000, {}, {}, "YAML of"),
    ("services:\n  web:\n    build: .\n", {}, {}, "the YAML names no image"),
    ("--- 3\n", {}, {}, "the YAML has no fields"),
    (b"GIF89a\x01\x00", {}, {}, "a picture in format GIF, must be PNG"),
    (b"%PDF-1.7", {}, {}, "a picture in format PDF"),
    (png_of_size(100_000, 100_000), {}, {}, "pixels"),
    (png_of_size(10_000, 10_000), {}, {}, "10000 x 10000 pixels, must be at most 16777216"),
    (png_of_size(20, 20), {}, {}, "a damaged picture"),
    (b"P5\n99999999999 99999999999\n255\n", {}, {}, "a damaged picture"),
    (pgm(ROOM), {}, {}, "no start"),
    (pgm(ROOM), {}, {"robot_radius": 0.3}, "robot_radius = 0.3 m needs metres_per_pixel"),
    (pgm(ROOM), {}, {"free": 0.5, "occupied": 0.4}, "free_thresh = 0.5 must be at most"),
    (pgm(ROOM), {}, {"start": (11, 1), "goal": (1, 1)}, "start = 11 1 is"),
    (pgm(np.full((3, 2100), 255)), {}, {}, "3 x 2100 cells, must be at most 2050"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "beside", "options", "line"), MALFORMED, ids=[case[3] for case in MALFORMED]
)
def test_what_is_wrong_is_told_in_one_line(read, tmp_path, content, beside, options, line):
    with pytest.raises(base.UserError) as caught:
        read(content, beside, **options)
    message = str(caught.value)
    assert line in message
    assert message.startswith(str(tmp_path / "file")) or message.startswith("maze '")
    assert "\n" not in message and len(message) < 400
    assert not (tmp_path / "pwned").exists()


@hypothesis.settings(deadline=None, max_examples=40)
@hypothesis.given(
    strategies.integers(0, 10_000),
    strategies.lists(strategies.sampled_from("SG*."), min_size=1, max_size=40),
    strategies.none() | strategies.integers(1, limits.MAX_DECISIONS),
    strategies.floats(0.0, 1.5, exclude_max=True, width=32),
)
def test_what_is_saved_is_loaded_as_it_was(tmp_path_factory, seed, marks, limit, jitter):
    text = generators.random_room(seed, 5, 6)
    if "G" in marks or "*" in marks:
        text = text.replace("D", "#")
    # The room's own starts are marked anew, in turn.
    marked = "".join(marks[i % len(marks)] if c == "S" else c for i, c in enumerate(text))
    try:
        maze = parsing.parse(marked, num_decisions=limit, start_jitter=jitter)
    except base.UserError:
        hypothesis.reject()
    path = tmp_path_factory.mktemp("saved") / "maze.txt"
    mazes.save(path, maze)
    again = mazes.load(path)
    assert all((getattr(again, name) == value).all() for name, value in vars(maze).items())
    with pytest.raises(base.UserError, match="exists"):
        mazes.save(path, maze)


def test_a_map_of_257_cells_is_loaded_in_time(read):
    wall = np.ones((257, 257), int)
    wall[1:-1, 1:-1] = 0
    wall[2:-2:4, 1:-2] = 1
    wall[4:-2:4, 2:-1] = 1
    read(D4RL)  # what the first maze of a process takes isn't meant
    began = time.process_time()
    maze = read(json.dumps(wall.tolist()))
    assert time.process_time() - began < 3.0
    assert maze.wall.shape == (257, 257)
