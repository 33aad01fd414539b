"""Equilibrium at rest, by steps and as motion comes to it, how it fails, and modes about it."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import eigh

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import Status, describe
from surrofe2.macro import MacroSettings, Rest, find_modes, find_rest, modes, simulate
from surrofe2.macro.elements import make_discretisation
from surrofe2.macro.rest import STEP_ADVICE, RestState
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import (
    Fixed,
    Foundation,
    Plane,
    PrescribedMotion,
    Pressure,
    Problem,
    RigidBody,
    Symmetry,
    Traction,
    rectangle,
)
from surrofe2.rve import RveLaw
from tests.laws import Fibres, KelvinVoigt, LinearFirstPiola, Memoryless, PointStates, failing
from tests.macro.bars import SQUARE
from tests.macro.meshes import plate, sides_of

SETTINGS = MacroSettings(newton_tolerance=1e-10)


def test_singular_stiffness_is_a_sentence():
    """Fibres along x bear no load in y, nor does their tangent."""
    with pytest.raises(SimulationError, match="the stiffness is singular"):
        find_rest(SQUARE, Fibres(), SETTINGS)


def test_overdamped_motion_comes_to_the_same_rest():
    law = KelvinVoigt(shear_viscosity=200.0, bulk_viscosity=200.0)
    rest = find_rest(SQUARE, law, SETTINGS)
    settings = MacroSettings(integrator="implicit")
    end = simulate(replace(SQUARE, duration=400.0), law, settings).curve.displacement[-1]
    np.testing.assert_allclose(rest.watched, end, rtol=1e-4)


@dataclass
class Drifting(KelvinVoigt):
    """A law whose stress at rest is off by some rounding, by another one at each call."""

    error: float = 0.0  # µN/µm
    beyond: float = 0.0  # stretch from which on it is
    calls: int = 0

    def stress(self, F, F_dot):
        self.calls += 1
        random = np.random.default_rng(self.calls)
        error = self.error * random.standard_normal(F.shape)
        is_reached = F[:, 0, 0] - 1.0 >= self.beyond
        return super().stress(F, F_dot) + np.where(is_reached[:, None, None], error, 0.0)


def test_stresses_of_elements_bear_the_load():
    """A stiff pressure counts at the centre of an element: plain means are off by 15 %."""
    pull = PrescribedMotion(name="pull", on="right", displacement=(1.0, 0.0))
    problem = replace(SQUARE, conditions=(Fixed(on="left"), pull))
    rest = find_rest(problem, KelvinVoigt(lame=8000.0), SETTINGS)
    width, height = np.ptp(problem.mesh.p, axis=1)
    assert rest.element_F[:, 0, 0].mean() == pytest.approx(1.0 + 1.0 / width, rel=1e-12)
    turned = np.linalg.inv(rest.element_F).transpose(0, 2, 1)
    P = np.linalg.det(rest.element_F)[:, None, None] * rest.element_stress @ turned
    _, pulling = rest.forces
    assert P[:, 0, 0].mean() * height == pytest.approx(pulling[0], rel=1e-12)


def test_an_unloaded_tissue_rests_to_the_rounding_of_its_law():
    """At factor 0 no force is there to which the rounding could be compared."""
    pull = PrescribedMotion(name="pull", on="right", displacement=(1.0, None))
    problem = replace(SQUARE, conditions=(Symmetry(on="left"), Symmetry(on="bottom"), pull))
    modulus = KelvinVoigt().lame
    rounding = 1e-8 * modulus * MacroSettings().absolute_tolerance
    rest = find_rest(problem, Drifting(error=rounding), load_steps=1)
    exact = find_rest(problem, KelvinVoigt(), load_steps=1)
    np.testing.assert_allclose(rest.u, exact.u, atol=0.01 * MacroSettings().absolute_tolerance)
    with pytest.raises(InputError, match=r"macro.newton_tolerance: 1e-08; at load factor 0"):
        find_rest(problem, Drifting(error=100.0 * rounding), load_steps=1)


def test_rounding_on_the_way_to_a_load_leaves_the_path():
    """The law is exact up to half of the stretch, and then less than Newton's method asks for."""
    pull = PrescribedMotion(name="pull", on="right", displacement=(1.0, None))
    problem = replace(SQUARE, conditions=(Symmetry(on="left"), Symmetry(on="bottom"), pull))
    law = Drifting(error=1e-7, beyond=0.5 / np.ptp(SQUARE.mesh.p[0]))
    with pytest.raises(SimulationError, match=r"macro.newton_tolerance: 1e-08; at load") as caught:
        find_rest(problem, law, load_steps=4)
    assert 0.25 <= caught.value.partial.factor < 0.51
    assert not caught.value.partial.finished


