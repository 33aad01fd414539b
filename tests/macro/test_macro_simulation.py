"""The run around the equations: interrupts, resumption, results, settings."""

from dataclasses import asdict, replace
from itertools import count

import numpy as np
import pytest
from skfem.helpers import grad

from surrofe2 import LoadCase
from surrofe2.base.errors import MismatchError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.elements import (
    deformation_gradient,
    element_mean_F,
    element_mean_stress,
    make_discretisation,
)
from surrofe2.macro.history import POINTS_EVERY
from surrofe2.problem import Plane, Problem, RigidBody, rectangle
from surrofe2.problem.amplitude import Ramp
from tests.laws import KelvinVoigt, failing
from tests.macro.bars import BAR, LOAD_CASE, SETTINGS, assert_same_run, resumed, run_and_states


class Stop(KeyboardInterrupt):
    """Only ours, so that a real interrupt still ends the tests."""


def test_interrupted_run_resumes_as_if_nothing_had_happened():
    whole = simulate(LOAD_CASE, KelvinVoigt(), SETTINGS)
    states = []

    def stop_at(t, duration):
        assert duration == LOAD_CASE.duration
        if t > 2.6:
            raise Stop

    with pytest.raises(Stop):
        simulate(LOAD_CASE, KelvinVoigt(), SETTINGS, progress=stop_at, checkpoint=states.append)
    (state,) = states
    assert 2.6 < state.t < 4.0
    again = resumed(LOAD_CASE, KelvinVoigt(), SETTINGS, state)
    assert_same_run(again, whole)
    np.testing.assert_array_equal(again.met.F_dot, whole.met.F_dot)
    assert again.wall_time["total"] > state.wall_time["total"]


def between_plates():
    """A block that sticks to its floor and is dragged by a lid, along which it creeps."""

    def plate(y, outward, **of_body):
        return RigidBody(
            shape=Plane(normal=(0.0, outward)), position=(0.0, y), friction=0.3,
            amplitude=Ramp(end=6.0, smooth=True), **of_body,
        )  # fmt: skip

    floor = plate(0.0, 1.0, name="floor", on="bottom", displacement=(0.0, 0.2))
    lid = plate(20.0, -1.0, name="lid", on="top", displacement=(1.0, -0.2), slip_speed=0.05)
    return Problem(
        mesh=rectangle(40.0, 20.0, (2, 2)), conditions=(), bodies=(floor, lid), duration=8.0,
        watched={"corner": (40.0, 20.0)},
    )  # fmt: skip


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_points_that_stick_and_points_that_creep_resume_as_they_were(integrator):
    """Sticking is remembered; a body with a slip speed does not stick because another does."""
    settings = MacroSettings(frames=2, integrator=integrator)
    law = KelvinVoigt(shear_viscosity=20.0, bulk_viscosity=20.0)
    whole, states = run_and_states(between_plates(), law, settings)
    state = next(each for each in states if each.t > 4.0)
    assert [*state.drags] == ["floor"]
    assert abs(state.drags["floor"]).max() > 1.0
    assert_same_run(resumed(between_plates(), law, settings, state), whole)


def test_interrupt_within_the_law_leaves_the_last_whole_step():
    calls, states = count(1), []

    def interrupt(F, F_dot):
        if next(calls) == 60:
            raise Stop
        return np.zeros(len(F), dtype=bool)

    law = failing(KelvinVoigt(), fails=interrupt)
    with pytest.raises(Stop):
        simulate(LOAD_CASE, law, SETTINGS, checkpoint=states.append)
    whole = simulate(LOAD_CASE, KelvinVoigt(), SETTINGS)
    assert_same_run(resumed(LOAD_CASE, KelvinVoigt(), SETTINGS, states[0]), whole)


