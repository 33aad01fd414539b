"""Runs, samples and laws as a notebook shows them: what they are, in a table, and a curve."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache import CachedLaw
from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.io.run_folder import StoredRun, presets_of
from surrofe2.macro.simulation import MacroRun
from surrofe2.plant_cell.parameters import PRESETS, CellParameters
from surrofe2.regional_law import RegionalLaw
from surrofe2.rve import RveLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import SurrogateLaw
from surrofe2.tissue.history import TissueRun

Rows = Mapping[str, object]

_WIDTH, _HEIGHT = 320.0, 90.0


def html(shown: object) -> str:
    """A result as HTML: its facts, and of a run the watched displacement over time."""
    curve = shown.curve if isinstance(shown, MacroRun | TissueRun | StoredRun) else None
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(str(value))}</td></tr>'
        for name, value in facts(shown).items()
    )
    head = f"<strong>{escape(shown.__class__.__name__)}</strong>"
    return f"<div>{head}<table>{rows}</table>{'' if curve is None else _drawn(curve)}</div>"


def facts(shown: object) -> Rows:
    """What matters of a result, by name."""
    match shown:
        case MacroRun():
            return {
                "law": shown.law,
                "mesh": f"{len(shown.elements)} elements, {len(shown.nodes)} nodes",
                **_course(shown.curve, shown.wall_time, shown.counts),
                "finished": "yes" if shown.finished else "no",
            }
        case TissueRun():
            return {
                "particles": f"{shown.counts['particles']:,}",
                **_course(shown.curve, shown.wall_time, shown.counts),
                "finished": "yes" if shown.finished else "no",
            }
        case StoredRun():
            record = shown.record
            return {
                "folder": shown.folder,
                "law": f"{record.law}, {record.initialisation}",
                "plant cell": presets_of(record.recipe),
                **_course(shown.curve, record.wall_time, record.counts),
                "RVE solves": f"{record.counts.get('rve_solves', 0):,}",
            }
        case StressSamples():
            return _of_samples(shown)
        case SurrogateLaw():
            return {
                "plant cell": _cell(shown.cell),
                "initialisation": shown.initialisation,
                "range": shown.range,
                "bound of its error": "calibrated" if shown.is_calibrated else "none",
                "held-out samples": shown.errors.get("points", "none"),
                **_errors(shown.errors),
            }
        case CachedLaw():
            asked = {**shown.counts}
            return {
                "surrogate": shown.surrogate,
                "fallback": shown.fallback,
                "tolerance": f"{shown.settings.tolerance:g} of the spread of stress",
                "answered by the surrogate": f"{asked['hits']:,}",
                "by the fallback": f"{asked['fallbacks']:,}",
            }
        case RegionalLaw():
            return dict(shown.laws)
        case RveLaw():
            return {
                "plant cell": _cell(shown.cell),
                "arrangement": f"{shown.cell.cells} × {shown.cell.arrangement}",
                "initialisation": shown.initialisation,
                "solver": shown.settings.solver,
                "wall rest length": f"{shown.rest_length:.4g} µm",
                "density": f"{shown.density:.4g} ng/µm²",
            }
    return {"": repr(shown)}


def _course(curve: DisplacementCurve, wall: Mapping[str, float], counts: Mapping[str, int]) -> Rows:
    largest = np.linalg.norm(curve.displacement, axis=1).max(initial=0.0)
    return {
        "time": f"{curve.t[-1] if curve.t.size else 0.0:g} µs in {counts.get('steps', 0):,} steps",
        "wall time": f"{wall.get('total', 0.0):.3g} s",
        "largest displacement": f"{largest:.4g} µm",
    }


def _of_samples(samples: StressSamples) -> Rows:
    left = samples.left_bifurcation
    has_left = np.zeros(len(samples.F), np.bool_) if left is None else left
    has_stress = samples.status == 0
    return {
        "samples": f"{len(samples.F):,}",
        "usable": f"{int((has_stress & ~has_left).sum()):,}",
        "failed": f"{int((~has_stress).sum()):,}",
        "left a bifurcation": f"{int((has_stress & has_left).sum()):,}",
        "tangents": "no" if samples.P_by_F is None else "yes",
        "plant cell": _cell(samples.cell),
        "initialisation": samples.initialisation,
        "range": samples.range,
    }


def _errors(errors: Mapping[str, Any]) -> Rows:
    """Of the components of σ, relative to their spread."""
    return {
        f"error of {name}": f"{100.0 * errors['rms'][name]:.2g} % RMS, "
        f"{100.0 * errors['worst'][name]:.2g} % at worst"
        for name in ("xx", "xy", "yx", "yy")
        if name in errors.get("rms", {})
    }


def _cell(cell: CellParameters) -> str:
    preset = next((name for name, known in PRESETS.items() if known == cell), "its own constants")
    return f"{preset} ({cell.fingerprint})"


def _drawn(curve: DisplacementCurve) -> str:
    """The components of a displacement over time, between their extremes."""
    if curve.t.size < 2:
        return ""
    u: NDArray[np.float64] = curve.displacement
    low, high = float(u.min()), float(u.max())
    x = _WIDTH * (curve.t - curve.t[0]) / (curve.t[-1] - curve.t[0])
    y = _HEIGHT * (high - u) / max(high - low, 1e-300)
    lines = [
        f'<polyline fill="none" stroke="{colour}" points="'
        + " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y[:, k], strict=True))
        + '"/>'
        for k, colour in enumerate(("#0072B2", "#D55E00"))
    ]
    told = f"displacement {low:.4g} to {high:.4g} µm: u_x blue, u_y orange"
    return (
        f'<svg width="{_WIDTH:g}" height="{_HEIGHT:g}" role="img" aria-label="{told}">'
        f"<title>{told}</title>{''.join(lines)}</svg><br/><small>{told}</small>"
    )
