"""Charts of the page: panels of curves and bars as SVG pictures, drawn as all figures are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from surrofe2.report.figures import PALETTE, Panel, drawn, make_figure
from surrofe2.report.page.html import image

_BAR_ROW, _AXIS, _LEGEND_ROW = 0.6, 0.8, 0.25
"""Inches."""


def chart(panel: Panel) -> str:
    """The curves of a panel with its axes and legend."""
    named = ", ".join(dict.fromkeys(curve.label for curve in panel.curves if curve.label))
    what = f"{panel.title or panel.y_label} over {panel.x_label}"
    return image(drawn(make_figure([panel]), "svg"), f"{what}: {named}" if named else what)


def bars(rows: Sequence[tuple[str, Mapping[str, float]]], unit: str) -> str:
    """A bar for each row, its parts by name one after the other, with their sum."""
    names = list(dict.fromkeys(name for _, parts in rows for name in parts))
    legend = _LEGEND_ROW * -(-len(names) // 3)
    figure = make_figure([], (4.6, _BAR_ROW * len(rows) + _AXIS + legend))
    axes = figure.subplots()
    for k, (label, parts) in enumerate(rows):
        left = 0.0
        axes.text(0.0, k - 0.36, f"{label}: {sum(parts.values()):.3g} {unit}", fontsize=9)
        for name, value in parts.items():
            colour = PALETTE[names.index(name) % len(PALETTE)]
            axes.barh(k, value, left=left, height=0.5, color=colour, label=name)
            left += value
    axes.set_yticks([])
    axes.set_ylim(len(rows) - 0.5, -0.85)
    axes.set_xlabel(unit)
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=3, frameon=False)
    told = "; ".join(
        f"{label}: " + ", ".join(f"{name} {value:.3g} {unit}" for name, value in parts.items())
        for label, parts in rows
    )
    return image(drawn(figure, "svg"), told)
