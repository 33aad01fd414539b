"""Tangents and gradients by parameters against differences, and the identities that they obey."""

import numpy as np
import pytest

from surrofe2 import (
    CellParameters,
    RveLaw,
    follow_path,
    parameter_gradients,
    path_gradients,
    ramp_and_hold,
)
from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import Status
from surrofe2.rve import INITIALISATIONS
from surrofe2.rve.parameter_gradients import DASHPOTS, PARAMETERS
from surrofe2.rve.solve import Solved
from surrofe2.rve.unit_cell import resettled
from tests.laws import tangents_by_differences
from tests.numerics import differences
from tests.rve.rves import PRESETS, clear_of_the_cut_off, deformations, law, piola

STEP = 2e-6


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", INITIALISATIONS)
def test_tangents_are_the_slopes_of_the_stress(preset, initialisation):
    this = law(preset, initialisation, tolerance=1e-10)
    F, F_dot = deformations(preset, n=100, corners=False)
    answer = this.respond(F, F_dot, tangents=True)
    clear = clear_of_the_cut_off(answer, F)
    assert clear.sum() > 50
    stress_of = lambda F, F_dot: this.respond(F, F_dot, answer.state).stress  # noqa: E731
    slopes = tangents_by_differences(stress_of, F, F_dot, STEP)
    for name in ("P_by_F", "P_by_F_dot"):
        tangent = getattr(answer.tangents, name)
        error = np.abs(tangent - getattr(slopes, name)).max(axis=(1, 2, 3, 4))
        scale = np.abs(tangent).max(axis=(1, 2, 3, 4))
        assert (error / scale)[clear].max() < 1e-6


def test_cauchy_forms_are_the_slopes_of_the_cauchy_stress():
    this = law("printed", "constrained-runs", tolerance=1e-10)
    F, F_dot = deformations("printed", n=16, corners=False)
    answer = this.respond(F, F_dot, tangents=True)
    clear = clear_of_the_cut_off(answer, F)
    exact = answer.tangents.cauchy(F, answer.stress)
    slopes = (
        differences(lambda at: this.respond(at, F_dot, answer.state).stress, F, STEP),
        differences(lambda at: this.respond(F, at, answer.state).stress, F_dot, STEP),
    )
    for tangent, slope in zip(exact, slopes, strict=True):
        np.testing.assert_allclose(tangent[clear], slope[clear], rtol=0, atol=1e-5)


@pytest.mark.parametrize("preset", PRESETS)
def test_elastic_tangent_has_major_symmetry(preset):
    F, F_dot = deformations(preset)
    for initialisation in ("elastic", "constrained-runs", "slow-manifold"):
        A = law(preset, initialisation).respond(F, 0.0 * F_dot, tangents=True).tangents.P_by_F
        np.testing.assert_allclose(A, A.transpose(0, 3, 4, 1, 2), rtol=0, atol=1e-6)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("initialisation", ["elastic", "slow-manifold"])
def test_viscous_tangent_at_rest_is_symmetric_and_dissipates(preset, initialisation):
    F, F_dot = deformations(preset)
    answer = law(preset, initialisation).respond(F, 0.0 * F_dot, tangents=True)
    B = answer.tangents.P_by_F_dot.reshape(-1, 4, 4)
    np.testing.assert_allclose(B, B.swapaxes(1, 2), rtol=0, atol=1e-7 * np.abs(B).max())
    assert np.linalg.eigvalsh(B).min() > -1e-9 * np.abs(B).max()


def test_viscous_tangent_of_constrained_runs_is_not_symmetric():
    """docs/theory.md: a limit on what a dissipation potential can represent."""
    F, F_dot = deformations("water")
    B = law("water").respond(F, 0.0 * F_dot, tangents=True).tangents.P_by_F_dot.reshape(-1, 4, 4)
    assert np.abs(B - B.swapaxes(1, 2)).max() > 1e-3 * np.abs(B).max()


def test_points_without_stress_have_no_tangents():
    F = np.array([np.eye(2), [[0.905, 0.486], [0.0, 0.7585]]])
    answer = law("printed").respond(F, np.zeros_like(F), tangents=True)
    assert answer.status[1] == Status.UNSTABLE
    assert np.isfinite(answer.tangents.P_by_F[0]).all()
    assert np.isnan(answer.tangents.P_by_F[1]).all()
    assert law("printed").respond(F, np.zeros_like(F)).tangents is None


def test_a_stress_without_tangents_is_no_answer_where_they_were_asked_for(monkeypatch):
    def lacking(solved):
        tangents = every(solved)
        tangents.P_by_F[1] = np.nan
        return tangents

    every = Solved.tangents
    monkeypatch.setattr(Solved, "tangents", lacking)
    F = np.tile(np.eye(2), (3, 1, 1))
    this = law("printed")
    answer = this.respond(F, 0.0 * F, tangents=True)
    assert answer.status.tolist() == [Status.OK, Status.NOT_CONVERGED, Status.OK]
    assert np.isnan(answer.stress[1]).all()
    assert (this.respond(F, 0.0 * F).status == Status.OK).all()


