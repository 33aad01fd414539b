"""The cache: who answered where and when, visited states and the domain, audited errors."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.fields import BOUND_NAME, F_DOT_NAME, F_NAME, SOURCE_NAME
from surrofe2.io.run_folder import caches_of
from surrofe2.report.comparison_plot import audit_curves, clock_of
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.page.colours import SOURCES
from surrofe2.report.page.html import figure, grid, missing, paragraph, section, table
from surrofe2.report.page.motion import mesh_picture
from surrofe2.report.page.seen import Seen, SeenRun
from surrofe2.report.page.svg import chart
from surrofe2.stress_law import TABLE
from surrofe2.surrogate.domain import SUMS, Domain
from surrofe2.tensors import INPUTS, to_inputs

Array = NDArray[np.float64]

NAMES = ("U₁₁ + U₂₂ − 2", "U₁₁ − U₂₂", "2 U₁₂", "A₁₁ + A₂₂", "A₁₁ − A₂₂", "A₁₂ + A₂₁", "A₂₁ − A₁₂")
_PLANES = ((0, 1), (1, 2), (2, 5), (3, 4))
_DOTS = (0, 1, 3, 4)
_MOST_STATES, _FEW_CELLS = 1500, 12_000


def fallback_section(seen: Seen) -> str:
    """Where and when the cache fell back on true RVEs."""
    parts: list[str] = []
    for each in seen.runs:
        for cell, cache in caches_of(each.record.cache).items():
            of = f"{each.name}, {cell}" if cell else each.name
            parts.append(paragraph(f"{of}: {_counted(cache['accepted'])}"))
            parts += [
                paragraph(f"{of}, step {event['step']}: {event['finding']}.")
                for event in cache["trust"]["events"]
            ]
        if each.fields is not None and SOURCE_NAME in each.fields.values:
            parts.append(_over_time_and_mesh(each))
    if not parts:
        parts = [missing("No run through a cache, so nothing fell back.")]
    return section("fallback", "Where the cache fell back", parts)


def _counted(accepted: Mapping[str, int]) -> str:
    hits, fallbacks = accepted["hits"], accepted["fallbacks"]
    reasons = [
        f"{n:,} {name.removeprefix('fallbacks_').replace('_', ' ')}"
        for name, n in accepted.items()
        if name.startswith("fallbacks_") and n
    ]
    why = f" ({', '.join(reasons)})" if reasons else ""
    return (
        f"{hits:,} answers of kept steps came from the cache, {fallbacks:,} from true RVEs{why}, "
        f"{100.0 * fallbacks / max(hits + fallbacks, 1):.3g} %."
    )


def _over_time_and_mesh(run: SeenRun) -> str:
    fields = run.fields
    assert fields is not None
    source = fields.values[SOURCE_NAME]
    if (source <= TABLE).all():
        return missing(
            f"{run.name}: at none of the {len(fields.t)} stored times did an element fall back."
        )
    curves = tuple(
        Curve("", fields.t, 100.0 * (source == code).mean(axis=1), words, markers=False, colour=k)
        for k, (code, (words, _)) in enumerate(SOURCES.items())
        if (source == code).any()
    )
    panel = Panel(clock_of(run.run), "elements (%)", curves, zero=True)
    found = [figure(chart(panel), f"{run.name}: who answered at the stored times")]
    if len(fields.cells) <= _FEW_CELLS:
        share = (source > TABLE).mean(axis=0)
        drawn = mesh_picture(fields, share, 0, ends=(0.0, max(float(share.max()), 1e-9)))
        found.append(
            figure(
                drawn,
                f"{run.name}: share of the stored times at which an element had a point on true "
                f"RVEs, from none (dark) to {100.0 * share.max():.3g} % (bright)",
            )
        )
    return grid(found)


def states_section(seen: Seen) -> str:
    """Visited (U, RᵀḞ) in planes, with the surrogate's domain and the recipe's range."""
    states = {each.name: found for each in seen.runs if (found := _states(each)) is not None}
    parts = [
        missing(f"{each.name}: neither points nor fields of elements, so no states are shown.")
        for each in seen.runs
        if each.name not in states
    ]
    domain = next((each.domain for each in seen.runs if each.domain is not None), None)
    if domain is None:
        parts.append(missing("No surrogate's file was found beside a run, so no domain is drawn."))
    limits = seen.runs[0].record.recipe.get("range") or {}
    if states:
        figures = []
        for i, j in _PLANES:
            curves = _domain_curves(domain, i, j) + _range_curves(limits, i, j)
            curves += [
                Curve("", x[:, i], x[:, j], name, colour=_DOTS[k % len(_DOTS)], dash="none")
                for k, (name, x) in enumerate(states.items())
            ]
            panel = Panel(f"{NAMES[i]}{_unit(i)}", f"{NAMES[j]}{_unit(j)}", tuple(curves))
            figures.append(figure(chart(panel), f"{NAMES[j]} over {NAMES[i]}"))
        parts.append(
            paragraph(
                "Each dot is a point of the stress law, or the mean of an element, at a stored "
                "time; F = R U and A = RᵀḞ. Beyond the line of the domain the cache falls back. "
                "The domain has more dimensions than a plane: a dot within the line may still be "
                "outside."
            )
        )
        parts.append(grid(figures))
    parts.append(_met(seen))
    return section("states", "Visited states and the domain", parts)


def _unit(k: int) -> str:
    return " (1)" if k < 3 else " (1/µs)"


def _states(run: SeenRun) -> Array | None:
    """(n, 7) inputs that the run met at stored times, at most `_MOST_STATES`."""
    known = run.points or (run.fields.values if run.fields is not None else {})
    if not {F_NAME, F_DOT_NAME} <= known.keys():
        return None
    F, F_dot = (known[name].reshape(-1, 2, 2) for name in (F_NAME, F_DOT_NAME))
    every = max(1, len(F) // _MOST_STATES)
    return to_inputs(F[::every], F_dot[::every])[0]


def _domain_curves(domain: Domain | None, i: int, j: int) -> list[Curve]:
    if domain is None:
        return []
    outlines = domain_outlines(domain, i, j)
    return [
        Curve("", x, y, "" if k else "domain", markers=False, colour=2)
        for k, (x, y) in enumerate(outline.T for outline in outlines)
    ]


def domain_outlines(domain: Domain, i: int, j: int) -> list[Array]:
    """Closed lines (m, 2) around what the half-spaces of two inputs alone allow of these.

    Where features are moduli, this is found where both are positive, and mirrored.
    """
    folded = [domain.square and k not in SUMS for k in (i, j)]
    reach = 3.0
    corners = [[0.0 if fold else -reach, reach] for fold in folded]
    (x0, x1), (y0, y1) = corners
    outline = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    for pair, signs, limit in zip(domain.pairs, domain.signs, domain.limits, strict=True):
        used = [int(k) for k, sign in zip(pair, signs, strict=True) if sign]
        if used and set(used) <= {i, j}:
            normal = np.zeros(2)
            for k, sign in zip(pair, signs, strict=True):
                normal[0 if k == i else 1] += sign if k in (i, j) else 0.0
            outline = _clipped(outline, normal, float(limit))
    outline = np.vstack([outline, outline[:1]]) * domain.scale[[i, j]]
    mirrors = [
        np.array([a, b]) for a in (1.0, -1.0)[: 1 + folded[0]] for b in (1.0, -1.0)[: 1 + folded[1]]
    ]
    return [_without_seams(mirror * outline, folded) for mirror in mirrors]


def _without_seams(outline: Array, folded: list[bool]) -> Array:
    """With gaps along the axes at which an outline was mirrored."""
    words = [outline[0]]
    for a, b in pairwise(outline):
        seam = any(fold and a[k] == 0.0 == b[k] for k, fold in enumerate(folded))
        words += [np.full(2, np.nan), b] if seam else [b]
    return np.array(words)


def _clipped(outline: Array, normal: Array, limit: float) -> Array:
    """The part (m, 2) of a convex outline where normal · x ≤ limit."""
    found = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        over_a, over_b = normal @ a - limit, normal @ b - limit
        if over_a <= 0.0:
            found.append(a)
        if over_a * over_b < 0.0:
            found.append(a + over_a / (over_a - over_b) * (b - a))
    return np.array(found) if found else outline[:1]


def _range_curves(limits: Mapping[str, Any], i: int, j: int) -> list[Curve]:
    """The recipe's range as a box of U₁₂ and Ḟ, a diamond of U₁₁ and U₂₂."""
    if not {"stretch", "shear", "rate"} <= limits.keys():
        return []
    low, high = np.array(limits["stretch"]) - 1.0
    shear, rate = (float(limits[name]) for name in ("shear", "rate"))
    if (i, j) == (0, 1):
        corners = [(low, low), (high, low), (high, high), (low, high)]
        outline = np.array([(a + b, a - b) for a, b in corners])
    else:
        widths = [high - low, high - low, 2.0 * shear, *[2.0 * rate] * 4]
        assert len(widths) == INPUTS
        a, b = widths[i], widths[j]
        outline = np.array([(-a, -b), (a, -b), (a, b), (-a, b)])
        if (i, j) == (3, 4):
            outline = np.array([(a, 0.0), (0.0, b), (-a, 0.0), (0.0, -b)])
    x, y = np.vstack([outline, outline[:1]]).T
    return [Curve("", x, y, "range of samples", markers=False, colour=5, dash="--")]