def test_checkpoints_come_with_every_step_when_asked_and_seldom_by_default():
    seldom, (run, often) = [], run_and_states(LOAD_CASE, KelvinVoigt())
    simulate(LOAD_CASE, KelvinVoigt(), SETTINGS, checkpoint=seldom.append)
    assert len(often) == run.counts["steps"]
    assert seldom == []
    assert often[0].journal.lengths["rows"] < often[-1].journal.lengths["rows"]
    assert_same_run(resumed(LOAD_CASE, KelvinVoigt(), SETTINGS, often[-1]), run)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"width": 61.0}, "mesh"),
        ({"body_force": (0.0, -0.1)}, "conditions"),
        ({"amplitude": ((0.0, 1.0), (1.0, 1.0))}, "conditions"),
        ({"output_interval": 0.2}, "output times"),
        ({"watched": (60.0, 10.0)}, "watched points"),
    ],
)
def test_checkpoint_of_another_run_is_refused(change, name):
    _, states = run_and_states(LOAD_CASE, KelvinVoigt())
    with pytest.raises(MismatchError, match=f"resume: {name}: not that"):
        simulate(LoadCase(**BAR | change), KelvinVoigt(), SETTINGS, resume=states[-2])


def test_frames_that_somebody_keeps_are_those_of_a_run_that_keeps_them_itself():
    kept, states = [], []
    whole = simulate(LOAD_CASE, KelvinVoigt(), SETTINGS).frames
    run = simulate(
        LOAD_CASE, KelvinVoigt(), SETTINGS, keep_frame=lambda *frame: kept.append(frame),
        checkpoint=states.append, checkpoint_interval=0.0,
    )  # fmt: skip
    assert [count for _, count, _ in kept] == [*range(len(whole.t))]
    for (frame, _, points), expected in zip(kept, whole.one_by_one(), strict=True):
        for name, values in asdict(expected).items():
            np.testing.assert_array_equal(getattr(frame, name), values)
        assert points == np.searchsorted(whole.point_t, frame.t[0])
    np.testing.assert_array_equal(run.frames.t, whole.t)
    # memory and checkpoints do not grow with the frames, but for their times
    for each in (run.frames, states[-1].frames):
        for name, values in asdict(each).items():
            assert len(values) == (0 if name not in ("t", "point_t") else len(getattr(whole, name)))
    # without somebody who keeps the others, fields would stand beside the times of earlier ones
    with pytest.raises(MismatchError, match=r"resume: keep_frame took .* of \d+ frames"):
        simulate(LOAD_CASE, KelvinVoigt(), SETTINGS, resume=states[-2])


def test_points_of_frames_have_the_mean_that_their_elements_have():
    frames = simulate(LOAD_CASE, KelvinVoigt(), SETTINGS).frames
    space, at = make_discretisation(LOAD_CASE.mesh), np.isin(frames.t, frames.point_t)
    assert frames.point_t.tolist() == [*frames.t[:-1:POINTS_EVERY], frames.t[-1]]
    assert frames.point_source.shape == (len(frames.point_t), 0)
    motion = zip(frames.displacement[at], frames.velocity[at], strict=True)
    for k, (u, v) in enumerate(motion):
        F, F_dot, _ = deformation_gradient(space, u, v)
        for mean, known in (
            (element_mean_stress(space, F, frames.point_stress[k]), frames.stress[at][k]),
            (element_mean_F(space, F_dot), frames.F_dot[at][k]),
        ):
            np.testing.assert_allclose(mean, known, rtol=0.0, atol=1e-13 * abs(known).max())


