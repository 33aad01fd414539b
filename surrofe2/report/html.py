"""Elements of a page, charts among them."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape
from typing import Any

from surrofe2.report.tables import Table
from surrofe2.run.charts import Panel, draw_panels, encoded


def paragraph(text: str, kind: str = "") -> str:
    """A sentence or more."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def missing(text: str) -> str:
    """What is left out, and why."""
    return paragraph(text, "missing")


def image(picture: bytes, words: str, form: str = "svg+xml") -> str:
    """A picture, SVG or "png"; its words for those who do not see it."""
    alternative = re.sub(
        r"\$([^$]*)\$", lambda symbol: symbol[1].replace("_", ""), " ".join(words.split())
    )
    source = f"data:image/{form};base64,{base64.b64encode(picture).decode()}"
    return f'<img class="chart" alt="{escape(alternative, quote=True)}" src="{source}">'


def chart(panel: Panel) -> str:
    """The curves of a panel with its axes and legend."""
    named = ", ".join(dict.fromkeys(curve.label for curve in panel.curves if curve.label))
    what = f"{panel.title or panel.y_label} over {panel.x_label}"
    return image(encoded(draw_panels([panel])), f"{what}: {named}" if named else what)


def figure(content: str, caption: str) -> str:
    """A picture with its caption."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def grid(figures: Sequence[str]) -> str:
    """Figures beside each other where there is room."""
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""


def section(key: str, heading: str, parts: Sequence[str]) -> str:
    """A section by its key in the address."""
    return f'<section id="{key}"><h2>{escape(heading)}</h2>{"".join(parts)}</section>'


def folded(summary: str, content: str) -> str:
    """What is shown when asked for."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"


def table(headings: Sequence[str], rows: Sequence[Sequence[Any]], *, words: bool = False) -> str:
    """A table that scrolls by itself where it is wider than the page; words: of text, wrapped."""
    head = "".join(f'<th scope="col">{escape(str(each))}</th>' for each in headings)
    body = "".join(
        f'<tr><th scope="row">{escape(str(name))}</th>'
        + "".join(f"<td>{escape(str(value))}</td>" for value in values)
        + "</tr>"
        for name, *values in rows
    )
    kind = "wide words" if words else "wide"
    return (
        f'<div class="{kind}" tabindex="0"><table><thead><tr>'
        f"{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def table_of(quantities: Table[Any]) -> str:
    """What people are shown of a table."""
    return table(*quantities.for_people())
