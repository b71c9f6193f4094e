"""The HTML shell of a report: one file with its style, its scripts and its data, which asks no network for anything."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from matplotlib import colormaps

import semmap
from tools.report import colours
from tools.report.figures import Drawing, svg, time_axis
from tools.report.pack import BATCH, Blobs, json_element

_SHARED_SCRIPTS = ("base", "cloud", "contour", "matrix", "tables", "plan", "timeline")


def page(title: str, lead: str, *sections: str, script: str, data: Mapping[str, Any], blobs: Blobs) -> str:
    """A whole page; ``lead`` is plain text, ``sections`` are HTML, ``script`` the name of the page's own script.

    Browsers run only the scripts whose hash the page names, and load nothing from anywhere.
    """
    code = "\n".join(asset(f"{name}.js") for name in (*_SHARED_SCRIPTS, script))
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src 'sha256-{digest}'"
    told = {**data, "colours": script_colours(), "scale": colour_scale(), "batch": BATCH}
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{asset('page.css')}</style></head><body>\n"
        f'<header><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p></header>\n'
        "<noscript><p>Plan, clouds and tables of this page are drawn by its own scripts: allow them.</p></noscript>\n"
        + "\n".join(section for section in sections if section)
        + f'\n<footer><p class="note">semmap {escape(semmap.__version__)}</p></footer>\n'
        + json_element(told)
        + f"\n{blobs.html()}\n<script>{code}</script>\n</body></html>\n"
    )


def asset(name: str) -> str:
    """A style or script of the reports."""
    return files("tools.report").joinpath("assets", name).read_text(encoding="utf-8")


def script_colours() -> dict[str, Any]:
    """The colours as the scripts call them."""
    c = colours
    return {
        "ink": c.INK, "faint": c.FAINT, "line": c.LINE, "wall": c.WALL, "band": "#eef1f4", "proven": c.PROVEN,
        "anchor": c.ANCHOR, "branch": c.ORANGE, "contour": c.BLUE, "map_cloud": c.MAP_CLOUD,
        "live_cloud": c.LIVE_CLOUD, "kinds": c.KINDS,
    }  # fmt: skip


def colour_scale(steps: int = 64) -> list[list[int]]:
    """The scale of numbers as red, green and blue from 0 to 255."""
    return [[round(255 * value) for value in colormaps[colours.SCALE](k / (steps - 1))[:3]] for k in range(steps)]


def section(title: str, *parts: str) -> str:
    """A titled section, empty where all its parts are."""
    inside = "\n".join(part for part in parts if part)
    return f"<section><h2>{escape(title)}</h2>\n{inside}\n</section>" if inside else ""


def note(text: str) -> str:
    """A small paragraph of plain text."""
    return f'<p class="note">{escape(text)}</p>'


def place(id: str, kind: str = "") -> str:
    """Where a script puts something."""
    return f'<div id="{escape(id)}" class="{escape(kind)}"></div>' if kind else f'<div id="{escape(id)}"></div>'


def figure(drawing: Drawing) -> str:
    """A drawing with its caption; one over time says where its time axis is, for the page's time cursor."""
    graphic = svg(drawing.figure)
    below = f"<figcaption>{escape(drawing.caption)}</figcaption>" if drawing.caption else ""
    axis = " ".join(f"{value:.6g}" for value in time_axis(drawing.figure)) if drawing.over_time else ""
    data = f' data-time-axis="{axis}"' if axis else ""
    return f'<figure id="{escape(drawing.name)}"><div class="wide"{data}>{graphic}</div>{below}</figure>'


def facts(values: Mapping[str, str]) -> str:
    """Headline figures as small cards."""
    cards = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in values.items())
    return f'<dl class="facts">{cards}</dl>' if cards else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Sequence[str] = ()) -> str:
    """A table of plain text; the columns named in ``text`` stand left. Empty where there is no row."""
    kind = [' class="text"' if name in text else "" for name in head]
    body = "".join(
        "<tr>" + "".join(f"<td{k}>{escape(cell)}</td>" for k, cell in zip(kind, row, strict=True)) + "</tr>\n"
        for row in rows
    )
    if not body:
        return ""
    top = "".join(f'<th scope="col"{k}>{escape(name)}</th>' for k, name in zip(kind, head, strict=True))
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>\n{body}</tbody></table></div>'


def folded(title: str, text: str) -> str:
    """Preformatted plain text behind a title to click."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
