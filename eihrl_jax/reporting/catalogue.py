"""What is shipped, by name: policies, robots, mazes and suites, as tables."""

import re
from collections.abc import Callable

from eihrl_jax import mazes, robots
from eihrl_jax.config import catalogue
from eihrl_jax.evaluation import tables
from eihrl_jax.mazes import suites
from eihrl_jax.robots import files as robot_files
from eihrl_jax.runs import policies


def listed(config: catalogue.ListConfig) -> list[tables.Table]:
    """Returns a table for each kind that is asked for."""
    makers: dict[catalogue.Part, Callable[[], tables.Table]] = {
        "policies": _policies,
        "robots": _robots,
        "mazes": _mazes,
        "suites": _suites,
    }
    return [makers[part]() for part in config.what]


def _policies() -> tables.Table:
    """Lists policies; those that differ in their seed alone share a row."""
    groups: dict[str, list[str]] = {}
    rows: dict[str, list[str]] = {}
    for kind in ("high", "low", "baseline"):
        for name in policies.shipped(kind):
            group = f"{kind} {re.sub(r'[0-9]+$', '', name)}"
            groups.setdefault(group, []).append(name)
            rows.setdefault(group, [kind, *_about(name, kind)])

    body = []
    for group, names in groups.items():
        label = names[0] if len(names) == 1 else f"{names[0]} to {names[-1].rpartition('-')[2]}"
        body.append([label, *rows[group]])
    header = ["name", "level", "robot", "trained in", "description"]
    return tables.Table("policies", header, body, num_words=len(header))


def _about(name: str, kind: policies.Kind) -> list[str]:
    """Returns robot, maze and nature of a policy."""
    meta = policies.read_meta(policies.PRETRAINED / name / kind)
    robot, maze = str(meta.get("robot", "-")), str(meta.get("maze", "-"))
    if kind == "low":
        return [robot, "the plane", f"DroQ, {meta.get('num_updates', 0):,} updates"]
    if kind == "baseline":
        return [robot, maze, f"baseline {meta.get('method', '-')}"]
    reward = meta.get("config", {}).get("reward", "-")
    sees = {"search": "searches a map of what it has seen", "patch": "sees a patch around it"}
    network = meta.get("network", {}).get("kind", "patch")
    return ["any", maze, f"{sees.get(network, network)}; {reward} reward"]


def _robots() -> tables.Table:
    """Lists robots."""
    lows = policies.shipped("low")
    body = [
        [
            name,
            robot_files.DESCRIPTIONS[name],
            "shipped" if name in lows else "to be trained",
            f"{robots.load(name).cell:g}",
        ]
        for name in robots.NAMES
    ]
    header = ["name", "description", "low level", "cell, m"]
    return tables.Table("robots", header, body, num_words=3)


def _mazes() -> tables.Table:
    """Lists the paper's mazes."""
    body = []
    for name in mazes.NAMES:
        maze = mazes.load(name, on_host=True)
        rows, columns = maze.wall.shape
        numbers = [f"{rows} x {columns}", str(int(maze.num_goals)), str(int(maze.num_decisions))]
        body.append([name, tables.TABLE1_MAZES.get(name, "-"), *numbers])
    return tables.Table(
        "mazes of the paper",
        ["name", "in Table 1", "cells", "goals", "decisions"],
        body,
        num_words=2,
    )


def _suites() -> tables.Table:
    """Lists suites of mazes."""
    body = []
    for name in suites.NAMES:
        named = suites.mazes(name)
        plans = [maze.text.split() for maze in named.values()]
        sides = sorted({(len(rows), len(rows[0])) for rows in plans})
        size = f"{sides[0][0]} x {sides[0][1]}"
        if len(sides) > 1:
            size += f" to {sides[-1][0]} x {sides[-1][1]}"
        first = next(iter(named))
        origin = next(iter(named.values())).origin.partition(", ")[0]
        body.append([name, first, origin, str(len(named)), size])
    return tables.Table(
        "suites, whose name stands for all their mazes",
        ["name", "the first one", "origin", "mazes", "cells"],
        body,
        num_words=3,
    )