def test_results_belong_together():
    law = KelvinVoigt()
    run = simulate(LOAD_CASE, law, SETTINGS)
    counts, n_points = run.counts, 5 * 6
    assert counts["right_hand_sides"] == counts["stress_calls"]
    assert counts["stress_points"] == counts["stress_calls"] * n_points
    # One at the start and one to choose the first step.
    tried = counts["steps"] + counts["rejected_steps"]
    assert counts["right_hand_sides"] == 6 * tried + 2
    assert 0 < counts["dissipation_points"] <= n_points * counts["steps"]
    assert run.effort["evaluations"] == counts["stress_points"] + counts["dissipation_points"]
    wall = run.wall_time
    assert wall["law"] > 0.0
    assert wall["total"] == pytest.approx(wall["law"] + wall["macro"])
    assert run.threads >= 1

    frames = run.frames
    assert frames.t[0] == 0.0
    assert frames.t[-1] == LOAD_CASE.duration
    assert frames.t.size <= SETTINGS.frames
    assert (np.diff(frames.t) > 0.0).all()
    held = run.nodes[:, 0] == 0.0
    assert not frames.displacement[:, held].any()
    assert frames.stress.shape == (frames.t.size, 6, 2, 2)

    low, high = run.met.stretch
    assert low < 1.0 < high
    assert run.met.F[0][0, 0] <= frames.F[..., 0, 0].min()
    assert run.met.rate >= np.abs(run.met.RT_F_dot).max() * (1 - 1e-12)
    assert 0.0 < run.met.shear < 0.2


def test_last_output_time_survives_rounding():
    """0.1 × 3 is more than 0.3."""
    load_case = replace(LOAD_CASE, duration=0.3, output_interval=0.1)
    assert load_case.output_times()[-1] > 0.3
    run = simulate(load_case, KelvinVoigt(), SETTINGS)
    assert run.curve.t.size == 4
    assert run.curve.displacement[-1, 1] < run.curve.displacement[-2, 1] < 0.0


def test_dissipation_of_elements_is_that_of_the_tissue():
    """Energy by area, at the frames: never falling, together that of the tissue up to the last
    sample and by the rate there since, at the end to rounding; none of a run that does not record
    it."""
    often = replace(LOAD_CASE, output_interval=0.02)
    run, states = run_and_states(often, KelvinVoigt(), replace(SETTINGS, largest_step=0.02))
    found = run.frames.dissipated
    assert found.shape == (run.frames.t.size, len(run.elements))
    assert not found[0].any()
    assert np.diff(found, axis=0).min() >= 0.0
    area = 60.0 * 40.0 / len(run.elements)
    whole = run.energies["dissipated"]
    assert area * found[-1].sum() == pytest.approx(whole[-1], rel=1e-12)
    sampled, rate = states[-1].journal["samples"].T
    assert sampled.size <= run.curve.t.size // 2 + 2
    energy = np.append(0.0, np.cumsum(0.5 * np.diff(sampled) * (rate[1:] + rate[:-1])))
    last = np.searchsorted(sampled, run.frames.t, side="right") - 1
    of_frames = energy[last] + rate[last] * (run.frames.t - sampled[last])
    np.testing.assert_allclose(area * found.sum(axis=1), of_frames, rtol=1e-12)
    whole_then = np.interp(run.frames.t, run.curve.t, whole)
    np.testing.assert_allclose(whole_then, of_frames, atol=2e-3 * whole[-1])
    assert found[-1].max() > 2.0 * found[-1].min()
    off = simulate(LOAD_CASE, KelvinVoigt(), replace(SETTINGS, record_dissipation=False))
    assert off.frames.dissipated.size == off.counts["dissipation_points"] == 0
    assert np.isnan(off.energies["dissipated"][1:]).all()
    assert np.isfinite(off.energies["balance"]).all()


def test_scikit_fem_evaluates_what_a_run_gives_back():
    """Its basis and a frame's nodal vector: mean F of the elements, and the watched point."""
    run = simulate(LOAD_CASE, KelvinVoigt(), SETTINGS)
    basis, u = run.basis, run.displacement(-1)
    F = np.eye(2)[:, :, None, None] + grad(basis.interpolate(u))
    mean = np.einsum("ijeq,eq->eij", F, basis.dx) / basis.dx.sum(axis=1)[:, None, None]
    np.testing.assert_allclose(mean, run.frames.F[-1], rtol=0, atol=1e-12)
    at = basis.probes(np.array([*LOAD_CASE.watched.values()]).T) @ u
    np.testing.assert_allclose(at, run.curve.displacement[-1], rtol=0, atol=1e-12)
