"""From motion to forces in one pass: what the two passes give, and where it does not answer."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.cache import CachedLaw
from surrofe2.cache.settings import CacheSettings
from surrofe2.element_kernels import deformation_of_points
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.discretisation import make_discretisation
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.evaluation import Evaluation, Stage
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from surrofe2.macro.system import make_system
from surrofe2.sampling import SamplingRange
from tests.laws import TrueLattice
from tests.macro.bars import bar_system, random_state, state_vector
from tests.macro.meshes import KINDS, plate
from tests.surrogate.networks import with_bound

ANY = CacheSettings(tolerance=np.inf)
NONE = np.empty(0, dtype=np.intp)
SMALL = SamplingRange(stretch=(0.98, 1.02), shear=0.03, rate=0.006)


@pytest.fixture
def rng():
    return np.random.default_rng(37)


@pytest.fixture
def answering(law):
    """Everywhere in its range."""
    return replace(law, domain=None)


def motion_of(space, rng, size=0.01):
    """u and v (n, 2) with strains of about this size."""
    x = space.nodes
    u, v = (factor * x @ rng.uniform(-1.0, 1.0, (2, 2)) for factor in (size, 0.3 * size))
    return u + 0.02 * size * rng.normal(size=u.shape), v + 0.02 * size * rng.normal(size=u.shape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("elements", [(4, 3), (29, 23)])
def test_forces_are_those_of_the_stresses_looked_up(kind, elements, answering, rng):
    """To the bit: by one core and by several, whatever is left over behind the last block."""
    space = make_discretisation(plate(kind, rng, elements, distortion=0.05))
    motion = motion_of(space, rng)
    F, F_dot, _ = deformation_gradient(space, *motion)
    stress, status, _ = answering.lookup(F, F_dot)
    assert not status.any()
    forces = answering.motion_to_forces(space.arrays, motion, np.inf, NONE)
    total = np.zeros_like(space.nodes)
    for nodes, force in zip(space.elements, forces, strict=True):
        for node, each in zip(nodes, force, strict=True):
            total[node] += each
    np.testing.assert_array_equal(total, internal_force(space, F, stress))


def test_points_that_are_held_give_no_force_and_need_no_stress(answering, rng):
    space = make_discretisation(plate("quads", rng))
    u, v = motion_of(space, rng)
    F, F_dot, _ = deformation_gradient(space, u, v)
    held = np.array([3, 4, 17])
    stress = answering.lookup(F, F_dot)[0]
    stress[held] = 0.0
    forces = answering.motion_to_forces(space.arrays, (u, v), np.inf, held)
    total = np.zeros_like(space.nodes)
    np.add.at(total, space.elements, forces)
    expected = internal_force(space, F, stress)
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-14 * abs(expected).max())

    narrow = replace(answering, range=SMALL)
    far = 1.05 * F[held[0]] - F[held[0]]  # beyond the range everywhere
    u = u + space.nodes @ far.T
    assert narrow.motion_to_forces(space.arrays, (u, v), np.inf, NONE) is None
    everything = np.arange(space.n_points)
    assert not narrow.motion_to_forces(space.arrays, (u, v), np.inf, everything).any()
    assert narrow.motion_to_forces(space.arrays, (u, v), np.inf, everything[1:]) is None


def test_points_that_are_not_trusted_have_no_forces(answering, rng):
    """By the bound of each point, and at none by a tolerance of which it is the largest."""
    law = with_bound(answering)
    space = make_discretisation(plate("quads", rng))
    u, v = motion_of(space, rng)
    F, F_dot, _ = deformation_gradient(space, u, v)
    bound = law.lookup(F, F_dot)[2]
    worst = bound.max()
    assert np.isfinite(worst)
    assert law.motion_to_forces(space.arrays, (u, v), worst, NONE) is not None
    assert law.motion_to_forces(space.arrays, (u, v), 0.999 * worst, NONE) is None
    held = (bound > 0.999 * worst).nonzero()[0]
    assert law.motion_to_forces(space.arrays, (u, v), 0.999 * worst, held) is not None


@pytest.mark.parametrize("spoilt", [np.nan, -60.0])
def test_an_inverted_element_has_no_forces_even_where_points_are_held(spoilt, answering, rng):
    space = make_discretisation(plate("quads", rng))
    u, v = motion_of(space, rng)
    u[space.elements[5, 2]] = spoilt
    of_element = np.arange(space.n_points)
    assert answering.motion_to_forces(space.arrays, (u, v), np.inf, NONE) is None
    assert answering.motion_to_forces(space.arrays, (u, v), np.inf, of_element) is None


def test_deformation_of_some_points_is_that_of_all(rng):
    space = make_discretisation(plate("curved triangles", rng))
    u, v = motion_of(space, rng)
    points = np.array([40, 3, 5, 4, 41])
    F, F_dot, _ = deformation_gradient(space, u, v)
    found = deformation_of_points(points, space.arrays, u, v)
    np.testing.assert_array_equal(found[0], F[points])
    np.testing.assert_array_equal(found[1], F_dot[points])


class Slow(CachedLaw):
    """Goes no short way."""

    element_forces = None


@pytest.mark.parametrize("narrow", [False, True])
def test_a_stage_has_the_rate_of_an_evaluation(narrow, answering, rng):
    """To the bit where all points are hits, to rounding with points on the fallback."""
    surrogate = replace(answering, range=SMALL) if narrow else answering
    system = bar_system(LoadCase(width=60.0, height=40.0, watched=(60.0, 20.0)), (9, 6))
    equations = EquationsOfMotion(system, CachedLaw(surrogate, TrueLattice(), ANY))
    u, v = random_state(system, rng, 0.12)
    y = state_vector(system, u, 0.01 * v)
    start = equations.begin(0.0, y)
    while not isinstance(start, Evaluation):
        start = equations.restart_step(start.points)
    held = len(equations.law_state.on_fallback)
    assert (held > 0) == narrow
    before = dict(equations.law.counts)
    found, expected = equations.stage(0.1, y), equations.evaluate(0.1, y)
    assert type(found) is Stage
    scale = abs(expected.rate).max()
    np.testing.assert_allclose(found.rate, expected.rate, rtol=0, atol=1e-14 * scale * narrow)
    np.testing.assert_allclose(found.powers, expected.powers, rtol=1e-11)
    assert equations.law.counts == before


def test_a_run_is_the_same_and_costs_the_same_counts(answering):
    """With points that switch to the fallback and back."""
    load_case = LoadCase(
        width=60.0, height=60.0, body_force=(0.0, -0.2), watched=(60.0, 30.0), duration=6.0,
        output_interval=0.5,
    )  # fmt: skip
    settings = MacroSettings(elements=(3, 3))
    surrogate = replace(
        answering, range=SamplingRange(stretch=(0.999, 1.001), shear=0.02, rate=0.01)
    )
    runs, laws = [], []
    for kind in (CachedLaw, Slow):
        laws.append(kind(surrogate, TrueLattice(), replace(ANY, audit=0.05)))
        runs.append(simulate(load_case, laws[-1], settings))
    fast, slow = runs
    assert laws[0].counts == laws[1].counts
    assert laws[0].counts["switched"] > 0
    assert fast.counts == slow.counts
    assert fast.effort == slow.effort
    size = abs(slow.curve.displacement).max()
    np.testing.assert_allclose(
        fast.curve.displacement, slow.curve.displacement, rtol=0, atol=1e-12 * size
    )


def test_what_cannot_go_the_short_way_is_evaluated(answering, rng):
    """A stage beyond the range is a switch, as an evaluation would have it."""
    system = make_system(bar_system(LoadCase(), (3, 3)).problem, TrueLattice.density)
    law = CachedLaw(replace(answering, range=SMALL), TrueLattice(), ANY)
    equations = EquationsOfMotion(system, law)
    equations.begin(0.0, np.zeros(2 * system.free.size))
    u, v = random_state(system, rng, 4.0)
    y = state_vector(system, u, 0.0 * v)
    switched = equations.stage(0.1, y)
    np.testing.assert_array_equal(switched.points, equations.evaluate(0.1, y).points)
    assert switched.points.any()