def test_path_does_not_matter_for_an_elastic_bar():
    law = KelvinVoigt()
    at_once = find_rest(SQUARE, law, SETTINGS, factor=4.0)
    in_steps = find_rest(SQUARE, law, SETTINGS, factor=4.0, load_steps=5)
    np.testing.assert_allclose(in_steps.u, at_once.u, atol=1e-8 * abs(at_once.u).max())
    np.testing.assert_allclose(in_steps.path[:, 0], [0.0, 0.8, 1.6, 2.4, 3.2, 4.0], rtol=1e-12)
    np.testing.assert_array_equal(in_steps.path[-1, 1:], in_steps.watched)
    assert in_steps.counts["load_steps"] == 5
    assert repr(in_steps).startswith("<Rest: 4 elements, factor 4 in 5 load steps, finished; ")


def tapered(along, elements=(12, 6)):
    """A block of 60 × 30 µm, half as high on the right, whose right side is moved by `along`."""
    mesh = rectangle(60.0, 30.0, elements)
    x, y = mesh.p
    mesh = replace(mesh, doflocs=np.array([x, 15.0 + (y - 15.0) * (1.0 - x / 120.0)]))
    moved = PrescribedMotion(on="right", displacement=along)
    return Problem(mesh=mesh, conditions=(Fixed(on="left"), moved))


@pytest.mark.parametrize("along", [(-12.0, 0.0), (24.0, 0.0), (0.0, 15.0)])
@pytest.mark.parametrize("elements", [(12, 6), (24, 12)])
def test_prescribed_motion_goes_through_the_tangent(along, elements):
    """A fifth of its length at once: as many factorisations as a predictor and Newton's steps;
    25 and 3 halvings where the first displacement moves the side alone."""
    at_once = find_rest(tapered(along, elements), KelvinVoigt(), SETTINGS)
    assert at_once.counts["halvings"] == 0
    assert at_once.counts["factorisations"] <= 5
    in_steps = find_rest(tapered(along, elements), KelvinVoigt(), SETTINGS, load_steps=8)
    np.testing.assert_allclose(in_steps.u, at_once.u, atol=1e-7 * abs(at_once.u).max())


class SinglePrecision(KelvinVoigt):
    """Its stress is rounded to seven digits."""

    def stress(self, F, F_dot):
        return super().stress(F, F_dot).astype(np.float32).astype(np.float64)


def test_a_tolerance_below_rounding_is_refused():
    """What the message asks for can be reached."""
    tight, law = MacroSettings(newton_tolerance=1e-9), SinglePrecision()
    problem = tapered((6.0, 0.0))
    with pytest.raises(InputError, match=r"newton_tolerance: 1e-09; .* ask for at") as caught:
        find_rest(problem, law, tight)
    enough = float(str(caught.value).split()[-1])
    assert enough < 1e-5
    find_rest(problem, law, replace(tight, newton_tolerance=enough))


