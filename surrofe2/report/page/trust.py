"""The cache: who answered where and when, the range that was met, audited errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.law.stress_law import SURROGATE, TABLE
from surrofe2.report.comparison_plot import audit_curves, clock_of
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.page.html import chart, figure, grid, missing, paragraph, section, table
from surrofe2.report.page.motion import SOURCES, mesh_picture
from surrofe2.report.page.report_data import ReportData, RunData
from surrofe2.store.fields import RISK_NAME, SOURCE_NAME
from surrofe2.store.run_folder import caches_of

Array = NDArray[np.float64]
_CACHE = (SURROGATE, TABLE)


def fallback_section(seen: ReportData) -> str:
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


def _over_time_and_mesh(run: RunData) -> str:
    fields = run.fields
    assert fields is not None
    source = fields.values[SOURCE_NAME]
    by_rve = ~np.isin(source, _CACHE)
    if not by_rve.any():
        return missing(
            f"{run.name}: at none of the {len(fields.t)} stored times did an element fall back."
        )
    curves = tuple(
        Curve("", fields.t, 100.0 * (source == code).mean(axis=1), words, markers=False, colour=k)
        for k, (code, (words, _)) in enumerate(SOURCES.items())
        if (source == code).any()
    )
    panel = Panel(clock_of(run.run), "elements (%)", curves, zero=True)
    figures = [figure(chart(panel), f"{run.name}: who answered at the stored times")]
    share = by_rve.mean(axis=0)
    figures.append(
        figure(
            mesh_picture(fields, share, 0, ends=(0.0, max(float(share.max()), 1e-9))),
            f"{run.name}: share of the stored times at which an element had a point on RVEs, "
            f"from none (dark) to {100.0 * share.max():.3g} % (bright)",
        )
    )
    return grid(figures)


def range_section(seen: ReportData) -> str:
    """What each run met at any point and step, beside the range of the samples."""
    limits = seen.runs[0].record.recipe.get("range") or {}
    ranges = [*((each.name, each.record.met) for each in seen.runs), ("range of samples", limits)]
    rows = [
        [name, "{:.4g} … {:.4g}".format(*of["stretch"]), f"{of['shear']:.3g}", f"{of['rate']:.3g}"]
        for name, of in ranges
        if {"stretch", "shear", "rate"} <= of.keys()
    ]
    if not rows:
        return section("range", "Range that was met", [missing("No run recorded what it met.")])
    heads = ["met at any point and step", "stretch (1)", "shear (1)", "rate (1/µs)"]
    return section("range", "Range that was met", [table(heads, rows)])


def audit_section(seen: ReportData) -> str:
    """Audited errors with the tolerance, and the risks of the answers."""
    figures, parts = [], []
    for each in seen.runs:
        for cell, cache in caches_of(each.record.cache).items():
            of, audit = f"{each.name}, {cell}" if cell else each.name, cache["audit"]
            if not audit["quantiles"]:
                parts.append(missing(f"{of}: none of the cache's answers was audited."))
                continue
            drawn = tuple(_named(audit_curves(0, audit)))
            panel = Panel(
                "error of the stress (µN/µm)", "answers (%)", drawn, log_x=True, zero=True
            )
            figures.append(figure(chart(panel), f"{of}: audited errors"))
            parts.append(_worst(of, audit, "" if cell else _risks(each)))
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


def _risks(run: RunData) -> str:
    """Least and largest risk of the cache's answers at stored times, in words."""
    known = run.points or (run.fields.values if run.fields is not None else {})
    if not {RISK_NAME, SOURCE_NAME} <= known.keys():
        return ""
    risk = known[RISK_NAME][np.isin(known[SOURCE_NAME], _CACHE) & (known[RISK_NAME] > 0.0)]
    if not risk.size:
        return ""
    return f" The risks of its answers are {risk.min():.2g} to {risk.max():.2g}."


def _worst(of: str, audit: Mapping[str, Any], risks: str) -> str:
    worst = audit["worst"]
    text = f"{of}: {audit['audited']:,} answers audited, {audit['violations']} above the tolerance"
    if audit.get("wrong_at_most") is not None:  # runs of earlier versions do not have it
        share = 100.0 * audit["wrong_at_most"]
        text += f", so with 95 % confidence at most {share:.2g} % of all answers are"
    if not isinstance(worst, Mapping):
        return paragraph(f"{text}.{risks}")
    risk = worst.get("risk")  # runs of earlier versions have a bound instead
    where = "" if risk is None else f", where the risk was {risk:.3g}"
    return paragraph(
        f"{text}; the worst error is {worst['error']:.3g} µN/µm{where} "
        f"(step {worst['step']}, point {worst['point']}).{risks}"
    )
