"""Item 2: Jacobian, warm and cold direct solves to 1e-8 µN, stability check; one thread."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.loops import central_differences, repeat_jacobian
from benchmarks.row import Row
from benchmarks.setting import POINTS, PRESETS, Setting, deformations, micro_states, rve, unit_cell
from benchmarks.timing import ratio, side_by_side, threads, time_calls
from benchmarks.watched_law import TimedLaw
from surrofe2 import LoadCase, simulate
from surrofe2.plant_cell.tiles import pack

TITLE = "RVE solves to a mean force of 1e-8 µN"
STEP = 1e-5
"""Of the central differences, µm."""
_MICRO = 1e6


def run(setting: Setting) -> list[Row]:
    """All figures of both presets."""
    rows = []
    with threads(1):
        for preset in PRESETS:
            rows += [
                *_jacobian(setting, preset),
                *_along_the_bar(setting, preset),
                _cold(setting, preset),
                _stability(setting, preset),
            ]
    return rows


def _jacobian(setting: Setting, preset: str) -> list[Row]:
    unit = unit_cell(preset)
    F, rate = deformations(preset, POINTS)
    z = micro_states(preset, POINTS)
    inverse = np.linalg.inv(F)
    tiles = (z, pack(F), pack(rate))
    n, lanes = 2 * len(unit.position), z.shape[-1]
    ours, theirs = np.empty((len(z), (n - 2) ** 2, lanes)), np.empty((len(z), n, n, lanes))
    times = setting.pick(10, 2)
    exact, differences = side_by_side(
        [
            partial(
                repeat_jacobian, times, *tiles, pack(rate @ inverse), unit.topologies[0],
                unit.constants, ours,
            ),
            partial(
                central_differences, *tiles, pack(inverse), unit.topologies[0], unit.constants,
                STEP, theirs,
            ),
        ],
        setting.pick(9, 3),
    )  # fmt: skip
    theirs = theirs[:, 2:, 2:]
    error = float(abs(ours.reshape(theirs.shape) - theirs).max() / abs(theirs).max())
    per_rve = _MICRO / POINTS
    return [
        Row(
            name=f"{preset}: particle Jacobian of an RVE",
            value=exact.median / times * per_rve,
            spread=exact.spread / times * per_rve,
            unit="µs",
            baseline="central differences in the same lanes",
            baseline_value=differences.median * per_rve,
            ratio=times * ratio(differences, exact),
        ),
        Row(
            name=f"{preset}: its distance from central differences, relative to its largest entry",
            value=error,
            unit="",
            limit=1e-6,
            note=f"step {STEP:g} µm",
        ),
    ]


def _along_the_bar(setting: Setting, preset: str) -> list[Row]:
    law = rve(preset)
    simulate(LoadCase(duration=0.5), law)
    timed = TimedLaw(law)
    duration = setting.pick(250.0, 25.0)
    simulate(LoadCase(duration=duration), timed)
    factorised = timed.effort["newton_solves"] + timed.renewed
    along = f"{preset}: along the bar over {duration:g} µs"
    return [
        Row(
            name=f"{along}, an RVE solve",
            value=timed.respond_seconds / timed.solved * _MICRO,
            unit="µs",
            limit=15.0,
            note=f"{timed.solved:,} solves, the first {POINTS} and Python's share included",
        ),
        Row(
            name=f"{along}, force evaluations a solve",
            value=timed.effort["force_evaluations"] / timed.solved,
            unit="",
        ),
        Row(
            name=f"{along}, factorisations renewed per 100 solves",
            value=100.0 * factorised / timed.solved,
            unit="",
            note=f"{timed.effort['newton_solves']:,} solves by Newton, {timed.renewed:,} renewed "
            "at accepted steps",
        ),
        Row(
            name=f"{along}, acceptance of an RVE at the end of a step (stability, renewal)",
            value=timed.accept_seconds / timed.accepted * _MICRO,
            unit="µs",
        ),
    ]


def _cold(setting: Setting, preset: str) -> Row:
    F, F_dot = deformations(preset, setting.pick(800, 160))
    law = rve(preset)
    answer = law.respond(F, F_dot)
    taken = time_calls(lambda: law.respond(F, F_dot), setting.pick(7, 3))
    failed = int((answer.status != 0).sum())
    evaluations = answer.effort["force_evaluations"] / len(F)
    return Row(
        name=f"{preset}: cold solve of an RVE at random F and Ḟ",
        value=taken.median / len(F) * _MICRO,
        spread=taken.spread / len(F) * _MICRO,
        unit="µs",
        limit=250.0,
        note=f"{len(F)} points, {failed} failed; {evaluations:.1f} force evaluations a point; "
        "stability included",
    )


def _stability(setting: Setting, preset: str) -> Row:
    """`accept` of an answer whose factorisations are fresh: nothing but the check."""
    law = rve(preset)
    F, F_dot = deformations(preset, POINTS)
    first = law.respond(F, F_dot)
    answer = law.respond(F, F_dot, first.state)
    taken = time_calls(lambda: law.accept(F, F_dot, answer), setting.pick(15, 5))
    return Row(
        name=f"{preset}: stability check of an RVE (elastic Hessian)",
        value=taken.median / POINTS * _MICRO,
        spread=taken.spread / POINTS * _MICRO,
        unit="µs",
    )
