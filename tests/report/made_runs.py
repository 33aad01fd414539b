"""Folders of two runs of one small bar: as by RVEs, and as by a cache that fell back at times."""

import json
from dataclasses import replace

import numpy as np

from surrofe2.cache.audit import ErrorRecord, Question
from surrofe2.cache.cached_law import effort_of
from surrofe2.law.stress_law import SURROGATE, Status, StressResponse
from surrofe2.macro import simulate
from surrofe2.store.run_folder import write_record
from surrofe2.workflow.run import write_results
from tests.laws import KelvinVoigt
from tests.run_records import finished_record

RISK, WORST = 0.004, 0.003
EVIL = '</script><script>alert("x")</script>'
"""An event that must stay words."""


def made_runs(recipe, folder):
    """Paths of the two runs in a folder, of the recipe's bar by a Kelvin–Voigt solid."""
    settings = replace(recipe.macro, frames=13)
    run = simulate(recipe.problem(), KelvinVoigt(), settings)
    counts, wall = {"steps": 10, "stress_points": 100}, {"total": 3.0, "law": 2.0, "macro": 1.0}
    true, cached = folder / "rve", folder / "cached"
    write_results(true, run)
    write_record(true, finished_record(recipe, "rve", wall, {**counts, "rve_solves": 100}))

    frames = run.frames
    source = np.full(frames.F.shape[:2], float(SURROGATE))
    source[4:, 0] = Status.OUT_OF_RANGE
    at_points = np.repeat(source[np.isin(frames.t, frames.point_t)], 5, axis=1)
    frames = replace(
        frames,
        source=source,
        risk=np.where(source == SURROGATE, RISK, 0.0),
        point_source=at_points,
        point_risk=np.where(at_points == SURROGATE, RISK, 0.0),
    )
    curve = replace(run.curve, displacement=1.001 * run.curve.displacement)
    write_results(cached, replace(run, frames=frames, curve=curve, curves={"watched": curve}))
    record = finished_record(recipe, "cached", {"total": 0.5, "law": 0.3, "macro": 0.2}, counts)
    surrogate = {"file": "s", "fingerprint": "f", "errors": {}, "seconds": {"data": 20.0}}
    write_record(cached, replace(record, surrogate=surrogate, cache=cache_report()))
    events = [{"t": 0.5, "event": "fell back", "why": EVIL}, {"t": 1.0, "event": "came back"}]
    lines = "\n".join(map(json.dumps, events))
    (cached / "events.jsonl").write_text(f"{lines}\n", encoding="utf-8")
    return [true, cached]


def audited(tolerance, errors):
    """The record of audits with these errors, all at one point and step."""
    n = len(errors)
    true, stress = np.tile(np.diag([0.0, 1e3]), (2, n, 1, 1))
    stress[:, 0, 0] = errors
    F = np.tile(np.eye(2), (n, 1, 1))
    step, point = np.full((2, n), [[7], [3]])
    record = ErrorRecord(tolerance)
    asked = Question(step, point, F, 0.0 * F, stress, np.full(n, RISK), np.zeros(n))
    record.add(asked, StressResponse(true, np.zeros(n, dtype=np.int8)), np.ones(n))
    return record


def cache_report():
    """What `CachedLaw.report` would say."""
    audit = audited(0.05, np.geomspace(1e-6, WORST, 40))
    why = np.full(6, Status.OUT_OF_RANGE, dtype=np.int8)
    return {
        "since": 0.0,
        "tolerance": {"share": 1e-3, "spread": 50.0, "absolute": 0.05},
        "accepted": {**effort_of(206, why), "steps": 10},
        "left_range": {},
        "audit": {"share": 0.2, "seed": 1, **audit.to_dict()},
        "closing_audit": {
            "answers": 200,
            "sampled": 40,
            "wrong_at_most": 1.0 - 0.05 ** (1.0 / 40),
            "confidence": 0.95,
            **audit.to_dict(),
        },
        "trust": {"factor": 1.0, "off": False, "events": [{"step": 3, "finding": "a finding"}]},
    }
