"""Panels of curves and bars as inline SVG, drawn for a width of 360 pixels.

Colours are classes of page.css, which knows light, dark and paper; nothing here has a style of its
own, as the page's policy asks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from surrofe2.report.figures import Curve, Panel

Array = NDArray[np.float64]

WIDTH = 360
_HEIGHT, _TOP, _RIGHT, _BOTTOM, _LETTER = 215.0, 20.0, 12.0, 36.0, 6.6
_DASHES = {"--": "6 3", ":": "1.5 3", "-.": "7 3 1.5 3"}
_COLOURS, _MOST = 6, 700
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_BAR, _ROW = 14, 34


def chart(panel: Panel) -> str:
    """The curves of a panel with axes, its legend below."""
    height = _TOP + _BOTTOM + (_HEIGHT - _TOP - _BOTTOM) * panel.height
    across = _Axis.of([curve.x for curve in panel.curves], panel.log_x)
    low = [np.zeros(1)] if panel.zero else []
    up = _Axis.of([*low, *(curve.y for curve in panel.curves)], panel.log_y, room=0.05)
    left = 10.0 + _LETTER * max(len(label) for _, label in up.ticks)
    right, bottom = WIDTH - _RIGHT, height - _BOTTOM
    across.place(left, right)
    up.place(bottom, _TOP)
    parts = []
    for value, label in across.ticks:
        x = across.at(np.array([value]))[0]
        parts.append(f'<path class="grid" d="M{x:.1f} {_TOP:.0f}V{bottom:.1f}"/>')
        parts.append(_text(x, bottom + 14, label, "middle"))
    for value, label in up.ticks:
        y = up.at(np.array([value]))[0]
        parts.append(f'<path class="grid" d="M{left:.1f} {y:.1f}H{right:.1f}"/>')
        parts.append(_text(left - 4, y + 3.5, label, "end"))
    parts.append(f'<path class="axis" d="M{left:.1f} {_TOP:.0f}V{bottom:.1f}H{right:.1f}"/>')
    parts.append(_text(2, 11, panel.y_label, "start"))
    parts.append(_text(right, bottom + 30, panel.x_label, "end"))
    styles = [_style(curve, k) for k, curve in enumerate(panel.curves)]
    parts += [
        _curve(curve, style, across, up) for curve, style in zip(panel.curves, styles, strict=True)
    ]
    told = ", ".join(dict.fromkeys(c.label for c in panel.curves if c.label))
    title = f"{panel.title or panel.y_label} over {panel.x_label}" + (f": {told}" if told else "")
    drawn = _svg(height, title, "".join(parts))
    return drawn + _legend(
        {c.label: (c, s) for c, s in zip(panel.curves, styles, strict=True) if c.label}
    )


def bars(rows: Sequence[tuple[str, Mapping[str, float]]], unit: str) -> str:
    """A bar for each row, its parts by name one after the other, with their sum."""
    names = list(dict.fromkeys(name for _, parts in rows for name in parts))
    most = max((sum(parts.values()) for _, parts in rows), default=0.0) or 1.0
    drawn = []
    for k, (label, parts) in enumerate(rows):
        y, x = 16 + _ROW * k, 0.0
        drawn.append(_text(0, y - 4, f"{label}: {sum(parts.values()):.3g} {unit}", "start"))
        for name, value in parts.items():
            width = (WIDTH - 2) * value / most
            drawn.append(
                f'<rect class="f{names.index(name) % _COLOURS}" x="{x:.1f}" y="{y}" '
                f'width="{width:.1f}" height="{_BAR}"><title>{escape(name)}: {value:.3g} '
                f"{escape(unit)}</title></rect>"
            )
            x += width
    title = "; ".join(
        f"{label}: " + ", ".join(f"{name} {value:.3g} {unit}" for name, value in parts.items())
        for label, parts in rows
    )
    swatches = "".join(
        f'<li><svg class="swatch" viewBox="0 0 22 8"><rect class="f{k % _COLOURS}" width="22" '
        f'height="8"/></svg>{escape(name)}</li>'
        for k, name in enumerate(names)
    )
    whole = _svg(_ROW * len(rows), title, "".join(drawn))
    return f'{whole}<ul class="legend">{swatches}</ul>'


def plain_label(label: str) -> str:
    """A label without the signs by which figures set formulas."""
    return re.sub(r"\$([^$]*)\$", lambda found: found[1].replace("_", ""), label)


def _svg(height: float, title: str, content: str) -> str:
    told = escape(" ".join(plain_label(title).split()), quote=True)
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="{told}">'
        f"{content}</svg>"
    )


def _text(x: float, y: float, label: str, anchor: str) -> str:
    words = re.sub(r"\$([^$_]*)(?:_([^$]*))?\$", _symbol, escape(" ".join(label.split())))
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{words}</text>'


def _symbol(found: re.Match[str]) -> str:
    """A letter of a formula, with what stands below it."""
    letter = f'<tspan class="symbol">{found[1]}</tspan>'
    if not found[2]:
        return letter
    return f'{letter}<tspan class="index" dy="3">{found[2]}</tspan><tspan dy="-3"> </tspan>'


class _Axis:
    """Where numbers are along an axis, and its ticks."""

    def __init__(self, low: float, high: float, log: bool) -> None:
        self.low, self.high, self._log = low, high, log
        self.ticks = _log_ticks(low, high) if log else _ticks(low, high)

    @classmethod
    def of(cls, found: Sequence[Array], log: bool, room: float = 0.0) -> _Axis:
        """The axis that shows all numbers found, with some room, as a share, on both ends."""
        values = np.concatenate([np.asarray(each, dtype=np.float64) for each in found])
        values = values[np.isfinite(values) & ((values > 0.0) | (not log))]
        values = np.log10(values) if log else values
        low, high = (values.min(), values.max()) if values.size else (0.0, 1.0)
        if high - low <= 1e-12 * max(abs(low), abs(high)):
            low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
        return cls(float(low - room * (high - low)), float(high + room * (high - low)), log)

    def place(self, first: float, last: float) -> None:
        self._first, self._last = first, last

    def at(self, values: Array) -> Array:
        """Pixels; NaN where the axis cannot show a number."""
        values = np.asarray(values, dtype=np.float64)
        if self._log:
            values = np.log10(np.where(values > 0.0, values, np.nan))
        share = (values - self.low) / (self.high - self.low)
        return self._first + share * (self._last - self._first)


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Four to seven round numbers and their words."""
    raw = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * each for each in (1.0, 2.0, 5.0, 10.0) if power * each >= 0.999 * raw)
    values = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    large = max(abs(low), abs(high))
    if not 1e-4 <= large < 1e6:
        return [(float(v), f"{v:.6g}".replace("-", "−")) for v in values]
    places = max(0, -math.floor(math.log10(step) + 1e-9))
    return [(float(v), f"{v:.{places}f}".replace("-", "−")) for v in values + 0.0]


