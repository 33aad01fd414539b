"""Bodies that are sharper than three contact points of a side are apart press all the same."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import Corner, Fixed, Plane, Problem, RigidBody, RveLaw, living_cell
from surrofe2.base.errors import InputError
from surrofe2.macro import find_rest
from surrofe2.macro.elements import n_points_of
from surrofe2.macro.forces import (
    FEWEST_POINTS,
    MOST_POINTS,
    ONSET,
    check_bodies,
    contact_gap,
    make_contact,
    points_per_side,
)
from surrofe2.macro.system import _modulus, system_of
from surrofe2.problem.mesh import rectangle
from surrofe2.workflow.run import problem_record, sharp_notes
from tests.laws import KelvinVoigt

SIDE = 20.0


def under_a_blade(x, radius=1.5, depth=2.0):
    blade = RigidBody(
        name="blade",
        shape=Corner(axis=(0.0, 1.0), angle=30.0, radius=radius),
        on="top",
        position=(x, 40.0),
        displacement=(0.0, -depth),
    )
    mesh = rectangle(120.0, 40.0, (6, 2))
    return Problem(mesh=mesh, conditions=(Fixed(on="bottom"),), bodies=(blade,), duration=1.0)


@pytest.mark.parametrize("place", [0.0, 0.2, 0.3, 0.5, 0.7])
def test_a_blade_is_felt_wherever_it_presses(place):
    """Three points of a side are 7.7 µm apart, four times as wide as the blade is at the side."""
    rest = find_rest(under_a_blade(60.0 + place * SIDE), KelvinVoigt(), load_steps=4)
    force = -rest.history["force blade y"][-1]
    middle = find_rest(under_a_blade(60.0 + 0.5 * SIDE), KelvinVoigt(), load_steps=4)
    assert force == pytest.approx(-middle.history["force blade y"][-1], rel=0.5)
    assert force > 10.0


def test_a_body_inside_the_tissue_is_refused():
    problem = under_a_blade(60.0)
    (blade,) = problem.bodies
    inside = replace(problem, bodies=(replace(blade, position=(60.0, 30.0)),))
    told = r"bodies.blade.position: .* the tissue begins 3.64 µm inside it"
    with pytest.raises(InputError, match=told):
        check_bodies(inside)
    with pytest.raises(InputError, match=told):
        find_rest(inside, KelvinVoigt())
    check_bodies(problem)


def test_points_are_as_near_as_a_rounding_is_wide():
    for radius in (1.0, 1.5, 5.0):
        shape = Corner(axis=(0.0, 1.0), angle=30.0, radius=radius)
        points = points_per_side(shape, SIDE)
        assert contact_gap(points, SIDE) <= radius
        assert points == FEWEST_POINTS or contact_gap(points - 1, SIDE) > radius
    assert points_per_side(Plane(normal=(0.0, 1.0)), SIDE) == FEWEST_POINTS
    sharp = Corner(axis=(0.0, 1.0), angle=30.0, radius=0.01)
    assert points_per_side(sharp, SIDE) == MOST_POINTS
    places, _ = np.polynomial.legendre.leggauss(3)
    assert contact_gap(3, SIDE) == pytest.approx(0.5 * SIDE * places[2])


def test_points_of_the_longest_side_are_near_enough():
    """On sides from 3.3 to 36.7 µm, whose mean is the side of the others."""
    problem = under_a_blade(60.0)
    mesh, (blade,) = problem.mesh, problem.bodies
    x, y = mesh.p
    graded = replace(mesh, doflocs=np.stack([x**2 / 120.0, y]))
    n = mesh.p.shape[1]
    contact = make_contact(replace(problem, mesh=graded), blade, n, n + 1, 1.0, 1.0)
    assert np.diff(np.sort(contact.points[:, 0])).max() <= blade.shape.radius


def test_a_mesh_that_is_too_coarse_is_warned_of():
    assert not problem_record(under_a_blade(60.0))["sharp"]
    sharp = problem_record(under_a_blade(60.0, radius=0.1))["sharp"]
    ((warning, is_warning),) = sharp_notes(sharp)
    assert is_warning
    gap = contact_gap(MOST_POINTS, SIDE)
    assert sharp == {"blade": [0.1, pytest.approx(gap)]}
    assert "contact: blade has a rounding of 0.1 µm" in warning
    assert f"make the elements there {gap / 0.1:.1f} times smaller" in warning


@pytest.mark.parametrize("stiffness", [None, 5.0])
def test_contact_with_undrained_sap_sets_in_over_a_distance_as_with_drained_sap(stiffness):
    """And drained over 1/25 of the modulus of uniaxial strain, to the bit."""
    problem = under_a_blade(60.0)
    (blade,) = problem.bodies
    problem = replace(problem, bodies=(replace(blade, stiffness=stiffness),))

    def contact_of(law):
        (contact,) = system_of(problem, law).contacts
        return contact

    drained = KelvinVoigt()
    contact = contact_of(drained)
    modulus = _modulus(drained, n_points_of(problem.mesh))
    assert contact.smoothing == ONSET * modulus / contact.stiffness
    undrained = contact_of(KelvinVoigt(lame=drained.lame + 22000.0))
    assert 0.5 < undrained.smoothing / contact.smoothing < 2.0


def test_contact_of_plant_cells_with_undrained_sap_sets_in_as_with_drained_sap():
    problem = under_a_blade(60.0)
    (blade,) = problem.bodies
    problem = replace(problem, bodies=(replace(blade, stiffness=0.4),))
    distances = []
    for sap_bulk_modulus in (0.0, 2200.0):
        cell = living_cell("apple", arrangement="hexagon", sap_bulk_modulus=sap_bulk_modulus)
        (contact,) = system_of(problem, RveLaw(cell)).contacts
        distances.append(contact.smoothing)
    assert 0.5 < distances[1] / distances[0] < 2.0
