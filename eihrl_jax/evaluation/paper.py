"""Success rates that the paper published, in per cent with their plus-minus."""

Figure = tuple[float, float] | str
"""Mean and plus-minus; or what the paper says instead, like "≤ 1"."""

TABLE1 = {
    "full": {"random": (51.8, 4.4), "g1": (45.6, 5.2), "g2": (27.8, 6.7), "g3": (73.6, 4.6)},
    "oracle": {"random": (66.4, 5.4), "g1": (72.0, 6.3), "g2": (58.4, 8.3), "g3": (84.8, 6.6)},
}
"""Zero-shot success of the paper's method by movement and maze."""

HIGL_TABLE1: dict[str, Figure] = {"random": (25.4, 5.3), "g1": "≤ 1", "g2": "≤ 1", "g3": "≤ 1"}
"""The same of HIGL, by maze."""

TABLE2: dict[str, Figure] = {
    "ant": (99.6, 0.5),
    "point": (53.2, 1.4),
    "swimmer": (47.0, 2.4),
    "humanoid": (48.2, 1.3),
}
"""Zero-shot success with oracle movement in the U-shaped maze, by robot."""

HIGL_TABLE2: dict[str, Figure] = {"ant": (67.0, 5.2)}
"""The same of HIGL."""

NAMES = {"full": "Ours", "oracle": "Ours-Oracle"}
"""What the paper calls its method, by movement."""

RAND_H = "RAND-H"
"""What the paper calls uniform directions."""


def percent(figure: Figure | None) -> str:
    """Writes a figure, or a dash where the paper has none: "66.4 ± 5.4"."""
    if figure is None:
        return "-"
    return figure if isinstance(figure, str) else f"{figure[0]:.1f} ± {figure[1]:.1f}"
