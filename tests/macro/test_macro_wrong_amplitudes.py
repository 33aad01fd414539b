"""What is no amplitude is refused by name."""

import pytest

from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.problem import Plane, RigidBody
from surrofe2.problem.amplitude import Constant, Pulse, Ramp
from surrofe2.problem.conditions import BodyForce, Fixed, InitialVelocity, PrescribedMotion
from surrofe2.problem.mesh import rectangle
from surrofe2.problem.problem import Problem
from tests.laws import KelvinVoigt

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