def test_a_body_that_nothing_holds_is_named():
    block = rectangle(30.0, 20.0, (3, 2))
    pull = Traction(on="right", traction=(0.1, 0.0))
    free = Problem(mesh=block, conditions=(pull,))
    hinged = replace(free, conditions=(pull, Symmetry(on="left")))
    plate = RigidBody(name="plate", shape=Plane(normal=(0.0, -1.0)), on="top",
                      position=(0.0, 25.0), mass=1.0)  # fmt: skip
    loose = Problem(mesh=block, conditions=(Fixed(on="bottom"), pull), bodies=(plate,))
    for problem, message in (
        (free, r"tissue along x, .* along y, .* in rotation \(3 free"),
        (hinged, r"holds the tissue along y \(1 free rigid motion"),
        (loose, r"holds plate along x, plate along y \(2 free"),
    ):
        with pytest.raises(InputError, match=message):
            find_rest(problem, KelvinVoigt())
    held = Foundation(on="bottom", stiffness=0.2)
    assert find_rest(replace(free, conditions=(pull, held)), KelvinVoigt()).factor == 1.0
    assert find_rest(free, KelvinVoigt(), factor=0.0).factor == 0.0


def dragged(along, friction, load_steps=4, press=0.4, **steps_on):
    """Forces on a block of a plate pressed on it and dragged along, and the rest they are of."""
    plate = RigidBody(
        name="plate", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, 20.0),
        displacement=(along, -press), friction=friction,
    )  # fmt: skip
    mesh, held = rectangle(30.0, 20.0, (3, 2)), (Fixed(on="bottom"),)
    problem = Problem(mesh=mesh, conditions=held, bodies=(plate,))
    rest = find_rest(problem, KelvinVoigt(), load_steps=load_steps, **steps_on)
    return rest.forces[rest.system.force_names.index("plate")], rest


def test_a_plate_sticks_or_slips_by_coulombs_law():
    """Dragged far it pulls by µ times its force; a little, it takes the side along as if glued."""
    (pull, push), _ = dragged(20.0, 0.1)
    assert pull == pytest.approx(-0.1 * push, rel=1e-6)
    (_, smooth), _ = dragged(20.0, 0.0)
    assert push == pytest.approx(smooth, rel=0.05)
    (pull, push), stuck = dragged(0.01, 5.0)
    top = sides_of(stuck.system.problem.mesh, "top")
    np.testing.assert_allclose(stuck.u[np.unique(top), 0], 0.01, atol=0.3 * 0.01)
    assert 0.0 < pull < 0.05 * abs(push)


def test_a_plate_is_dragged_from_sticking_to_slipping():
    """Where some points stick and others slip, too, in the load steps asked for; Newton's method
    threw points from slipping one way to slipping the other and halved the steps to nothing."""
    friction = 0.3
    pulls = []
    for along in (0.2, 0.5, 1.0, 2.0, 3.0, 6.0):
        (pull, push), rest = dragged(along, friction, load_steps=10, press=1.0)
        assert rest.counts["halvings"] == 0
        assert rest.counts["factorisations"] < 100
        (contact,) = rest.system.contacts
        gap, *_ = contact._gaps(rest.u)
        pressure, *_ = contact._pressure(-gap, 0.0 * gap)
        assert (abs(rest.drags["plate"]) <= friction * pressure * (1.0 + 1e-9)).all()
        pulls.append(-pull / push)
    assert pulls == sorted(pulls)
    assert pulls[0] < 0.2 * friction
    assert pulls[-1] <= friction * (1.0 + 1e-6)


def test_friction_at_rest_goes_on_from_where_it_was():
    reached = []
    _, whole = dragged(1.0, 0.2, checkpoint=reached.append, checkpoint_interval=0.0)
    state = RestState.from_arrays(reached[2].to_arrays())
    assert abs(state.drags["plate"]).max() > 0.1
    _, resumed = dragged(1.0, 0.2, resume=state)
    frames = {"frames.displacement": state.journal["frames.displacement"][:0]}
    with pytest.raises(MismatchError, match="resume: keep_frame took the whole fields of"):
        dragged(1.0, 0.2, resume=RestState.from_arrays(state.to_arrays() | frames))
    for name, works in whole.energies.items():
        np.testing.assert_array_equal(resumed.energies[name], works, err_msg=name)
    np.testing.assert_array_equal(resumed.u, whole.u)
    np.testing.assert_array_equal(resumed.forces, whole.forces)


