"""Factors in time: rates against differences inside every piece, jumps only at corners."""

import math
from itertools import pairwise

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.problem import Plane, Problem, RigidBody, rectangle
from surrofe2.problem.amplitude import Amplitude, Constant, Pulse, Ramp, Sine, Table
from surrofe2.problem.conditions import BodyForce, Fixed, InitialVelocity, PrescribedMotion
from tests.laws import KelvinVoigt

AMPLITUDES = {
    "constant": Constant(value=-0.7),
    "table": Table(points=((0.5, 0.0), (1.0, 2.0), (3.0, -1.0))),
    "ramp": Ramp(begin=0.4, end=2.1),
    "smooth ramp": Ramp(begin=0.4, end=2.1, smooth=True),
    "sine": Sine(frequency=0.8, phase=30.0, offset=0.2, begin=0.3),
    "half sine": Pulse(begin=0.2, length=1.7),
    "triangle": Pulse(begin=0.2, length=1.7, shape="triangle"),
    "rectangle": Pulse(begin=0.2, length=1.7, shape="rectangle"),
}
# What happens at each corner: V: the factor jumps, R: its rate, S: the rate of that.
JUMPS = {
    "constant": "",
    "table": "RRR",
    "ramp": "RR",
    "smooth ramp": "--",
    "sine": "R",
    "half sine": "RR",
    "triangle": "RRR",
    "rectangle": "VV",
}


def pieces(amplitude):
    ends = [-1.0, *amplitude.corners(), 5.0]
    return list(pairwise(ends))


@pytest.mark.parametrize("name", AMPLITUDES)
def test_rates_are_those_of_differences_inside_every_piece(name):
    amplitude, step = AMPLITUDES[name], 1e-5
    assert isinstance(amplitude, Amplitude)
    assert list(amplitude.corners()) == sorted(amplitude.corners())
    for begin, end in pieces(amplitude):
        for t in np.linspace(begin, end, 9)[1:-1]:
            value, *slopes = amplitude.at(t, t)
            before, after = (np.array(amplitude.at(t + h, t)) for h in (-step, step))
            assert ((after - before) / (2.0 * step))[:2] == pytest.approx(slopes, abs=1e-8)
            assert 0.5 * (after + before)[0] == pytest.approx(value, abs=1e-8)


@pytest.mark.parametrize("name", AMPLITUDES)
def test_a_piece_is_smooth_to_its_ends_and_jumps_behind_them(name):
    """At a corner `within` says whose value is asked; the other side has what it says."""
    amplitude = AMPLITUDES[name]
    found = ""
    for corner in amplitude.corners():
        left, right = (amplitude.at(corner, corner + side * 1e-9) for side in (-1.0, 1.0))
        for side, values in ((-1.0, left), (1.0, right)):
            near = amplitude.at(corner + side * 1e-7, corner + side * 1e-7)
            np.testing.assert_allclose(values, near, atol=1e-4)
        jumps = [abs(b - a) > 1e-9 for a, b in zip(left, right, strict=True)]
        found += "V" if jumps[0] else "R" if jumps[1] else "S" if jumps[2] else "-"
    assert found == JUMPS[name]


def test_known_values():
    table = AMPLITUDES["table"]
    assert [table.at(t, t)[0] for t in (0.0, 0.75, 2.0, 9.0)] == [0.0, 1.0, 0.5, -1.0]
    smooth = AMPLITUDES["smooth ramp"]
    assert smooth.at(1.25, 1.25)[0] == pytest.approx(0.5)
    sine = Sine(frequency=0.25, begin=1.0)
    assert [sine.at(t, t)[0] for t in (0.0, 2.0, 3.0, 4.0)] == pytest.approx([0.0, 1.0, 0.0, -1.0])
    for shape in ("half-sine", "triangle", "rectangle"):
        pulse = Pulse(begin=1.0, length=2.0, shape=shape)
        assert pulse.at(2.0, 2.0 + 1e-9)[0] == pytest.approx(1.0)
        assert pulse.at(0.5, 0.5)[0] == pulse.at(3.5, 3.5)[0] == 0.0


def test_a_step_that_sees_the_shape():
    assert AMPLITUDES["sine"].resolved_by == pytest.approx(1.0 / 8.0 / 0.8)
    assert AMPLITUDES["half sine"].resolved_by == pytest.approx(1.7 / 8.0)
    for name in ("constant", "table", "ramp", "triangle", "rectangle"):
        assert AMPLITUDES[name].resolved_by == math.inf


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Table(), r"amplitude\.points: \[\]; it must have at least one"),
        (lambda: Sine(frequency=0.0), r"amplitude\.frequency: .*must be"),
        (lambda: Pulse(length=1.0, shape="square"), r"amplitude\.shape: .*must be"),
        (lambda: Constant(value=math.nan), r"amplitude\.value: .*must be"),
    ],
)
def test_amplitudes_out_of_range_are_one_line(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


SQUARE = rectangle(10.0, 10.0, (2, 2))


def ran(*conditions, bodies=()):
    problem = Problem(
        mesh=SQUARE,
        conditions=(Fixed(on="left"), *conditions),
        bodies=bodies,
        duration=1.0,
        output_interval=0.5,
    )
    return simulate(problem, KelvinVoigt(), MacroSettings(record_dissipation=False, frames=2))


@pytest.mark.parametrize("late", [Ramp(begin=2.0, end=3.0), Pulse(begin=1.0, length=2.0)])
def test_what_is_zero_during_the_whole_run_is_refused(late):
    """The same that acts at its end, or is a constant 0, is not."""
    push = BodyForce(acceleration=(0.1, 0.0), amplitude=late)
    with pytest.raises(
        InputError, match=r"body_force.amplitude: zero during the whole run of 1 µs"
    ):
        ran(push)
    pull = PrescribedMotion(on="right", displacement=(1.0, None), amplitude=late)
    with pytest.raises(InputError, match=r"prescribed_motion right.amplitude: zero during"):
        ran(pull)
    plate = RigidBody(
        name="plate", shape=Plane(normal=(-1.0, 0.0)), on="right", position=(11.0, 0.0),
        displacement=(-1.0, 0.0), amplitude=late,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"plate.amplitude: zero during"):
        ran(bodies=(plate,))
    for taken in (Ramp(begin=0.9, end=3.0), Pulse(begin=0.7, length=0.1), Constant(value=0.0)):
        assert ran(BodyForce(acceleration=(0.1, 0.0), amplitude=taken)).finished


@pytest.mark.parametrize("velocity", [(0.3, 0.0), (0.3, -0.1)])
def test_a_velocity_of_nothing_but_what_is_held_is_refused(velocity):
    with pytest.raises(InputError, match=r"initial_velocity left.on: left; supports hold or move"):
        ran(InitialVelocity(on="left", velocity=velocity))
    pull = PrescribedMotion(on="right", displacement=(1.0, None), amplitude=Ramp(end=1.0))
    thrown = InitialVelocity(on="right", velocity=velocity)
    if velocity[1] == 0.0:
        with pytest.raises(InputError, match=r"initial_velocity right.on: right; supports hold"):
            ran(pull, thrown)
    else:
        assert ran(pull, thrown).finished
    assert ran(InitialVelocity(on="top", velocity=velocity)).finished
