"""Item 1: forces of 80 RVEs, cells as lanes, beside a scalar loop and the numpy twin."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.loops import repeat_evaluation, repeat_forces, repeat_plain_evaluation
from benchmarks.row import Row
from benchmarks.setting import POINTS, Array, Setting, deformations, micro_states, rve, unit_cell
from benchmarks.timing import ratio, side_by_side, threads, time_calls
from surrofe2.plant_cell.tiles import pack, unpack
from tests.plant_cell.twin import Twin

TITLE = "Force evaluation, 80 RVEs"
LIMIT = 2.0
PRESET = "printed"
_ERROR = "largest |Δf| / largest |f| against the numpy twin"


def run(setting: Setting) -> list[Row]:
    """Lanes against the scalar loop over the lists a run uses, then over all pairs to 30 µm."""
    with threads(1):
        near, far = (_evaluate(setting, reach) for reach in (0, -1))
        return [*near, far[0], *_beside_numpy(setting)]


def _evaluate(setting: Setting, reach: int) -> list[Row]:
    unit = unit_cell(PRESET)
    topology, patch = unit.topologies[reach], unit.patches[reach]
    F, rate = deformations(PRESET, POINTS)
    z = micro_states(PRESET, POINTS)
    plain_z = np.ascontiguousarray(unpack(z, POINTS).swapaxes(1, 2))
    times = setting.pick(200, 20)
    in_lanes, one_by_one = np.empty_like(z), np.empty_like(plain_z)
    tiles = (z, pack(F), pack(rate), topology, unit.constants)
    lanes, scalar = side_by_side(
        [
            partial(repeat_evaluation, times, *tiles, in_lanes),
            partial(
                repeat_plain_evaluation, times, plain_z, F, rate, topology, unit.constants,
                unit.topologies[0].area, one_by_one,
            ),
        ],
        setting.pick(15, 5),
    )  # fmt: skip
    alone = time_calls(partial(repeat_forces, times, *tiles), setting.pick(15, 5))
    per_rve = 1e6 / (times * POINTS)
    exact = _twin_forces(plain_z, F, rate, setting.pick(4, 1))
    pairs = sum(len(p) for p in (topology.bonds, topology.contacts, topology.fluid_pairs))
    pairs_text = f"{pairs} pairs (contacts listed to {patch.reach:g} µm)"
    evaluation = Row(
        name=f"forces, stress and residual of an RVE and core, {pairs_text}",
        value=lanes.median * per_rve,
        spread=lanes.spread * per_rve,
        unit="µs",
        limit=LIMIT if reach == 0 else None,
        baseline="scalar numba loop over the same pairs",
        baseline_value=scalar.median * per_rve,
        ratio=ratio(scalar, lanes),
        error=_error(unpack(in_lanes, POINTS).swapaxes(1, 2), exact),
        baseline_error=_error(one_by_one, exact),
        error_of=_ERROR,
    )
    forces = Row(
        name="forces alone",
        value=alone.median * per_rve,
        spread=alone.spread * per_rve,
        unit="µs",
    )
    speed = Row(
        name="particle-steps a second and core",
        value=topology.particles / evaluation.value,
        unit="million",
        baseline="scalar numba loop over the same pairs",
        baseline_value=topology.particles / (scalar.median * per_rve),
        note="35 particles an RVE; one step is one force evaluation",
    )
    return [evaluation, forces, speed]


def _beside_numpy(setting: Setting) -> list[Row]:
    """The twin, which also goes over all images, once per RVE."""
    unit = unit_cell(PRESET)
    F, rate = deformations(PRESET, 8)
    z = micro_states(PRESET, 8)
    plain_z = unpack(z, 8).swapaxes(1, 2)
    twin = Twin(rve(PRESET).cell, rve(PRESET).rest_length)
    times = setting.pick(200, 20)
    forces = np.empty_like(z)
    arguments = (z, pack(F), pack(rate), unit.topologies[0], unit.constants, forces)
    lanes, numpy_twin = side_by_side(
        [
            partial(repeat_evaluation, times, *arguments),
            lambda: twin.evaluate(plain_z[0], F[0], rate[0]),
        ],
        setting.pick(5, 2),
    )
    per_rve = 1e6 / (times * 8)
    return [
        Row(
            name="forces, stress and residual of an RVE, one tile of 8",
            value=lanes.median * per_rve,
            spread=lanes.spread * per_rve,
            unit="µs",
            baseline="numpy, pair by pair over all images (the twin of the tests)",
            baseline_value=numpy_twin.median * 1e6,
            ratio=numpy_twin.median * 1e6 / (lanes.median * per_rve),
            error=_error(
                unpack(forces, 8).swapaxes(1, 2), _twin_forces(plain_z, F, rate, setting.pick(4, 1))
            ),
            baseline_error=0.0,
            error_of=_ERROR,
        )
    ]


def _twin_forces(z: Array, F: Array, rate: Array, points: int) -> Array:
    twin = Twin(rve(PRESET).cell, rve(PRESET).rest_length)
    return np.stack([twin.evaluate(z[p], F[p], rate[p])[0] for p in range(points)])


def _error(forces: Array, exact: Array) -> float:
    return float(abs(forces[: len(exact)] - exact).max() / abs(exact).max())