class BearsSteps(KelvinVoigt):
    """Fails where F is far from where it was accepted last."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, tangents=tangents)
        start = np.eye(2) if state is None else state
        answer.status[abs(F - start).max(axis=(1, 2)) > 0.008] = Status.NOT_CONVERGED
        return answer

    def accept(self, F, F_dot, response):
        return replace(super().accept(F, F_dot, response), state=F.copy())


def test_load_step_that_fails_is_halved():
    rest = find_rest(SQUARE, BearsSteps(), SETTINGS)
    assert rest.counts["halvings"] > 0
    assert rest.factor == 1.0
    expected = find_rest(SQUARE, KelvinVoigt(), SETTINGS)
    np.testing.assert_allclose(rest.u, expected.u, atol=1e-7 * abs(expected.u).max())


def test_load_that_cannot_be_borne_ends_with_the_last_rest():
    law = failing(KelvinVoigt(), fails=lambda F, F_dot: abs(F[:, 1, 0]) > 0.015)
    with pytest.raises(SimulationError, match=r"10 halvings: point .*load factor 0\.") as caught:
        find_rest(SQUARE, law, SETTINGS)
    assert describe(Status.NOT_CONVERGED).endswith(STEP_ADVICE)
    assert "did not converge, in load steps however small" in str(caught.value)
    assert str(caught.value).count("point ") == 1, "the point that has no stress, and no other"
    partial = caught.value.partial
    assert isinstance(partial, Rest)
    assert 0.1 < partial.factor < 1.0
    assert 0.0145 < abs(partial.F[:, 1, 0]).max() <= 0.015
    expected = find_rest(SQUARE, KelvinVoigt(), SETTINGS, factor=partial.factor)
    np.testing.assert_allclose(partial.u, expected.u, atol=1e-7 * abs(expected.u).max())


class Yields(KelvinVoigt):
    """Bears less the more it is sheared: σ falls as 1/(1 + (|F₂₁|/0.05)²)."""

    def stress(self, F, F_dot):
        return super().stress(F, F_dot) / (1.0 + (F[:, 1, 0] / 0.05) ** 2)[:, None, None]

    def slopes(self, F, F_dot):
        return Memoryless.slopes(self, F, F_dot)


def test_a_limit_load_is_named():
    """The path up to it is kept, and the same body follows a motion beyond it."""
    with pytest.raises(SimulationError, match=r"^limit load at factor \d+(\.\d+)?: ") as caught:
        find_rest(SQUARE, Yields(), SETTINGS, factor=40.0, load_steps=10)
    message = str(caught.value)
    assert "prescribe the motion instead of the force, or run in time" in message
    path = caught.value.partial.path
    assert f"factor {path[-1, 0]:.4g}: " in message
    rates = abs(np.diff(path[:, 2]) / np.diff(path[:, 0]))
    assert rates[-1] > 3.0 * rates[0]
    law = failing(KelvinVoigt(), fails=lambda F, F_dot: abs(F[:, 1, 0]) > 0.015)
    with pytest.raises(SimulationError, match=r"^no load step succeeds"):
        find_rest(SQUARE, law, SETTINGS)


@pytest.mark.parametrize(
    ("status", "verdict"),
    [
        (Status.UNSTABLE, r"plant cells have no stable equilibrium beyond load factor 0\.\d+"),
        (Status.NOT_CONVERGED, r"the solver of RVEs gave up beyond load factor 0\.\d+"),
        (Status.OK, r"Newton's method for the tissue gave up beyond load factor \d+"),
    ],
)
def test_the_end_of_a_path_says_who_failed(status, verdict):
    """Plant cells without an equilibrium, or a solver, and what to do. That every point has a
    stress does not acquit the plant cells: `Yields` softens, so that its tissue has a limit load.
    """
    law, factor = Yields(), 40.0
    if status != Status.OK:
        law, factor = failing(KelvinVoigt(), fails=lambda F, F_dot: F[:, 1, 0] < -0.015), 1.0
        law.code = status
    with pytest.raises(SimulationError, match=verdict) as caught:
        find_rest(SQUARE, law, SETTINGS, factor=factor, load_steps=4)
    assert "no limit of the plant cells" not in str(caught.value)
    assert re.search("use the path up to there|a run in time may carry on", str(caught.value))


def test_newtons_end_beyond_a_bifurcation_is_said_with_its_likely_reason():
    """The stress of a buckled RVE has corners, which no smaller load step makes smooth."""

    class Buckles(Yields):
        def respond(self, F, F_dot, state=None, **entries):
            answer = super().respond(F, F_dot, state, **entries)
            return replace(answer, state=PointStates(F.copy(), leaves_above=1.0))

        def beyond_bifurcation(self, state):
            return state.left_points

    with pytest.raises(SimulationError, match="Newton's method for the tissue gave up") as caught:
        find_rest(SQUARE, Buckles(), SETTINGS, factor=40.0, load_steps=4)
    at_end = caught.value.partial
    buckled = int((at_end.F[:, 0, 0] > 1.0).sum())
    assert 0 < buckled < len(at_end.F)
    reason = f"; {buckled} of {len(at_end.F)} points have left a bifurcation"
    assert reason in str(caught.value)


def test_a_motion_past_a_limit_point_is_not_advised_again():
    """The foot yields and what pulls it is soft, so that it snaps while the motion stands still."""
    mesh = rectangle(60.0, 20.0, (6, 2))
    pulled = Problem(
        mesh=mesh,
        conditions=(
            Fixed(on="left"),
            PrescribedMotion(on="right", displacement=(None, -30.0)),
        ),
        duration=1.0,
        watched={"foot": (10.0, 10.0)},
    )
    x = make_discretisation(mesh).point_positions()[:, 0]
    points = {"foot": np.flatnonzero(x < 10.0), "soft": np.flatnonzero(x > 10.0)}
    law = RegionalLaw({"foot": Yields(), "soft": KelvinVoigt(6.0, 8.0)}, points)
    with pytest.raises(SimulationError, match=r"^limit point at factor 0\.8") as caught:
        find_rest(pulled, law, SETTINGS, load_steps=10)
    assert "the tissue snaps to another one, so run in time" in str(caught.value)
    assert "prescribe" not in str(caught.value)


def test_progress_is_shown_where_it_is_asked_for(capsys):
    find_rest(SQUARE, KelvinVoigt(), SETTINGS, load_steps=2, progress=True)
    shown = capsys.readouterr().err
    assert "0.0 % of 1 in " in shown
    assert "100.0 % of 1 in " in shown
    assert shown.count("\n") == 1
    assert shown.endswith("\n")
    law = failing(KelvinVoigt(), fails=lambda F, F_dot: abs(F[:, 1, 0]) > 0.015)
    with pytest.raises(SimulationError):
        find_rest(SQUARE, law, SETTINGS, progress=True)
    assert capsys.readouterr().err.endswith(" \n"), "also where it fails"
    find_rest(SQUARE, KelvinVoigt(), SETTINGS, progress=False)
    assert capsys.readouterr().err == ""


def test_bar_of_rves_rests_where_it_swings_about():
    """First minimum of a lightly damped bar is about twice the displacement at rest: docs/theory.md
    has −31.9 µm and the decrement 0.0411, so half of it times 1 + exp(−0.0411/2) and the second
    mode's share apart, −16.1 µm; ways to initialise agree where nothing moves."""
    rests = [
        find_rest(LoadCase(), RveLaw(CellParameters.preset("water"), initialisation=name))
        for name in ("elastic", "constrained-runs", "slow-manifold")
    ]
    assert rests[0].watched[1] == pytest.approx(-31.9 / (1.0 + np.exp(-0.0411 / 2)), rel=0.02)
    for other in rests[1:]:
        np.testing.assert_allclose(other.u, rests[0].u, atol=1e-6)


