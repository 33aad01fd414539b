"""Elements of a page, charts among them."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from matplotlib.figure import Figure

from surrofe2.base.units import number
from surrofe2.report.tables import Table
from surrofe2.run.charts import PALETTE, Panel, draw_panels, encoded

_BAR_ROW, _AXIS, _LEGEND_ROW = 0.6, 0.8, 0.25
"""Inches."""


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


def bars(rows: Sequence[tuple[str, Mapping[str, float]]], unit: str) -> str:
    """A bar for each row, its parts by name one after the other, with their sum."""
    names = list(dict.fromkeys(name for _, parts in rows for name in parts))
    legend = _LEGEND_ROW * -(-len(names) // 3)
    size = 4.6, _BAR_ROW * len(rows) + _AXIS + legend
    drawn = Figure(figsize=size, layout="constrained")
    axes = drawn.subplots()
    for k, (label, parts) in enumerate(rows):
        left = 0.0
        axes.text(0.0, k - 0.36, f"{label}: {number(sum(parts.values()))} {unit}", fontsize=9)
        for name, value in parts.items():
            colour = PALETTE[names.index(name) % len(PALETTE)]
            axes.barh(k, value, left=left, height=0.5, color=colour, label=name)
            left += value
    axes.set_yticks([])
    axes.set_ylim(len(rows) - 0.5, -0.85)
    axes.set_xlabel(f"time ({unit})")
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    drawn.legend(handles.values(), handles, loc="outside lower center", ncols=3, frameon=False)
    alternative = "; ".join(
        f"{label}: " + ", ".join(f"{name} {number(value)} {unit}" for name, value in parts.items())
        for label, parts in rows
    )
    return image(encoded(drawn), alternative)


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