def _met(seen: Seen) -> str:
    """What each run met at any point and step, as a recipe's range would state it."""
    rows = []
    for each in seen.runs:
        met = each.record.met
        if {"stretch", "shear", "rate"} <= met.keys():
            low, high = met["stretch"]
            rows.append(
                [each.name, f"{low:.4g} … {high:.4g}", f"{met['shear']:.3g}", f"{met['rate']:.3g}"]
            )
    limits = seen.runs[0].record.recipe.get("range") or {}
    if {"stretch", "shear", "rate"} <= limits.keys():
        low, high = limits["stretch"]
        rows.append(
            [
                "range of samples",
                f"{low:.4g} … {high:.4g}",
                f"{limits['shear']:.3g}",
                f"{limits['rate']:.3g}",
            ]
        )
    if not rows:
        return ""
    return table(["met at any point and step", "stretch (1)", "shear (1)", "rate (1/µs)"], rows)


def audit_section(seen: Seen) -> str:
    """Audited errors with the tolerance, and the bounds of the answers."""
    figures, parts = [], []
    for each in seen.runs:
        for cell, cache in caches_of(each.record.cache).items():
            of, audit = f"{each.name}, {cell}" if cell else each.name, cache["audit"]
            if not audit["quantiles"]:
                parts.append(missing(f"{of}: none of the cache's answers was audited."))
                continue
            drawn = _named(audit_curves(0, audit))
            bounds = [] if cell else _bound_curves(each, float(drawn[0].y.max()))
            panel = Panel(
                "error or bound of the stress (µN/µm)",
                "answers (%)",
                (*drawn, *bounds),
                log_x=True,
                zero=True,
            )
            figures.append(figure(chart(panel), f"{of}: audited errors and bounds of the answers"))
            parts.append(_worst(of, audit))
    if not figures and not parts:
        parts = [missing("No run through a cache, so nothing was audited.")]
    return section("audit", "Audits", [*parts, grid(figures)])


