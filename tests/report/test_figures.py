"""Colours with round limits, supports and symmetry read off how a tissue moves."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.markers import CARETRIGHT
from matplotlib.text import Annotation

from surrofe2 import (
    BodyForce,
    Fixed,
    NodeAt,
    PointForce,
    PrescribedMotion,
    Pressure,
    Problem,
    Traction,
    drawn_loads,
    find_rest,
    rectangle,
)
from surrofe2.problem.mesh import nodes_on
from surrofe2.report.figures import (
    Colours,
    draw_borders,
    draw_cells,
    draw_tissue,
    drawn_nodes,
    fields_at_rest,
    supported_sides,
    times_that_differ,
)
from surrofe2.rve import RveLaw
from surrofe2.store.fields import DISPLACEMENT_NAME, StoredFields
from tests.laws import CELL, KelvinVoigt


@pytest.mark.parametrize(
    ("values", "low", "high", "name"),
    [
        ([129.3, 166.0], 120.0, 170.0, "viridis"),
        ([-42.16, -42.12], -42.6, -41.6, "viridis"),  # noise is one colour
        ([-0.7, 0.92], -1.0, 1.0, "RdBu_r"),
        ([-1e-12, 3.1], 0.0, 4.0, "viridis"),
        ([np.nan, 0.0], -0.01, 0.01, "viridis"),
    ],
)
def test_limits_are_round_and_signs_diverge(values, low, high, name):
    colours = Colours.of("", np.array(values))
    assert (colours.low, colours.high) == (pytest.approx(low), pytest.approx(high))
    assert colours.name == name


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (1.28, 1.6, [1.28, 1.36, 1.44, 1.52, 1.6]),
        (-1.0, 1.0, [-1.0, -0.5, 0.0, 0.5, 1.0]),
        (120.0, 170.0, [120.0, 130.0, 140.0, 150.0, 160.0, 170.0]),
    ],
)
def test_the_limits_are_among_the_ticks_and_so_is_zero_between_them(low, high, ticks):
    assert Colours("", low, high, "viridis").ticks() == pytest.approx(ticks)


def test_times_of_an_oscillation_are_of_different_phases():
    """Every tenth time is at the same phase."""
    phase = 2.0 * np.pi * np.arange(51) / 10.0
    F = np.eye(2) + 0.1 * np.sin(phase)[:, None, None]
    chosen = times_that_differ(F, 5)
    assert chosen[0] == 0
    assert (np.diff(chosen) > 0).all()
    values = np.sort(np.sin(phase[chosen]))
    assert np.diff(values).min() > 0.2
    assert times_that_differ(np.tile(np.eye(2), (5, 1, 1)), 3).tolist() == [0, 2, 4]


def test_the_border_of_two_regions_is_their_common_side():
    axes = Figure().subplots()
    fields = strip()
    draw_borders(axes, fields, 0, [np.array([1])])
    (line,) = axes.collections[0].get_segments()
    np.testing.assert_allclose(np.sort(line, axis=0), [[10.0, 0.0], [10.0, 5.0]])


def strip():
    """Two elements, clamped at the left, pulled at the right, on a line of symmetry below."""
    x, y = np.meshgrid([0.0, 10.0, 20.0], [0.0, 5.0], indexing="ij")
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    cells = np.array([[0, 2, 3, 1], [2, 4, 5, 3]])
    u = np.zeros((3, 6, 2))
    u[1:, 2:, 0] = 0.1 * points[2:, 0] * np.array([1.0, 2.0])[:, None]
    u[1:, 3, 1] = -0.2
    return StoredFields(points, cells, np.arange(3.0), {DISPLACEMENT_NAME: u})


def test_half_a_specimen_is_drawn_whole_with_its_supports():
    axes = Figure().subplots()
    draw_tissue(axes, strip(), 2, np.array([1.0, 2.0]), Colours.of("", np.array([1.0, 2.0])))
    assert len(axes.collections) == 2
    below = np.concatenate([path.vertices for path in axes.collections[1].get_paths()])
    assert below[:, 1].min() == -5.0
    hatched = [patch for patch in axes.patches if patch.get_hatch()]
    assert len(hatched) == 2
    assert all(patch.get_xy()[:, 0].max() == 0.0 for patch in hatched)
    styles = [line.get_linewidth() for line in axes.lines[:-1]]
    assert sorted(styles) == [0.8] * 4 + [2.5] * 4  # symmetry twice two; clamp and grip twice


def test_clamps_and_grips_are_supports_and_lines_of_symmetry_are_none():
    assert supported_sides(strip()) == [(1, 0, True), (4, 5, False)]


def test_a_line_of_symmetry_is_one_but_for_rounding():
    """As a mesh has it whose points were computed: cos(90°) is 6e-17."""
    fields = strip()
    fields.points[2, 1] = 6e-17
    fields.points[4, 1] = -6e-17
    axes = Figure().subplots()
    draw_tissue(axes, fields, 2, np.array([1.0, 2.0]), Colours.of("", np.array([1.0, 2.0])))
    assert len(axes.collections) == 2


def test_a_rest_is_drawn_from_its_own_displacements():
    """Half of the load is asked for, so that the factor is not 1."""
    mesh = rectangle(20.0, 10.0, (4, 2))
    pull = PrescribedMotion(name="pull", on="right", displacement=(0.2, 0.0))
    problem = Problem(mesh=mesh, conditions=(Fixed(on="left"), pull))
    rest = find_rest(problem, KelvinVoigt(), factor=0.5)
    fields = fields_at_rest(rest)
    assert fields.t.tolist() == [0.0, 0.5]
    assert not fields.displacement[0].any()
    left, right = (fields.points[:, 0] == x for x in (0.0, 20.0))
    assert not fields.displacement[1, left].any()
    assert fields.displacement[1, right] == pytest.approx(np.array([[0.1, 0.0]] * 3))


def test_nodes_that_are_held_or_pulled_are_drawn():
    axes = Figure().subplots()
    conditions = [
        Fixed(on=NodeAt((0.0, 5.0)), components="x"),
        PointForce(on=NodeAt((20.0, 0.0)), force=(0.0, -3.0)),
        Fixed(on="left"),
    ]
    values = np.array([1.0, 2.0])
    nodes = drawn_nodes(conditions, strip())
    draw_tissue(axes, strip(), 2, values, Colours.of("", values), factor=0.5, nodes=nodes)
    held = [line.get_xydata() for line in axes.lines if line.get_marker() == CARETRIGHT]
    np.testing.assert_array_equal(held, [[[0.0, 5.0]], [[0.0, -5.0]]])  # and its image
    (arrow,) = [each for each in axes.texts if isinstance(each, Annotation)]
    assert arrow.xyann == (22.0, 0.0)  # where half of its displacement brings the node
    assert arrow.xy[0] == 22.0
    assert arrow.xy[1] < 0.0


@pytest.mark.parametrize(
    ("condition", "direction", "where"),
    [
        (Traction(on="right", traction=(2.0, 0.0)), (1, 0), "begins on x = 20"),
        (Traction(on="right", traction=(-2.0, 0.0)), (-1, 0), "ends on x = 20"),
        (Pressure(on="top", pressure=2.0), (0, -1), "ends on y = 10"),
        (Pressure(on="top", pressure=-2.0), (0, 1), "begins on y = 10"),
        (PrescribedMotion(on="top", displacement=(None, 3.0)), (0, 1), "begins on y = 10"),
        (BodyForce(acceleration=(0.0, -1e-3)), (0, -1), "begins on x = 10"),
        (PointForce(on=NodeAt((20.0, 10.0)), force=(0.0, -3.0)), (0, -1), "begins on x = 20"),
        (PrescribedMotion(on="top", displacement=(0.0, 0.0)), None, ""),
    ],
)
def test_arrows_show_which_way_loads_and_motions_act(condition, direction, where):
    mesh = rectangle(20.0, 10.0, (8, 4))
    problem = Problem(mesh=mesh, conditions=(Fixed(on="bottom"), condition))
    rest = find_rest(problem, KelvinVoigt(), factor=0.0)
    fields = fields_at_rest(rest)
    axes = Figure().subplots()
    colours = Colours.of("", np.array([1.0, 2.0]))
    loads = drawn_loads(problem, fields)
    draw_tissue(axes, fields, 0, np.ones(32), colours, nodes=loads)
    arrows = [each for each in axes.texts if isinstance(each, Annotation)]
    if direction is None:
        assert not arrows
        return
    alone = isinstance(condition, BodyForce | PointForce)
    assert len(arrows) == (1 if alone else 5)
    end, _, axis, _, value = where.split()
    low, high = (np.array(limits) for limits in zip(axes.get_xlim(), axes.get_ylim(), strict=True))
    for arrow in arrows:
        begin, tip = np.array(arrow.xyann), np.array(arrow.xy)
        np.testing.assert_allclose((tip - begin) / np.linalg.norm(tip - begin), direction)
        on = tip if end == "ends" else begin
        assert on["xy".index(axis)] == pytest.approx(float(value))
        assert ((low <= [begin, tip]) & (high >= [begin, tip])).all()
    if not alone:  # from one end of the side to the other
        along = [arrow.xyann[1 - "xy".index(axis)] for arrow in arrows]
        length = 10.0 if axis == "x" else 20.0
        np.testing.assert_allclose(np.sort(along), np.linspace(0.0, length, 5), atol=1e-9)


def arrows_on(axes):
    """Both ends of each arrow."""
    return [(each.xyann, each.xy) for each in axes.texts if isinstance(each, Annotation)]


def test_loads_act_on_both_halves_of_a_specimen():
    """The half that is computed is pulled obliquely, so that its image is pulled the other way."""
    axes = Figure().subplots()
    values = np.array([1.0, 2.0])
    pull = PointForce(on=NodeAt((20.0, 5.0)), force=(3.0, 4.0))
    nodes = drawn_nodes([pull], strip())
    draw_tissue(axes, strip(), 0, values, Colours.of("", values), nodes=nodes)
    (begin, tip), (mirrored_begin, mirrored_tip) = arrows_on(axes)
    assert begin == (20.0, 5.0)
    assert mirrored_begin == (20.0, -5.0)
    np.testing.assert_allclose(mirrored_tip, np.array(tip) * [1.0, -1.0])


def test_the_arrow_of_a_region_is_in_it():
    """A skin all around: the middle of its nodes is in the flesh."""
    mesh = rectangle(20.0, 10.0, (8, 4))
    middles = mesh.p[:, mesh.t].mean(axis=1).T
    is_flesh = (abs(middles - [10.0, 5.0]) < [7.0, 2.5]).all(axis=1)
    mesh = mesh.with_subdomains({"skin": np.flatnonzero(~is_flesh)})
    weight = BodyForce(on="skin", acceleration=(0.0, -1e-3))
    problem = Problem(mesh=mesh, conditions=(Fixed(on="bottom"), weight))
    fields = fields_at_rest(find_rest(problem, KelvinVoigt(), factor=0.0))
    (load,) = drawn_loads(problem, fields)
    assert load.node in nodes_on(mesh, "skin")


@pytest.mark.parametrize("noise", [1e-7, -1e-7])
def test_loads_along_a_side_do_not_depend_on_rounding(noise):
    mesh = rectangle(20.0, 10.0, (8, 4))
    rough = mesh.p.copy()
    rough[1] += noise * np.sin(2.0 * rough[0]) * (rough[1] > 9.0)
    mesh = replace(mesh, doflocs=rough)
    rubbing = Traction(on="top", traction=(1.0, 0.0))
    problem = Problem(mesh=mesh, conditions=(Fixed(on="bottom"), rubbing))
    fields = fields_at_rest(find_rest(problem, KelvinVoigt(), factor=0.0))
    (load,) = drawn_loads(problem, fields)  # others would cover it
    assert not load.pushes
    assert fields.points[load.node] == pytest.approx([10.0, 10.0])


def test_sides_within_the_tissue_have_no_outside():
    mesh = rectangle(20.0, 10.0, (8, 4))
    inner = mesh.facets_satisfying(lambda x: abs(x[0] - 10.0) < 1e-9)
    mesh = mesh.with_boundaries({"line": inner})
    for along in (1.0, -1.0):
        motion = PrescribedMotion(on="line", displacement=(along, None))
        problem = Problem(mesh=mesh, conditions=(Fixed(on="bottom", components="y"), motion))
        fields = fields_at_rest(find_rest(problem, KelvinVoigt(), factor=0.0))
        assert [load.pushes for load in drawn_loads(problem, fields)] == [False] * 5


def test_plant_cells_fill_the_window():
    seen = RveLaw(CELL, initialisation="cauchy-born").particles(
        np.eye(2)[None], np.zeros((1, 2, 2))
    )
    (_, drawn), _ = draw_cells(Figure().subplots(), seen, 0, half=60.0)
    ends = np.concatenate(drawn.get_segments())
    assert (ends.min(axis=0) < -45.0).all()
    assert (ends.max(axis=0) > 70.0).all()
