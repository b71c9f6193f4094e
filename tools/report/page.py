"""The HTML shell of a report: sections, figures, tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import semmap

STYLE = """
:root { --ink: #1b1f24; --faint: #5f6b76; --line: #d9dee3; --band: #f5f7f9; }
body { font: 15px/1.5 system-ui, "Segoe UI", "Noto Sans", sans-serif; color: var(--ink); background: #fff;
       margin: 0 auto; padding: 1.5rem 1.25rem 4rem; max-width: 68rem; }
h1 { font-size: 1.6rem; margin: 0 0 .2rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid var(--line);
     padding-bottom: .25rem; }
p.lead { color: var(--faint); margin: 0 0 1rem; }
p.note { color: var(--faint); font-size: .9rem; margin: .4rem 0; }
figure { margin: .8rem 0; }
figure svg { width: 100%; height: auto; display: block; }
figure.narrow { max-width: 38rem; }
figcaption { color: var(--faint); font-size: .9rem; }
.scroll { overflow-x: auto; max-height: 36rem; overflow-y: auto; border: 1px solid var(--line);
           border-radius: 4px; }
table { border-collapse: collapse; font-size: .88rem; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .6rem; text-align: right; border-bottom: 1px solid var(--line);
         white-space: nowrap; }
th { position: sticky; top: 0; background: var(--band); font-weight: 600; }
th:first-child, td:first-child, .text { text-align: left; }
td.text { white-space: normal; min-width: 11rem; }
tr:last-child td { border-bottom: 0; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(9.5rem, 1fr)); gap: .7rem;
     margin: 1rem 0; }
dl div { background: var(--band); border-radius: 4px; padding: .5rem .7rem; }
dt { color: var(--faint); font-size: .82rem; } dd { margin: 0; font-size: 1.15rem; font-weight: 600; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(8.5rem, 1fr)); gap: .6rem; }
.grid figure { margin: 0; text-align: center; }
pre { background: var(--band); padding: .8rem; overflow-x: auto; font-size: .82rem; border-radius: 4px; }
summary { cursor: pointer; color: var(--faint); }
"""


def page(title: str, lead: str, *sections: str) -> str:
    """A whole page; ``lead`` is plain text, ``sections`` are HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>\n"
        f'<h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>\n'
        + "\n".join(section for section in sections if section)
        + f'\n<p class="note">semmap {escape(semmap.__version__)}</p></body></html>\n'
    )


def section(title: str, *parts: str) -> str:
    """A titled section, empty where all its parts are."""
    inside = "\n".join(part for part in parts if part)
    return f"<section><h2>{escape(title)}</h2>\n{inside}\n</section>" if inside else ""


def note(text: str) -> str:
    """A small paragraph of plain text."""
    return f'<p class="note">{escape(text)}</p>'


def figure(graphic: str, caption: str = "", *, narrow: bool = False) -> str:
    """An inline graphic with its caption."""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    kind = ' class="narrow"' if narrow else ""
    return f"<figure{kind}>{graphic}{below}</figure>"


def facts(values: Mapping[str, str]) -> str:
    """Headline figures as small cards."""
    cards = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in values.items())
    return f"<dl>{cards}</dl>" if cards else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Sequence[str] = ()) -> str:
    """A table of plain text; the columns named in ``text`` stand left. Empty where there is no row."""
    kind = ['class="text"' if name in text else "" for name in head]
    body = "".join(
        "<tr>" + "".join(f"<td {k}>{escape(cell)}</td>" for k, cell in zip(kind, row, strict=True)) + "</tr>\n"
        for row in rows
    )
    if not body:
        return ""
    top = "".join(f"<th {k}>{escape(name)}</th>" for k, name in zip(kind, head, strict=True))
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>\n{body}</tbody></table></div>'


def folded(title: str, text: str) -> str:
    """Preformatted plain text behind a title to click."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
