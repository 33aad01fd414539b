"""The error of the answer of a rest by a law that is wrong, beside a rest by the true law."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import Fixed, PrescribedMotion, Problem, RigidBody
from surrofe2.base.errors import SimulationError
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, find_rest
from surrofe2.macro.answer_error import answer_error, corrected
from surrofe2.macro.rest import RestState
from surrofe2.problem.mesh import rectangle
from surrofe2.problem.rigid_bodies import Circle, Plane
from tests.cache.tables import LOAD_CASE, cached
from tests.laws import KelvinVoigt, Truth, failing, shear_error

TIGHT = MacroSettings(newton_tolerance=1e-10)
GRIPPED = Problem(
    mesh=rectangle(60.0, 40.0, (6, 4)),
    conditions=(
        Fixed(on="left", name="foot"),
        PrescribedMotion(on="right", displacement=(2.0, 0.5), name="grip"),
    ),
    duration=1.0,
    output_interval=1.0,
)
PRESSED = Problem(
    mesh=rectangle(60.0, 40.0, (6, 4)),
    conditions=(Fixed(on="bottom", name="foot"),),
    bodies=(
        RigidBody(
            name="plate",
            shape=Plane(normal=(0.0, -1.0)),
            position=(0.0, 40.0),
            on="top",
            displacement=(0.0, -1.0),
        ),
    ),
    duration=1.0,
    output_interval=1.0,
)
PROBLEMS = {"loaded": LOAD_CASE, "gripped": GRIPPED, "pressed": PRESSED}


def wrong(size=0.05):
    """Answers of a surrogate everywhere, off by up to `size` µN/µm."""
    return cached(shear_error(size), lambda F, F_dot: np.full(len(F), 1e-9))


def true_stress(points, F):
    return Truth().respond(F, np.zeros_like(F))


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_the_correction_is_what_the_rest_is_off_by(problem):
    true = find_rest(problem, Truth(), TIGHT, load_steps=2)
    law = wrong()
    rest = find_rest(problem, law, TIGHT, load_steps=2)
    error = answer_error(rest, law, true_stress)
    off = true.u - rest.u
    assert np.linalg.norm(off, axis=1).max() > 1e-4
    np.testing.assert_allclose(error.displacement, off, atol=0.05 * abs(off).max())
    assert error.elements == error.of == rest.system.discretisation.elements.shape[0]
    np.testing.assert_allclose(
        error.watched, true.watched - rest.watched, atol=0.05 * abs(off).max()
    )
    forces = true.forces - rest.forces
    np.testing.assert_allclose(error.forces, forces, atol=0.05 * abs(forces).max() + 1e-9)
    assert not error.forces_interval.any()
    kept, frame = corrected(rest, law, error)
    assert abs(kept.u - true.u).max() < 0.05 * abs(off).max()
    np.testing.assert_allclose(kept.forces, true.forces, atol=0.05 * abs(forces).max() + 1e-9)
    np.testing.assert_allclose(kept.watched, true.watched, atol=0.05 * abs(off).max())
    np.testing.assert_allclose(kept.stress, true.stress, atol=2e-3)
    nodes = len(rest.system.discretisation.nodes)
    np.testing.assert_array_equal(frame.displacement[0], kept.u[:nodes])
    np.testing.assert_array_equal(rest.path[:-1], kept.path[:-1])


def test_a_sample_of_elements_has_an_interval():
    """Of 40 samples about 95 % have the error of all elements within it."""
    problem = replace(GRIPPED, mesh=rectangle(60.0, 40.0, (24, 16)))
    law = wrong()
    rest = find_rest(problem, law, TIGHT)
    whole = answer_error(rest, law, true_stress)
    within = []
    for seed in range(40):
        part = answer_error(rest, law, true_stress, most=128 * 5, seed=seed)
        assert part.displacement is None
        assert part.largest is None
        assert (part.elements, part.of, part.solved) == (128, 384, 640)
        assert (part.forces_interval > 0.0).sum() >= 4
        near = abs(part.forces - whole.forces) <= part.forces_interval + 1e-12
        within.append(near.mean())
    assert 0.85 < np.mean(within) <= 1.0
    with pytest.raises(ValueError, match="sample"):
        corrected(rest, law, part)


def test_points_that_the_true_law_answered_are_not_asked_again():
    asked = []

    def counted(points, F):
        asked.append(len(points))
        return true_stress(points, F)

    law = cached(shear_error(0.05), lambda F, F_dot: np.where(F[:, 1, 0] > 0.002, 1.0, 1e-9))
    rest = find_rest(GRIPPED, law, TIGHT, load_steps=2)
    error = answer_error(rest, law, counted)
    fallbacks = len(rest.law_state.on_fallback)
    assert 10 < fallbacks < len(rest.F)
    assert sum(asked) == error.solved == len(rest.F) - fallbacks


def test_the_error_is_that_of_the_stresses_that_balance_the_forces():
    """Also at points that a cache hands over to RVEs at the end of the last load step."""
    law = cached(shear_error(0.05), lambda F, F_dot: np.where(F[:, 1, 0] > 0.01, 1.0, 1e-9))
    rest = find_rest(GRIPPED, law, TIGHT, load_steps=2)
    known = rest.law_state.on_fallback.points
    handed_over = abs(rest.stress - Truth().stress(rest.F, 0.0 * rest.F)).max(axis=(1, 2)) > 1e-6
    assert handed_over[known].sum() > 10
    true = find_rest(GRIPPED, Truth(), TIGHT, load_steps=2)
    off = true.u - rest.u
    error = answer_error(rest, law, true_stress)
    np.testing.assert_allclose(error.displacement, off, atol=0.01 * abs(off).max())
    kept, _ = corrected(rest, law, error)
    np.testing.assert_allclose(kept.stress, true.stress, atol=2e-3)


def test_what_a_law_has_learnt_since_the_last_load_step_changes_no_error():
    """A table learns from the closing audit, which comes in between."""
    law = wrong()
    rest = find_rest(GRIPPED, law, TIGHT)
    before = answer_error(rest, law, true_stress)
    after = answer_error(rest, wrong(0.0), true_stress)
    np.testing.assert_allclose(after.stress, before.stress)
    off = abs(before.displacement).max()
    np.testing.assert_allclose(after.displacement, before.displacement, atol=0.01 * off)


def test_a_rest_that_a_law_no_longer_answers_has_no_error():
    rest = find_rest(GRIPPED, KelvinVoigt(), TIGHT)
    law = failing(KelvinVoigt(), fails=lambda F, F_dot: F[:, 0, 0] > 1.0)
    with pytest.raises(SimulationError, match=r"not known: point \d+ at .*, load factor 1, F"):
        answer_error(rest, law, true_stress)


def test_a_point_without_a_true_stress_is_named():
    law = wrong()
    rest = find_rest(GRIPPED, law, TIGHT)
    far = failing(KelvinVoigt(), fails=lambda F, F_dot: F[:, 0, 0] > 1.0)
    with pytest.raises(SimulationError, match=r"not known: at point \d+ the RVE has no stress"):
        answer_error(rest, law, lambda points, F: far.respond(F, np.zeros_like(F)))


def test_a_law_of_some_points():
    points = {"left": np.arange(0, 6), "right": np.arange(6, 10)}
    law = RegionalLaw({"left": Truth(), "right": KelvinVoigt()}, points)
    part = law.at(np.array([1, 7, 9]))
    assert {name: own.tolist() for name, own in part.points.items()} == {
        "left": [0],
        "right": [1, 2],
    }
    assert [*law.at(np.array([8])).points] == ["right"]


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_rest_in_contact_that_resumes_at_its_end_has_the_same_error_to_the_bit(friction):
    """Its tangents are those of the last load step, in which points of a disc stuck and turned."""
    disc = RigidBody(
        name="disc",
        shape=Circle(radius=20.0),
        position=(30.0, 60.0),
        on="top",
        displacement=(1.5, -3.0),
        friction=friction,
    )
    problem = replace(PRESSED, bodies=(disc,))
    states = []
    whole = find_rest(
        problem, wrong(), TIGHT, load_steps=3, checkpoint=states.append, checkpoint_interval=0.0
    )
    error = answer_error(whole, wrong(), true_stress)
    assert [state.factor for state in states][-1] == 1.0
    for state in states:
        law = wrong()
        written = RestState.from_arrays(state.to_arrays())
        resumed = replace(written, law_state=state.law_state)
        again = find_rest(problem, law, TIGHT, load_steps=3, resume=resumed)
        np.testing.assert_array_equal(again.u, whole.u)
        of_resumed = answer_error(again, law, true_stress)
        np.testing.assert_array_equal(of_resumed.displacement, error.displacement)
        np.testing.assert_array_equal(of_resumed.forces, error.forces)
