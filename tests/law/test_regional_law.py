"""Tissue of several cell types: every point is answered by the law of its region."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.macro import MacroSettings, points_by_region, simulate
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import (
    BodyForce,
    Box,
    Fixed,
    Problem,
    rectangle,
    with_regions,
)
from surrofe2.rve import RveLaw
from tests.laws import DryFriction, KelvinVoigt, Surrogate, TrueLaw, failing, stretched

MESH = with_regions(
    rectangle(60.0, 40.0, (3, 2)),
    skin=Box((0.0, 20.0), (60.0, 40.0)),
    flesh=Box((0.0, 0.0), (60.0, 20.0)),
)
POINTS = points_by_region(MESH, ("skin", "flesh"))
SOFT, STIFF = KelvinVoigt(), KelvinVoigt(shear_modulus=200.0, density=0.2)
DROOP = Problem(
    mesh=MESH,
    conditions=(Fixed(on="left"), BodyForce(name="load", acceleration=(0.0, -0.2))),
    duration=6.0,
    watched={"tip": (60.0, 20.0)},
)


def some_states(rng, n=30):
    return np.eye(2) + 0.05 * rng.normal(size=(n, 2, 2)), 0.01 * rng.normal(size=(n, 2, 2))


def test_every_point_is_answered_by_the_law_of_its_region():
    F, F_dot = some_states(np.random.default_rng(1))
    law = RegionalLaw({"skin": STIFF, "flesh": SOFT}, POINTS)
    answer = law.respond(F, F_dot, tangents=True)
    for name, own in POINTS.items():
        alone = law.laws[name].respond(F[own], F_dot[own], tangents=True)
        np.testing.assert_array_equal(answer.stress[own], alone.stress)
        np.testing.assert_array_equal(answer.tangents.P_by_F[own], alone.tangents.P_by_F)
        assert (law.density[own] == law.laws[name].density).all()
    assert answer.effort == {"evaluations": 30}


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_two_regions_of_one_cell_move_as_one_region_does(integrator):
    settings = MacroSettings(integrator=integrator)
    cell = RveLaw(CellParameters.preset("water"), initialisation="slow-manifold")
    both = RegionalLaw({"skin": cell, "flesh": cell}, POINTS)
    parts, whole = (simulate(DROOP, law, settings).curve.displacement for law in (both, cell))
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-6 * abs(whole).max())


def test_mass_and_stiffness_are_those_of_the_regions():
    """A stiff, heavy skin: momentum lost to the clamp is the load's on the mass of both."""
    law = RegionalLaw({"skin": STIFF, "flesh": SOFT}, POINTS)
    run = simulate(DROOP, law, MacroSettings(relative_tolerance=1e-6))
    weight = 0.2 * (60.0 * 20.0 * 0.2 + 60.0 * 20.0 * 0.08)
    assert run.history["force load y"] == pytest.approx(-weight, rel=1e-12)
    assert abs(run.energies["balance"]).max() < 1e-6 * run.energies["load"].max()


def test_dissipation_of_regions_adds_up():
    law = RegionalLaw({"skin": STIFF, "flesh": SOFT}, POINTS)
    energies = simulate(DROOP, law).energies
    parts = energies["dissipated skin"] + energies["dissipated flesh"]
    assert energies["dissipated"][-1] > 0.0
    assert parts[-1] == pytest.approx(energies["dissipated"][-1], rel=1e-3)


def test_tangents_need_those_of_every_law():
    law = RegionalLaw({"skin": STIFF, "flesh": DryFriction()}, POINTS)
    assert not law.has_tangents


def test_regions_that_miss_or_share_elements_are_named():
    with pytest.raises(InputError, match=r"element 0 at \(10, 10\) µm is in 0 of skin"):
        points_by_region(MESH, ("skin",))
    with pytest.raises(InputError, match=r"laws: none for region skin; there are flesh"):
        RegionalLaw({"flesh": SOFT}, POINTS)
    with pytest.raises(InputError, match=r"did you mean skin\? known are skin, flesh"):
        points_by_region(MESH, ("skim", "flesh"))
    with pytest.raises(InputError, match="regions have 30"):
        RegionalLaw({"skin": STIFF, "flesh": SOFT}, POINTS).respond(
            *some_states(np.random.default_rng(1), 3)
        )


def test_a_step_to_which_one_law_objects_changes_no_other():
    """The cached law of the skin counts, audits and learns only from what the flesh keeps."""
    cached = CachedLaw(Surrogate(), TrueLaw(), CacheSettings(audit=1.0))
    objecting = []
    flesh = failing(KelvinVoigt(), refuses=lambda F, F_dot: np.full(len(F), bool(objecting)))
    law = RegionalLaw({"skin": cached, "flesh": flesh}, POINTS)
    F, F_dot = stretched(*np.linspace(0.9, 1.7, 30))
    answer = law.respond(F, F_dot)
    objecting.append(True)
    refused = law.accept(F, F_dot, answer)
    assert refused.status[POINTS["flesh"]].all()
    assert not refused.status[POINTS["skin"]].any()
    assert set(cached.counts.values()) == {0}
    assert cached.report()["audit"]["audited"] == 0
    objecting.clear()
    kept = law.accept(F, F_dot, answer)
    assert not kept.status.any()
    assert cached.counts["steps"] == 1
    assert cached.counts["hits"] + cached.counts["fallbacks"] == POINTS["skin"].size
    alone = CachedLaw(Surrogate(), TrueLaw(), CacheSettings(audit=1.0))
    own = F[POINTS["skin"]], F_dot[POINTS["skin"]]
    expected = alone.accept(*own, alone.respond(*own))
    assert cached.counts == alone.counts
    np.testing.assert_array_equal(
        kept.state[0].on_fallback.points, expected.state.on_fallback.points
    )
