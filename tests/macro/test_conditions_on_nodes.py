"""Supports and forces on single nodes: the textbook's statically determinate block."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import (
    BodyForce,
    Fixed,
    Foundation,
    InitialVelocity,
    NodeAt,
    PointForce,
    PrescribedMotion,
    Pressure,
    Problem,
    Symmetry,
    Traction,
    rectangle,
)
from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, find_rest, simulate
from surrofe2.macro.system import check_conditions, make_system
from surrofe2.workflow.run import problem_record
from tests.laws import KelvinVoigt

SETTINGS = MacroSettings(newton_tolerance=1e-10)
ORIGIN = NodeAt((0.0, 0.0))
CORNER = NodeAt((0.0, 100.0))
BLOCK = Problem(
    mesh=rectangle(200.0, 100.0, (4, 2)),
    conditions=(
        Fixed(name="pin", on=ORIGIN),
        Fixed(name="roller", on=CORNER, components="x"),
        Traction(name="pull", on="right", traction=(0.05, 0.0)),
        Traction(name="counter", on="left", traction=(-0.05, 0.0)),
    ),
)


def test_three_held_components_take_no_force_from_a_block_in_balance():
    """Every point has one stress, and the supports no reaction."""
    rest = find_rest(BLOCK, KelvinVoigt(), SETTINGS)
    pulled = 0.05 * 100.0
    for name in ("force pin x", "force pin y", "force roller x"):
        assert abs(rest.history[name]).max() < 1e-7 * pulled
    np.testing.assert_allclose(rest.F, np.broadcast_to(rest.F[0], rest.F.shape), atol=1e-9)
    assert rest.F[0, 0, 0] > 1.0
    assert rest.history["node displacement at 0 100 y"][-1] < 0.0  # narrower across the pull


def test_forces_on_the_nodes_of_a_side_are_its_traction():
    """A uniform traction on a side of two elements acts by 1/4, 1/2 and 1/4 on its nodes."""
    held = (Fixed(on="left"),)
    traction = Traction(on="right", traction=(0.3, -0.1))
    forces = tuple(
        PointForce(on=NodeAt((200.0, y)), force=(30.0 * part, -10.0 * part))
        for y, part in ((0.0, 0.25), (50.0, 0.5), (100.0, 0.25))
    )
    by_side = find_rest(replace(BLOCK, conditions=(*held, traction)), KelvinVoigt(), SETTINGS)
    by_node = find_rest(replace(BLOCK, conditions=(*held, *forces)), KelvinVoigt(), SETTINGS)
    np.testing.assert_allclose(by_node.u, by_side.u, atol=1e-8 * abs(by_side.u).max())
    total = [by_node.history[f"force point_force at 200 {y} x"][-1] for y in (0, 50, 100)]
    np.testing.assert_allclose(total, [7.5, 15.0, 7.5])


def test_a_node_that_is_moved_or_pulled_has_a_force_over_its_displacement():
    moved = PrescribedMotion(name="grip", on=NodeAt((200.0, 50.0)), displacement=(2.0, None))
    pulled = PointForce(name="weight", on=NodeAt((200.0, 0.0)), force=(0.0, -0.5))
    problem = replace(BLOCK, conditions=(Fixed(on="left"), moved, pulled))
    rest = find_rest(problem, KelvinVoigt(), SETTINGS, load_steps=2)
    np.testing.assert_allclose(rest.history["node displacement at 200 50 x"], [0.0, 1.0, 2.0])
    assert (np.diff(rest.history["force grip x"]) > 0.0).all()
    places = problem_record(problem, thickness=10.0)["places"]
    assert places["grip"]["displacement"] == "node displacement at 200 50"
    assert places["weight"]["section"] is None


def test_a_run_in_time_holds_a_node():
    run = simulate(replace(BLOCK, duration=2.0), KelvinVoigt())
    for column in (
        "node displacement at 0 0 x",
        "node displacement at 0 0 y",
        "node displacement at 0 100 x",
    ):
        assert not run.history[column].any()
    assert run.history["node displacement at 0 100 y"].any()


@pytest.mark.parametrize(("kind", "entries"), [(Fixed, {}), (PointForce, {"force": (1.0, 0.0)})])
def test_the_nearest_node_is_named_where_none_is_at_the_point(kind, entries):
    aside = kind(on=NodeAt((0.01, 49.0)), **entries)
    problem = replace(BLOCK, conditions=(*BLOCK.conditions, aside))
    nearest = r"no node .* within 0.0002 µm of it; the nearest is at \(0, 50\) µm, 1 µm away"
    with pytest.raises(InputError, match=nearest):
        find_rest(problem, KelvinVoigt(), SETTINGS)


def test_six_digits_of_a_mesh_file_are_enough():
    nodes = rectangle(200.0, 100.0, (3, 2))
    third = PointForce(on=NodeAt((66.6667, 100.0)), force=(0.0, -0.1))
    problem = replace(BLOCK, mesh=nodes, conditions=(Fixed(on="bottom"), third))
    rest = find_rest(problem, KelvinVoigt(), SETTINGS)
    assert rest.history["node displacement at 66.6667 100 y"][-1] < 0.0


@pytest.mark.parametrize(
    ("kind", "on", "sentence"),
    [
        (Fixed, 3, r"fixed.on: 3; it must be the name of a boundary or region, or { p"),
        (Fixed, {"point": [0.0]}, r"fixed.on.point: \[0.0\]; it must be a list of 2"),
        (PointForce, "left", "point_force.on: 'left'; it must be { point"),
        (PrescribedMotion, {"points": [0.0, 0.0]}, "prescribed_motion.on.points: unknown key"),
    ],
)
def test_wrong_places_get_a_sentence(kind, on, sentence):
    entries = {PointForce: {"force": (1.0, 0.0)}, PrescribedMotion: {"displacement": (1.0, 0.0)}}
    with pytest.raises(InputError, match=sentence):
        kind(on=on, **entries.get(kind, {}))


ON_CORNER = NodeAt((200.0, 0.0))
HELD = (Fixed(on="left"), Fixed(on=ON_CORNER, components="y"))


@pytest.mark.parametrize(
    ("load", "place"),
    [
        (PointForce(on=ORIGIN, force=(1.0, 0.0)), "point_force at 0 0.on: at 0 0"),
        (PointForce(on=ON_CORNER, force=(0.0, 1.0)), "point_force at 200 0.on: at 200 0"),
        (Traction(on="left", traction=(0.0, 1.0)), "traction left.on: left"),
        (Pressure(on="left", pressure=1.0), "pressure left.on: left"),
        (Foundation(on="left", stiffness=1.0), "foundation left.on: left"),
        (InitialVelocity(on="left", velocity=(1.0, 0.0)), "initial_velocity left.on: left"),
    ],
)
def test_what_acts_on_nothing_but_what_is_held_is_an_error(load, place):
    for check in (check_conditions, lambda problem: make_system(problem, 1.0)):
        with pytest.raises(InputError, match=f"{place}; supports hold or move all of it"):
            check(replace(BLOCK, conditions=(*HELD, load)))
    moved = PrescribedMotion(on="left", displacement=(1.0, 2.0))
    if load.on == "left":
        with pytest.raises(InputError, match="supports hold or move all of it"):
            check_conditions(replace(BLOCK, conditions=(moved, load)))


@pytest.mark.parametrize(
    "load",
    [
        PointForce(on=ON_CORNER, force=(1.0, 0.0)),
        PointForce(on=ORIGIN, force=(0.0, 0.0)),
        Traction(on="bottom", traction=(0.0, 1.0)),
        Pressure(on="right", pressure=1.0),
        Foundation(on="bottom", stiffness=1.0, components="y"),
        BodyForce(acceleration=(0.0, 1.0)),
    ],
)
def test_loads_that_act_on_a_free_component_pass(load):
    check_conditions(replace(BLOCK, conditions=(*HELD, load)))
    # a mirror holds no motion along it
    check_conditions(replace(BLOCK, conditions=(Symmetry(on="top"), load)))


def test_one_component_of_a_node_is_not_held_and_moved_at_once():
    moved = PrescribedMotion(on=ORIGIN, displacement=(1.0, None))
    told = (
        r"prescribed_motion at 0 0: component x of the node at \(0, 0\) µm; fixed left prescribes"
    )
    with pytest.raises(InputError, match=told):
        check_conditions(replace(BLOCK, conditions=(*HELD, moved)))