UNITS = {
    "wall_stiffness": (1, 0, -2),
    "wall_particle_mass": (1, 0, 0),
    "fluid_particle_mass": (1, 0, 0),
    "sound_speed": (0, 1, -1),
    "viscosity": (1, 0, -1),
    "repulsion_strength": (1, 7, -2),
    "repulsion_cutoff": (0, 1, 0),
    "smoothing_length": (0, 1, 0),
    "cell_side": (0, 1, 0),
    "sap_bulk_modulus": (1, 0, -2),
}
"""Powers of mass, length and time."""
CELLS_IN_UNITS = {
    "square": CellParameters(),
    "hexagon": CellParameters(arrangement="hexagon", fluid="sph"),
    "undrained": CellParameters(arrangement="hexagon", sap_bulk_modulus=50.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("arrangement", CELLS_IN_UNITS)
@pytest.mark.parametrize("initialisation", INITIALISATIONS)
def test_other_units_change_no_physics(initialisation, arrangement):
    """P has units ng/µs²: Euler's identity of each unit, whose sum is of P and of the rate."""
    cell = CELLS_IN_UNITS[arrangement]
    this = RveLaw(cell, initialisation=initialisation)
    F, F_dot = deformations("printed", n=24, corners=False)
    F = np.eye(2) + (1.0 if arrangement == "square" else 0.1) * (F - np.eye(2))
    found = parameter_gradients(this, F, F_dot)
    P, given = piola(this, F, F_dot), this.cell.to_dict()
    by_rate = np.einsum("nabcd,ncd->nab", found.answer.tangents.P_by_F_dot, F_dot)
    for unit, expected in enumerate((P, 0.0 * P, by_rate - 2.0 * P)):
        parts = [UNITS[k][unit] * given[k] * found.P_by[k] for k in found.P_by if k in UNITS]
        error = abs(sum(parts) - expected).max(axis=(1, 2))
        # a length may move a pair over the cut-off, where P has a kink
        assert np.quantile(error, 0.9) < 1e-7 * np.abs(parts).max(), unit


def test_dashpots_carry_what_comes_with_the_rate():
    """Elastic particles lie where they lie: P is linear in the dashpots, from zero on."""
    this, undamped = law("printed", "elastic"), CellParameters(**dict.fromkeys(DASHPOTS, 0.0))
    reference = resettled(undamped, this.reference)
    without = RveLaw(undamped, initialisation="elastic", reference=reference)
    F, F_dot = deformations("printed", n=8, corners=False)
    viscous = piola(this, F, F_dot) - piola(without, F, F_dot)
    for at in (this, without):
        found = parameter_gradients(at, F, F_dot, DASHPOTS).P_by
        total = sum(this.cell.to_dict()[name] * found[name] for name in DASHPOTS)
        np.testing.assert_allclose(total, viscous, atol=1e-7 * abs(viscous).max())


def test_a_point_without_stress_has_no_gradient():
    this, still = law("printed", "elastic"), np.zeros((2, 2, 2))
    F = np.array([np.eye(2), np.diag([0.05, 1.0])])
    found = parameter_gradients(this, F, still, ["cell_side"])
    assert found.answer.status.tolist()[0] == 0 != found.answer.status.tolist()[1]
    assert np.isnan(found.P_by["cell_side"]).all(axis=(1, 2)).tolist() == [False, True]


@pytest.mark.slow
def test_a_path_creeps_otherwise_with_other_parameters():
    """A tensile test with free sides, against whole paths of other laws."""
    cell = CellParameters.preset("water", viscosity=50.0)
    motion = ramp_and_hold(np.diag([1.02, 1.0]), 1.0)
    free = [(1, 1)]
    path = follow_path(RveLaw(cell), motion, 1.5, 12, free=free)
    found = path_gradients(RveLaw(cell), path, ("viscosity",), free=free)["viscosity"]

    def stress(viscosity):
        other = RveLaw(CellParameters.preset("water", viscosity=viscosity))
        return follow_path(other, motion, 1.5, 12, free=free).first_piola

    whole = (stress(50.1) - stress(49.9)) / 0.2
    assert np.abs(found - whole).max() < 1e-5 * np.abs(whole).max()
    held = path_gradients(RveLaw(cell), path, ("viscosity",))["viscosity"]
    assert np.abs(held - whole).max() > 0.02 * np.abs(whole).max()


def test_the_sap_of_a_uniform_fluid_has_a_gradient_from_zero_on():
    """Of drained sap the difference is one-sided; it is what a little stiffness adds."""
    F, F_dot = deformations("printed", n=8, corners=False)
    drained, stiffer = (
        CellParameters(fluid="uniform", sap_bulk_modulus=modulus) for modulus in (0.0, 1e-3)
    )
    this = RveLaw(drained)
    found = parameter_gradients(this, F, F_dot)
    assert set(found.P_by) == {*PARAMETERS, "sap_bulk_modulus"}
    change = (piola(RveLaw(stiffer), F, F_dot) - piola(this, F, F_dot)) / 1e-3
    slope = found.P_by["sap_bulk_modulus"]
    np.testing.assert_allclose(slope, change, rtol=0, atol=1e-4 * abs(slope).max())
    with pytest.raises(InputError, match="names: 'sap_bulk_modulus'; it must be among"):
        parameter_gradients(law("printed"), F, F_dot, ["sap_bulk_modulus"])


def test_what_has_no_gradients_says_so():
    F, F_dot = np.eye(2)[None], np.zeros((1, 2, 2))
    with pytest.raises(InputError, match="names: 'wall'; it must be among wall_stiffness"):
        parameter_gradients(law("printed"), F, F_dot, ["wall"])
    with pytest.raises(InputError, match="parameter_gradients: RveLaw has no tangents"):
        parameter_gradients(law("printed", solver="iterated"), F, F_dot)
    irregular = CellParameters.preset("water", arrangement="voronoi", cells=4)
    with pytest.raises(InputError, match="law: voronoi; gradients by parameters need squares"):
        parameter_gradients(RveLaw(irregular), F, F_dot)
