"""A report as one HTML file that needs nothing else: no network, no other file, no script."""

import base64
import dataclasses
import html
import pathlib
from collections.abc import Sequence

from eihrl_jax.drawing import palette
from eihrl_jax.evaluation import tables as tables_lib
from eihrl_jax.storage import reading, writing

_TYPES = {".png": "image/png", ".gif": "image/gif"}

_GENERATOR = '<meta name="generator" content="eihrl_jax">'
"""By which a page of ours is known."""

_STYLE = f"""
:root {{ color-scheme: light; }}
body {{ margin: 0 auto; max-width: 62rem; padding: 1rem; background: {palette.PAPER};
  color: {palette.INK}; font: 1rem/1.5 "DejaVu Sans", Verdana, sans-serif; }}
h1 {{ font-size: 1.6rem; line-height: 1.2; }}
h2 {{ margin-top: 2.5rem; font-size: 1.2rem; border-bottom: 2px solid {palette.TRAIL}; }}
p, figcaption {{ color: {palette.INK}; max-width: 46rem; }}
table {{ border-collapse: collapse; width: 100%; font-size: clamp(0.62rem, 2.3vw, 0.95rem); }}
caption {{ text-align: left; font-weight: bold; padding: 0.6rem 0 0.3rem; }}
th, td {{ padding: 0.25em 0.4em; text-align: right; vertical-align: top; }}
td {{ white-space: nowrap; }}
th:first-child, td:first-child {{ text-align: left; padding-left: 0; overflow-wrap: anywhere;
  white-space: normal; min-width: 5em; position: sticky; left: 0; background: {palette.PAPER}; }}
table.about td {{ text-align: left; white-space: normal; overflow-wrap: anywhere; }}
.table {{ overflow-x: auto; }}
thead th {{ border-bottom: 1px solid {palette.MUTED}; }}
tbody tr:nth-child(even), tbody tr:nth-child(even) td {{ background: {palette.FLOOR}; }}
tr.published td {{ color: #5C6373; font-style: italic; }}
.pictures {{ display: grid; gap: 1rem; margin-top: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); }}
figure {{ margin: 0; }}
img {{ max-width: 100%; height: auto; display: block; }}
figcaption {{ font-size: 0.85rem; }}
code {{ font-size: 0.85em; overflow-wrap: anywhere; }}
"""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture and what it shows.

    Attributes:
      path: a PNG or GIF file.
      caption: one or two sentences; also what is read out in its place.
    """

    path: pathlib.Path
    caption: str


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of a report.

    Attributes:
      title: its heading.
      text: a paragraph before the rest; empty for none.
      tables: shown one below the other.
      pictures: shown after the tables, side by side where there is room.
    """

    title: str
    text: str = ""
    tables: Sequence[tables_lib.Table] = ()
    pictures: Sequence[Picture] = ()


def write(path: pathlib.Path, title: str, lead: str, sections: Sequence[Section]) -> None:
    """Writes a report.

    Args:
      path: the HTML file.
      title: of the page.
      lead: the paragraph below it.
      sections: what follows.
    """
    body = "\n".join(_section(section) for section in sections)
    # Everything that comes from outside is escaped: names of runs may hold any character.
    writing.write_text(
        path,
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"{_GENERATOR}\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{html.escape(title)}</h1>\n<p>{html.escape(lead)}</p>\n{body}\n</body>\n</html>\n",
    )


def is_ours(path: pathlib.Path) -> bool:
    """Returns whether a file is a page that `write` wrote."""
    with path.open("rb") as file:
        return _GENERATOR.encode("ascii") in file.read(1_000)


def markdown(sections: Sequence[Section]) -> str:
    """Returns the tables of a report as Markdown."""
    return "\n\n".join(table.markdown() for part in sections for table in part.tables) + "\n"


def _section(section: Section) -> str:
    parts = [f"<section>\n<h2>{html.escape(section.title)}</h2>"]
    if section.text:
        parts.append(f"<p>{html.escape(section.text)}</p>")
    parts += [_table(table) for table in section.tables]
    # A grid, so that a phone shows them one below the other.
    if section.pictures:
        figures = "\n".join(_figure(picture) for picture in section.pictures)
        parts.append(f'<div class="pictures">\n{figures}\n</div>')
    return "\n".join([*parts, "</section>"])


def _table(table: tables_lib.Table) -> str:
    head = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in table.header)
    rows = []
    for row in table.rows:
        # The paper's figures look different from those that were measured here.
        kind = ' class="published"' if row[0].startswith("paper") else ""
        # Items of a list stand one below the other: in one line they would be wider than a page.
        items = [";<br>".join(map(html.escape, text.split("; "))) for text in row]
        cells = "".join(f"<td>{item}</td>" for item in items)
        rows.append(f"<tr{kind}>{cells}</tr>")

    kind = ' class="about"' if table.num_words == len(table.header) else ""
    caption, body = html.escape(table.title), "\n".join(rows)
    return (
        # Wider than a phone it moves aside in its place: numbers are not broken.
        f'<div class="table">\n<table{kind}>\n<caption>{caption}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>\n</div>"
    )


def _figure(picture: Picture) -> str:
    # The picture itself stands in the page, which then can be sent and kept as one file.
    data = base64.b64encode(reading.read_bytes(picture.path)).decode()
    kind, caption = _TYPES[picture.path.suffix], html.escape(picture.caption, quote=True)
    return (
        f'<figure>\n<img src="data:{kind};base64,{data}" alt="{caption}">\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )
