"""Free sides with a surface law: forces, slopes, energies, rest, known answers."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.macro import MacroSettings, find_modes, find_rest, simulate
from surrofe2.macro.elements import make_discretisation
from surrofe2.macro.free_sides import free_sides
from surrofe2.macro.system import make_system
from surrofe2.problem import (
    BodyForce,
    Box,
    Fixed,
    InitialVelocity,
    Plane,
    Problem,
    RigidBody,
    Surface,
    Symmetry,
    rectangle,
    with_boundaries,
    with_regions,
)
from surrofe2.problem.mesh import element_nodes
from tests.laws import KelvinVoigt, LinearFirstPiola, Skin
from tests.macro.bars import SETTINGS, assert_same_run, resumed, run_and_states
from tests.macro.meshes import HEIGHT, KINDS, WIDTH, plate, sides_of, triangles
from tests.macro.test_macro_tangents import assert_slopes

LAW = KelvinVoigt()
RADIUS = 10.0
SKIN = Skin(a=30.0, b=400.0, c=900.0, eta=70.0, d=2.0)
MIRRORS = (Symmetry(on="left"), Symmetry(on="bottom"))
TIGHT = MacroSettings(relative_tolerance=1e-8, absolute_tolerance=1e-10, newton_tolerance=1e-12)


def clamped(surface, mesh=None, **more):
    """A plate, clamped at the left, under its weight."""
    conditions = (Fixed(on="left"), BodyForce(acceleration=(0.3, -0.2)))
    mesh = rectangle(WIDTH, HEIGHT, (4, 3)) if mesh is None else mesh
    more = {"duration": 6.0, "output_interval": 0.25, **more}
    return Problem(mesh=mesh, conditions=conditions, surface=surface, **more)


def patch_of(mesh, side, law):
    """(q,) elements of the points that count for a side, and (q, k, 2) their weights times ∇N."""
    space = make_discretisation(mesh)
    first, last = mesh.p.T[side[:2]]
    along = (last - first) / np.linalg.norm(last - first)
    (beside,) = np.flatnonzero(np.isin(element_nodes(mesh), side[:2]).sum(axis=1) == 2)
    inside = mesh.p.T[element_nodes(mesh)[beside]].mean(axis=0) - first
    inward = inside - along * (along @ inside)
    inward /= np.linalg.norm(inward)
    found = []
    for k, at in enumerate(space.point_positions() - 0.5 * (first + last)):
        e, q = divmod(k, space.points_per_element)
        if not (space.pressure_apart and q == 4):
            near = abs(at @ along) <= 0.5 * law.width and 0.0 <= at @ inward <= 2.0 * law.depth
            if near or e == beside:
                found.append((e, q, at @ inward, space.weights[e, q]))
    e, q, depth, area = (np.array(each) for each in zip(*found, strict=True))
    mean = np.average(depth, weights=area)
    slope = (law.depth - mean) / np.average((depth - mean) ** 2, weights=area)
    weight = area / area.sum() * (1.0 + slope * (depth - mean))
    assert weight @ depth == pytest.approx(law.depth)
    return e, weight[:, None, None] * space.gradients[e, q]


def twin_force(mesh, sides, law, u, v):
    """Side by side: −∂/∂u of L P_s λ(F̄ T)."""
    force = np.zeros_like(u)
    for nodes in sides:
        start, end = mesh.p.T[nodes[:2]]
        length = np.linalg.norm(end - start)
        elements, gradients = patch_of(mesh, nodes, law)
        slopes, own = gradients @ (end - start) / length, element_nodes(mesh)[elements]
        g = (end - start) / length + np.einsum("qa,qai->i", slopes, u[own])
        stretch = np.linalg.norm(g)
        rate = g @ np.einsum("qa,qai->i", slopes, v[own]) / stretch
        pull = law.respond(np.array([stretch]), np.array([rate])).tension[0]
        np.add.at(force, own, -length * pull * slopes[..., None] * g / stretch)
    return force


@pytest.mark.parametrize(("depth", "width"), [(0.0, 0.0), (3.0, 9.0), (-1.0, 0.0)])
@pytest.mark.parametrize("kind", KINDS)
def test_force_is_that_of_plain_numpy_and_slopes_are_its_derivatives(kind, depth, width, rng):
    mesh = plate(kind, rng, (3, 2), bulge=0.4)
    law = replace(SKIN, depth=depth, width=width)
    surface = Surface(law=law, on=("right", "top"))
    system = make_system(clamped(surface, mesh), 0.08)
    u, v = rng.uniform(-0.5, 0.5, (2, system.n_rows, 2))
    sides = np.concatenate([sides_of(mesh, name) for name in surface.on])
    force = system.surface.at(0.0, 0.0, u, v)
    np.testing.assert_allclose(force, twin_force(mesh, sides, law, u, v), rtol=1e-9, atol=1e-9)
    slopes = assert_slopes(system.surface, u, v)
    assert abs(slopes[0] - slopes[0].T).max() > 0.02  # the rate's part is not symmetric
    moved = system.surface.from_rest(u)
    np.testing.assert_allclose(moved.at(0.0, 0.0, 0.0 * u, v), force, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize(("elements", "depth"), [((8, 2), 1.0), ((8, 4), 2.5), ((32, 8), 1.5)])
def test_a_side_acts_at_its_depth_in_bending(elements, depth):
    """u_x = −κ x y, u_y = κ x²/2: a side H/2 above the middle has the stretch at H/2 − d."""
    mesh, kappa, half = rectangle(40.0, 8.0, elements), 1e-8, 4.0
    problem = clamped(Surface(law=replace(SKIN, depth=depth, width=4.0), on=("top",)), mesh)
    x, y = mesh.p.T[:, 0], mesh.p.T[:, 1] - half
    u = kappa * np.stack([-x * y, 0.5 * x**2], axis=1)
    _, stretch, _ = make_system(problem, 0.08).surface._stretches(u, 0.0 * u)
    np.testing.assert_allclose(stretch - 1.0, -kappa * (half - depth), rtol=2e-3)


@pytest.mark.parametrize("integrator", ["explicit", "implicit"])
def test_a_law_of_zero_changes_no_bit(integrator):
    settings = MacroSettings(integrator=integrator, frames=4)
    bare, zero = (simulate(clamped(each), LAW, settings) for each in (None, Surface(law=Skin())))
    assert np.array_equal(zero.curve.displacement, bare.curve.displacement)
    for name in ("displacement", "velocity", "stress"):
        assert np.array_equal(getattr(zero.frames, name), getattr(bare.frames, name)), name
    scale = bare.energies["internal"].max()
    for name, values in bare.energies.items():  # sums of one more column round otherwise
        assert abs(zero.energies[name] - values).max() < 1e-13 * scale, name
    assert zero.counts["steps"] == bare.counts["steps"]
    assert not zero.energies["surface"].any()
    assert not zero.rest.any()
    assert zero.rest.size
    assert not bare.rest.size


def test_power_balance_and_what_the_surface_stores_and_dissipates():
    problem = clamped(Surface(law=SKIN, on=("top", "right")), output_interval=0.05)
    run = simulate(problem, LAW, TIGHT)
    work, scale = run.energies["surface"], abs(run.energies["surface"]).max()
    assert abs(run.energies["balance"]).max() < 1e-6 * scale
    system = make_system(problem, LAW.density).from_rest(run.rest)
    stored = []
    for u in (run.frames.displacement[0], run.frames.displacement[-1]):
        _, stretch, _ = system.surface._stretches(u, 0.0 * u)
        stored.append(system.surface.lengths @ SKIN.energy(stretch))
    dissipated = [run.energies[f"dissipated surface {name}"] for name in ("top", "right")]
    assert min(each.min() for each in dissipated) >= 0.0
    assert dissipated[0][-1] > 1e-3 * scale
    gone = work[-1] + (stored[1] - stored[0]) + sum(each[-1] for each in dissipated)
    assert abs(gone) < 1e-3 * sum(each[-1] for each in dissipated)  # samples are 0.1 µs apart


def test_displacements_count_from_the_rest_under_surface_tension():
    """Without load nothing moves, and the rest is that of a balance of all forces."""
    problem = replace(clamped(Surface(law=SKIN)), conditions=(Fixed(on="left"),), duration=1.0)
    run = simulate(problem, LAW, TIGHT)
    assert run.rest[:, 0].min() < -0.1
    assert abs(run.curve.displacement).max() < 1e-9
    far = problem.mesh.p.T[:, 0] == WIDTH
    spread = np.ptp(run.rest[far, 1])
    assert spread > 0.1
    rest = find_rest(problem, LAW, TIGHT, factor=0.0)
    np.testing.assert_array_equal(rest.system.rest, run.rest)
    assert abs(rest.u).max() < 1e-9


def test_rest_under_load_and_its_resumption():
    """With bodies, that are away while the tissue comes to rest and press it then."""
    plate_above = RigidBody(
        name="plate", shape=Plane(normal=(0.0, -1.0)), on="top", position=(0.0, HEIGHT),
        displacement=(0.0, -0.5),
    )  # fmt: skip
    problem = replace(clamped(Surface(law=SKIN, on=("top", "right"))), bodies=(plate_above,))
    reached = []
    kept = {"checkpoint": reached.append, "checkpoint_interval": 0.0}
    whole = find_rest(problem, LAW, TIGHT, load_steps=3, **kept)
    again = find_rest(problem, LAW, TIGHT, load_steps=3, resume=reached[1])
    np.testing.assert_array_equal(again.u, whole.u)
    np.testing.assert_array_equal(again.system.rest, whole.system.rest)
    bare = find_rest(replace(problem, bodies=()), LAW, TIGHT, factor=0.0)
    np.testing.assert_array_equal(whole.system.rest[:-1], bare.system.rest)


def test_a_run_goes_on_to_the_bit():
    problem = clamped(Surface(law=SKIN))
    whole, states = run_and_states(problem, LAW)
    middle = states[len(states) // 2]
    again = resumed(problem, LAW, SETTINGS, middle)
    assert_same_run(again, whole)
    assert np.array_equal(again.rest, whole.rest)
    for other in (None, Surface(law=SKIN, on=("top",))):
        with pytest.raises(MismatchError, match=r"surface: not that of the checkpoint"):
            simulate(replace(problem, surface=other), LAW, SETTINGS, resume=middle)


def test_a_rectangle_under_constant_tension_shrinks():
    """Across any cut the bulk bears the two tensions: mean σ_xx = −2 T/H, and mean ε = S σ."""
    law, tension = LinearFirstPiola(shear_modulus=60.0, lame=80.0), 1e-2
    mesh = rectangle(WIDTH, HEIGHT, (6, 5))
    both = replace(clamped(Surface(law=Skin(a=tension), on=("top", "right"))), mesh=mesh)
    rest = find_rest(replace(both, conditions=MIRRORS), law, factor=0.0)
    s = np.array([-tension / HEIGHT, -tension / WIDTH])  # a quarter: one side across each cut
    mean = (s - 80.0 / (2 * 60.0 + 2 * 80.0) * s.sum()) / (2 * 60.0)
    u = rest.system.rest
    for axis, (name, length) in enumerate((("right", WIDTH), ("top", HEIGHT))):
        ends = u[sides_of(mesh, name), axis].mean()
        assert ends / length == pytest.approx(mean[axis], rel=1e-4)


def test_laplace_pressure_in_a_disc():
    """Constant tension T on the outline of a disc of radius r: a pressure T/r at its middle."""
    tension, off = 15.0, []
    for n in (4, 8):
        mesh, surface = disc(n), Surface(law=Skin(a=tension), on=("rim",))
        problem = Problem(mesh=mesh, conditions=MIRRORS, surface=surface)
        rest = find_rest(problem, LAW, TIGHT, factor=0.0)
        moved = mesh.p.T + rest.system.rest
        radius = np.linalg.norm(moved[np.unique(sides_of(mesh, "rim"))], axis=1)
        assert radius.mean() < 0.997 * RADIUS
        pressure = -0.5 * np.trace(rest.stress, axis1=1, axis2=2) * radius.mean() / tension
        inner = np.linalg.norm(rest.system.discretisation.point_positions(), axis=1) < 3.0
        off.append(abs(pressure[inner] - 1.0).max())
    assert 0.0 < off[0] < 0.15
    assert off[1] < 0.4 * off[0]


def test_modes_of_a_thin_strip():
    """A bar of modulus E h + 2 b and mass ρ h + 2 m along its length, without Poisson's ratio."""
    law, height, b, m = LinearFirstPiola(shear_modulus=50.0, lame=0.0), 2.0, 40.0, 0.03
    mesh = rectangle(60.0, height, (12, 1))
    conditions = (Fixed(on="left", components="x"), Fixed(on="bottom", components="y"))
    problem = Problem(mesh=mesh, conditions=conditions)
    skin = Surface(law=Skin(b=b, mass=m, eta=3.0), on=("top", "bottom"))
    bare, both = (
        find_modes(find_rest(replace(problem, surface=each), law, factor=0.0), 1)
        for each in (None, skin)
    )
    stiffer = 1.0 + 2.0 * b / (2.0 * 50.0 * height)
    heavier = 1.0 + 2.0 * m / (law.density * height)
    square = (abs(both.eigenvalues[0]) / abs(bare.eigenvalues[0])) ** 2
    assert square == pytest.approx(stiffer / heavier, rel=1e-6)
    # δ = ω² η/2E of Kelvin–Voigt: here η is 2 η_s/h and E the stiffened modulus.
    delta = -2.0 * both.eigenvalues[0].real / abs(both.eigenvalues[0]) ** 2
    assert delta == pytest.approx(2.0 * 3.0 / (2.0 * 50.0 * height * stiffer), rel=1e-6)


def test_mass_excess_bears_the_body_force():
    """Of the whole tissue, and of a region its sides alone; an accelerated frame moves as one."""
    mesh = with_regions(rectangle(WIDTH, HEIGHT, (4, 3)), half=Box((0.0, 0.0), (15.0, HEIGHT)))
    surface = Surface(law=Skin(mass=0.05), on=("top",))
    weights = []
    for region in (None, "half"):
        pull = BodyForce(on=region, name="pull", acceleration=(1.0, 0.0))
        system = make_system(Problem(mesh=mesh, conditions=(pull,), surface=surface), 0.08)
        weights.append(system.forces[0].at(0.0, 0.0, *np.zeros((2, system.n_rows, 2)))[:, 0].sum())
    whole = 0.08 * WIDTH * HEIGHT + 0.05 * WIDTH
    np.testing.assert_allclose(weights, [whole, 0.5 * whole], rtol=1e-12)
    assert 0.5 * system.mass.sum() == pytest.approx(whole)
    frame = BodyForce(acceleration=(0.5, 0.0)), Fixed(on="left", components="y")
    run = simulate(Problem(mesh=mesh, conditions=frame, surface=surface, duration=2.0), LAW)
    np.testing.assert_allclose(run.curve.displacement[-1], [1.0, 0.0], atol=1e-6)


def test_free_sides_are_those_without_a_condition():
    mesh = rectangle(WIDTH, HEIGHT, (4, 3))
    body = RigidBody(name="body", shape=Plane(normal=(0, -1)), on="top", position=(0, HEIGHT))
    found = free_sides(replace(clamped(Surface(law=SKIN), mesh), bodies=(body,)))
    named = np.concatenate([sides_of(mesh, "bottom"), sides_of(mesh, "right")])
    assert {*map(tuple, found.nodes)} == {*map(tuple, named)}
    assert found.names == ("free",)
    assert not found.oblique.any()
    for side, element in zip(found.nodes, found.elements, strict=True):
        assert np.isin(side, element_nodes(mesh)[element]).all()
    twice = free_sides(clamped(Surface(law=SKIN, on=("top", "right", "top")), mesh))
    assert len(twice.nodes) == 7


def test_each_side_takes_the_law_of_its_element():
    mesh = with_regions(
        rectangle(WIDTH, HEIGHT, (4, 3)),
        near=Box((0.0, 0.0), (15.0, HEIGHT)),
        far=Box((15.0, 0.0), (WIDTH, HEIGHT)),
    )
    laws = {"far": Skin(a=5.0), "near": SKIN}
    problem = clamped(Surface(law=laws, on=("top",)), mesh)
    system = make_system(problem, 0.08)
    u, v = np.random.default_rng(3).uniform(-0.3, 0.3, (2, system.n_rows, 2))
    top = sides_of(mesh, "top")
    near = (mesh.p.T[top, 0] <= 15.0).all(axis=1)
    parts = (top[near], SKIN), (top[~near], laws["far"])
    expected = sum(twin_force(mesh, sides, law, u, v) for sides, law in parts)
    np.testing.assert_allclose(system.surface.at(0, 0, u, v), expected, rtol=1e-9, atol=1e-9)
    assert_slopes(system.surface, u, v)
    regions = {"a": mesh.subdomains["near"], "b": mesh.subdomains["far"]}
    named = Surface(law={"a": SKIN, "b": laws["far"]}, on=("top",), regions=regions)
    same = make_system(replace(problem, surface=named), 0.08)
    np.testing.assert_allclose(same.surface.at(0, 0, u, v), expected, rtol=1e-9, atol=1e-9)
    with pytest.raises(InputError, match=r"surface.law: element 8 at \(18.75, .* in 0 of near"):
        make_system(replace(problem, surface=Surface(law={"near": SKIN}, on=("top",))), 0.08)


def test_oblique_sides_say_by_how_much():
    mesh = disc(2)
    sides = free_sides(Problem(mesh=mesh, conditions=(), surface=Surface(law=SKIN, on=("rim",))))
    assert sides.oblique.max() == pytest.approx(35.78, abs=0.01)


def test_wrong_surfaces_are_refused():
    with pytest.raises(InputError, match=r"surface.on: 'top'; it must be names of boundaries, or"):
        Surface(law=SKIN, on="top")
    held = tuple(Fixed(on=name, components="x") for name in ("left", "right", "top", "bottom"))
    with pytest.raises(InputError, match=r"surface.on: free; every outer side has a condition"):
        simulate(replace(clamped(Surface(law=SKIN)), conditions=held), LAW)


def test_where_the_law_has_no_answer_the_run_says_so():
    problem = clamped(Surface(law=replace(SKIN, a=0.0, largest=1.001)))
    fast = InitialVelocity(velocity=(4.0, 0.0))
    thrown = replace(problem, conditions=(*problem.conditions, fast))
    with pytest.raises(
        SimulationError, match=r"free side at .* stretch 1.00\d+, rate .* no answer"
    ):
        simulate(thrown, LAW)
    pulled = replace(problem, surface=Surface(law=replace(SKIN, a=-900.0, largest=1.001)))
    with pytest.raises(
        SimulationError, match=r"no rest under the surface tension: before the load, free side at"
    ):
        simulate(pulled, LAW)


class Rim:
    """All points as far from the origin as the radius."""

    def holds(self, points, slack):
        return np.linalg.norm(points, axis=1) > RADIUS * (1.0 - 1e-9)


def disc(n):
    """A quarter of a disc, n curved triangles along each straight side; x = 0 and y = 0 named."""
    x = np.linspace(0.0, 1.0, n + 1)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)

    def mapped(points):
        length = np.linalg.norm(points, axis=1)
        factor = RADIUS * points.max(axis=1) / np.where(length > 0.0, length, 1.0)
        return points * factor[:, None]

    k = np.arange(len(grid)).reshape(n + 1, n + 1)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    square, straight = triangles(grid, corners), triangles(mapped(grid), corners)
    points = square.p.T
    nodes = np.where((points.max(axis=1) == 1.0)[:, None], mapped(points), straight.p.T)
    return with_boundaries(
        replace(straight, doflocs=nodes.T), rim=Rim(),
        left=Box((0.0, 0.0), (0.0, RADIUS)), bottom=Box((0.0, 0.0), (RADIUS, 0.0)),
    )  # fmt: skip