def _named(curves: list[Curve]) -> list[Curve]:
    """The curves of an audit with words for each: of errors, 99 % of them, the tolerance."""
    words = ("audited errors", "99 % are below", curves[2].label if len(curves) > 2 else "")
    return [
        Curve(c.name, c.x, c.y, word, False, c.colour, c.dash, c.steps)
        for c, word in zip(curves, words, strict=False)
    ]


def _bound_curves(run: SeenRun, high: float) -> list[Curve]:
    """Least and largest bound of the error of the cache's answers at stored times."""
    known = run.points or (run.fields.values if run.fields is not None else {})
    if not {BOUND_NAME, SOURCE_NAME} <= known.keys():
        return []
    bound = known[BOUND_NAME][(known[SOURCE_NAME] <= TABLE) & (known[BOUND_NAME] > 0.0)]
    bound = bound[np.isfinite(bound)]
    if not bound.size:
        return []
    least, most = float(bound.min()), float(bound.max())
    x, gap = np.array([least, least, most, most]), np.array([0.0, high, high, 0.0])
    return [Curve("", x, gap, "least and largest bound", markers=False, colour=1, dash="-.")]


def _worst(of: str, audit: Mapping[str, Any]) -> str:
    worst = audit["worst"]
    text = f"{of}: {audit['audited']:,} answers audited, {audit['violations']} above the tolerance"
    if not isinstance(worst, Mapping):
        return paragraph(f"{text}.")
    return paragraph(
        f"{text}; the worst error is {worst['error']:.3g} µN/µm, where the bound was "
        f"{worst['bound']:.3g} µN/µm (step {worst['step']}, point {worst['point']})."
    )
