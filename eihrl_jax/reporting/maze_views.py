"""Mazes shown to a user: their size, places and limits, as text and as a picture."""

import dataclasses
import pathlib

import numpy as np

from eihrl_jax import base, mazes
from eihrl_jax.config import maze as maze_config
from eihrl_jax.config import reading
from eihrl_jax.drawing import figures, layout
from eihrl_jax.evaluation import tables
from eihrl_jax.mazes import files, parsing, paths

_MAX_INCHES = 12.0
"""Longer side of a picture."""


def show(options: maze_config.MazeConfig) -> str:
    """Describes a maze or the mazes of a suite, and writes the files that are asked for.

    Args:
      options: which maze, and what else.

    Returns:
      What is to be printed.

    Raises:
      base.UserError: no such maze, or a file is there already; see also `mazes.load`.
    """
    if options.file in mazes.suites.NAMES:
        if options.save or options.picture:
            raise base.UserError(
                f"{options.file} is a suite; name one of its mazes to save or draw"
            )
        return _suite(options.file)

    named = mazes.suites.find(options.file)
    names = [field.name for field in dataclasses.fields(reading.ReadingConfig)]
    wanted = reading.ReadingConfig(**{name: getattr(options, name) for name in names})
    if named is not None:
        kind, origin = "maze by name", f"{named.origin} ({named.licence})"
        maze = mazes.load(options.file, num_decisions=options.num_decisions, options=wanted)
    else:
        plan = files.read(options.file, wanted)
        kind, origin = plan.kind, "your file"
        maze = files.of_plan(plan, options.file, num_decisions=options.num_decisions)

    _check_new(options.save, options.picture)
    lines = [f"{options.file}: {kind}", f"origin          {origin}", *_facts(maze), ""]
    lines += [parsing.text_of(maze).rstrip("\n")]
    if options.save is not None:
        mazes.save(options.save, maze)
        lines.append(f"written to {options.save}")
    if options.picture is not None:
        _draw(options.picture, maze, pathlib.PurePath(options.file).name)
        lines.append(f"drawn in {options.picture}")
    return "\n".join(lines)


def _check_new(*wanted: pathlib.Path | None) -> None:
    """Checks all files that are to be written before the first one is.

    Raises:
      base.UserError: one is there already, a link as well, is wanted twice, or has no folder.
    """
    files_wanted = [path for path in wanted if path is not None]
    for i, path in enumerate(files_wanted):
        if path.exists() or path.is_symlink() or path in files_wanted[:i]:
            raise base.UserError(f"{path} exists; a maze is written to a new file")
        if not path.parent.is_dir():
            raise base.UserError(f"{path}: there is no folder {path.parent}")


def _facts(maze: mazes.Maze) -> list[str]:
    """Returns what an evaluation goes by, one line each."""
    rows, columns = maze.wall.shape
    door, start = np.asarray(maze.door), np.asarray(maze.start)
    goals = str(int(maze.num_goals))
    if door.any():
        goals += f", goal 1 drawn among {door.sum()}"
    free = int((~np.asarray(maze.wall)).sum())
    return [
        f"size            {rows} x {columns} cells with the outer wall, {free} of them free",
        f"starts          {start.sum()}{_where(start)}",
        f"goals           {goals}{_where(np.asarray(maze.goal) > 0)}",
        f"shortest tour   {paths.longest_tour(maze)} moves, from the worst start",
        f"time limit      {int(maze.num_decisions)} decisions",
    ]


def _where(mask: np.ndarray) -> str:
    """Names the one cell of a mask, and of several none."""
    cells = paths.cells(mask)
    return f", at row {cells[0][0] + 1}, column {cells[0][1] + 1}" if len(cells) == 1 else ""


def _suite(name: str) -> str:
    """Lists the mazes of a suite."""
    named = mazes.suites.mazes(name)
    rows = []
    for label in named:
        maze = mazes.load(label)
        size = " x ".join(str(side) for side in maze.wall.shape)
        rows.append([label, size, str(paths.longest_tour(maze)), str(int(maze.num_decisions))])

    origins = dict.fromkeys(f"{each.origin} ({each.licence})" for each in named.values())
    grid = tables.markdown_grid(["maze", "cells", "shortest tour", "decisions"], rows)
    return "\n".join([f"{name}: {len(named)} mazes", *origins, "", grid])


def _draw(path: pathlib.Path, maze: mazes.Maze, title: str) -> None:
    """Draws the plan of a maze into a new file."""
    sides = np.array(maze.wall.shape)
    height, width = np.clip(_MAX_INCHES * sides / sides.max(), 2.0, None).tolist()
    figure = figures.new(width, height)
    layout.draw(figure.add_subplot(), maze, title=title)
    path.touch(exist_ok=False)  # not before there is a picture to write
    figures.save(figure, path)