def test_stiffness_is_symmetric_without_load_and_nearly_so_with_it():
    """Deviator and pressure of the Cauchy stress at different points have no common potential
    but where F is uniform."""
    law = RveLaw(CellParameters.preset("printed"), initialisation="elastic")
    for factor, allowed in ((0.0, 1e-7), (1.0, 3e-3)):
        K = find_rest(LoadCase(), law, factor=factor).stiffness.toarray()
        assert abs(K - K.T).max() < allowed * abs(K).max()


def test_works_are_of_second_order_in_the_load_step():
    works = [
        find_rest(SQUARE, KelvinVoigt(), SETTINGS, factor=3.0, load_steps=n).energies["internal"]
        for n in (4, 8, 16)
    ]
    last = [each[-1] for each in works]
    assert [len(each) for each in works] == [5, 9, 17]
    assert np.log2((last[1] - last[0]) / (last[2] - last[1])) == pytest.approx(2.0, abs=0.1)


def test_internal_work_is_the_energy_stored(rng):
    """½ (F − I) : C : (F − I) over the triangles, of a law that has it, at every load step."""
    law, frames = LinearFirstPiola(shear_modulus=5.0, lame=3.0), []
    conditions = (
        Fixed(on="left"),
        PrescribedMotion(on="right", displacement=(4.0, -1.0)),
        Pressure(on="top", pressure=1.0),
        Foundation(on="bottom", stiffness=0.2),
    )
    pressed = Problem(mesh=plate("triangles", rng), conditions=conditions)
    each_step = {"checkpoint": frames.append, "checkpoint_interval": 0.0}
    rest = find_rest(pressed, law, SETTINGS, load_steps=10, **each_step)
    space, energies = rest.system.discretisation, rest.energies
    stored = []
    for at in frames:
        H = at.F - np.eye(2)
        strain = 0.5 * (H + H.swapaxes(1, 2))
        trace = np.trace(H, axis1=1, axis2=2)
        density = law.shear_modulus * np.einsum("nij,nij->n", strain, strain)
        stored.append(space.weights.ravel() @ (density + 0.5 * law.lame * trace**2))
    np.testing.assert_allclose(energies["internal"], stored, atol=1e-6 * stored[-1])
    u = np.array([at.u.ravel() for at in frames])
    foundation = next(each for each in rest.system.forces if each.name == "foundation bottom")
    spring = 0.5 * np.einsum("sm,sm->s", u @ foundation.slopes_at_one[0], u)
    np.testing.assert_allclose(energies["foundation bottom"], -spring, atol=1e-6 * stored[-1])
    assert abs(energies["motion"][-1]) > 0.5 * stored[-1]
    assert abs(energies["balance"]).max() < 1e-7 * stored[-1]


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_energies_of_a_plate_that_presses_and_drags(friction):
    """The balance closes; what the plate does is stored in tissue and contact, or rubbed away."""
    _, rest = dragged(3.0, friction, load_steps=20)
    energies = rest.energies
    largest = abs(energies["motion"]).max()
    assert abs(energies["balance"]).max() < 1e-6 * largest
    lost = energies["contact dissipated"]
    kept = energies["internal"] + energies["contact"]
    np.testing.assert_allclose(energies["motion"], kept + lost, atol=1e-6 * largest)
    assert energies["contact"][-1] > 0.0
    if friction:
        assert lost[-1] > 0.05 * largest
    else:
        assert abs(lost).max() < 2e-3 * largest