def _log_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Powers of ten, every one or as many apart as fit; where there are none, both ends."""
    powers = range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1)
    apart = max(1, -(-len(powers) // 7))
    found = [(10.0**k, f"10{str(k).translate(_SUPERSCRIPTS)}") for k in powers[::apart]]
    return found or [(10.0**end, f"{10.0**end:.2g}") for end in (low, high)]


def _style(curve: Curve, k: int) -> tuple[str, str]:
    """(class, dash) of a curve."""
    if curve.name in ("reference", "rve", "tissue"):
        return "kr", ""
    number = (k if curve.colour is None else curve.colour) % _COLOURS
    return f"k{number}", _DASHES.get(curve.dash, "")


def _curve(curve: Curve, style: tuple[str, str], across: _Axis, up: _Axis) -> str:
    name, dash = style
    x, y = across.at(curve.x), up.at(curve.y)
    if curve.dash == "none":
        known = np.isfinite(x) & np.isfinite(y)
        dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x[known], y[known], strict=True))
        return f'<path class="dots {name}" d="{dots}"/>'
    if curve.steps:
        base = up.at(np.zeros(1))[0]
        steps = "".join(f"V{b:.1f}H{a:.1f}" for a, b in zip(x[1:], y[1:], strict=True))
        outline = f"M{x[0]:.1f} {base:.1f}{steps}V{base:.1f}"
        return (
            f'<path class="area {name}" d="{outline}Z"/><path class="line {name}" d="{outline}"/>'
        )
    x, y = _thinned(x, y)
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<path class="line {name}"{dashes} d="{_path(x, y)}"/>'


def _path(x: Array, y: Array) -> str:
    """A line through all points, interrupted where one is unknown."""
    words, begins = [], True
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            begins = True
            continue
        words.append(f"{'M' if begins else 'L'}{a:.1f} {b:.1f}")
        begins = False
    return "".join(words)


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """At most 1400 points of a line: of each piece the lowest and the highest."""
    if len(x) <= 2 * _MOST:
        return x, y
    kept = [0, len(x) - 1]
    for piece in np.array_split(np.arange(len(x)), _MOST):
        known = piece[np.isfinite(y[piece])]
        if known.size:
            kept += [int(known[y[known].argmin()]), int(known[y[known].argmax()])]
    chosen = np.unique(kept)
    return x[chosen], y[chosen]


def _legend(found: Mapping[str, tuple[Curve, tuple[str, str]]]) -> str:
    """Swatch and words of every label; of a single curve the words alone."""
    entries = []
    for label, (curve, (name, dash)) in found.items():
        kind = "dots" if curve.dash == "none" else "line"
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        shape = "M11 4h0" if kind == "dots" else "M0 4H22"
        entries.append(
            f'<li><svg class="swatch" viewBox="0 0 22 8"><path class="{kind} {name}"{dashes} '
            f'd="{shape}"/></svg>{escape(plain_label(label))}</li>'
        )
    return f'<ul class="legend">{"".join(entries)}</ul>' if entries else ""
