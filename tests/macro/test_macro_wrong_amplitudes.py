"""What is no amplitude is refused by name."""

import pytest

from surrofe2 import LoadCase
from surrofe2.errors import InputError
from surrofe2.macro.conditions import BodyForce
from surrofe2.macro.mesh import Mesh
from surrofe2.macro.problem import Problem


def points():
    yield (0.0, 1.0)


@pytest.mark.parametrize("wrong", [points(), points, [(0.0, 1.0)], "ramp"])
def test_generators_and_functions_are_no_amplitudes(wrong):
    with pytest.raises(InputError, match=r"problem: amplitude: .*; it must be an Amplitude"):
        Problem(
            mesh=Mesh.rectangle(1.0, 1.0, (1, 1)),
            conditions=(BodyForce(acceleration=(0.0, -1.0), amplitude=wrong),),
        )


@pytest.mark.parametrize("wrong", [points(), points])
def test_nor_are_they_of_a_load_case(wrong):
    with pytest.raises(InputError, match=r"load.amplitude: .*; it must be"):
        LoadCase(amplitude=wrong)