BAR = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0))
# Damping in proportion to stiffness, at F = I: 2 η = 2 µ τ, ζ − η = λ τ.
TAU = 0.05
PROPORTIONAL = KelvinVoigt(
    shear_modulus=60.0, lame=80.0, shear_viscosity=60.0 * TAU, bulk_viscosity=140.0 * TAU
)


def test_proportional_damping():
    """C = τ K: λ² + τ ω² λ + ω² = 0 for each undamped ω, mode shapes undamped ones."""
    rest = find_rest(BAR, PROPORTIONAL, factor=0.0)
    K = rest.stiffness.toarray()
    np.testing.assert_allclose(rest.damping.toarray(), TAU * K, atol=1e-10 * abs(K).max())
    omega2, shapes = eigh(K, rest.system.free_mass.toarray())
    omega = np.sqrt(omega2[:5])
    found = find_modes(rest, 5)
    damping = 0.5 * TAU * omega
    np.testing.assert_allclose(found.damping_ratios, damping, rtol=1e-8)
    turn = 2.0 * np.pi / np.sqrt(1.0 - damping**2)
    np.testing.assert_allclose(found.periods, turn / omega, rtol=1e-8)
    np.testing.assert_allclose(found.decrements, damping * turn, rtol=1e-8)
    for shape, undamped in zip(found.shapes, shapes.T, strict=False):
        undamped = undamped / undamped[abs(undamped).argmax()]
        free = np.isin(np.arange(shape.size), rest.system.free)
        np.testing.assert_allclose(abs(shape.ravel()[free]), abs(undamped), atol=1e-6)
        assert not shape.ravel()[~free].any()
    assert found.stable


def test_longitudinal_modes_of_a_bar():
    """Without lateral contraction and as long as it is slender: ω = (j + ½) π c/W, c² = E/ρ."""
    law = KelvinVoigt(shear_modulus=60.0, lame=0.0, shear_viscosity=0.0, bulk_viscosity=0.0)
    slender = LoadCase(width=100.0, height=1.0, watched=(100.0, 0.5), elements=(32, 1))
    rest = find_rest(slender, law, factor=0.0)
    found = find_modes(rest, 60)
    along = abs(found.shapes[:, :, 0]).max(axis=1) > 0.99
    across = abs(found.shapes[:, :, 1]).max(axis=1) < 0.05
    speed = np.sqrt(2.0 * 60.0 / law.density)
    expected = (np.arange(2) + 0.5) * np.pi * speed / 100.0
    omega = found.eigenvalues.imag[along & across][:2]
    np.testing.assert_allclose(omega, expected, rtol=5e-3)


def test_sparse_agrees_with_dense(monkeypatch):
    rest = find_rest(BAR, PROPORTIONAL)
    dense = find_modes(rest, 4)
    monkeypatch.setattr(modes, "DENSE_LIMIT", 0)
    sparse = find_modes(rest, 4)
    np.testing.assert_allclose(sparse.eigenvalues, dense.eigenvalues, rtol=1e-8)
    np.testing.assert_allclose(abs(sparse.shapes), abs(dense.shapes), atol=1e-6)


def test_overdamped_motions_creep():
    law = replace(PROPORTIONAL, shear_viscosity=6000.0, bulk_viscosity=14000.0)
    found = find_modes(find_rest(BAR, law, factor=0.0))
    assert found.periods.size == 0
    assert found.creeping.size == 2 * 40
    assert found.creeping.max() < 0.0
    assert found.stable


def test_bar_of_rves_has_the_period_and_damping_of_its_motion():
    """`water` on 4 × 4 (validation/paper.md), 250 µs: period 49.5 and these decrements."""
    for name, decrement in (
        ("elastic", 0.0678),
        ("constrained-runs", 0.0495),
        ("slow-manifold", 0.0411),
    ):
        law = RveLaw(CellParameters.preset("water"), initialisation=name)
        found = find_modes(find_rest(LoadCase(), law), 1)
        assert found.periods[0] == pytest.approx(49.5, rel=2e-3)
        assert found.decrements[0] == pytest.approx(decrement, rel=1e-2)
        assert found.stable
