"""Inputs of a table: rotation and group taken out, slopes along them."""

import numpy as np

from surrofe2.base.square_symmetry import INPUT_SIGNS, canonical_image
from surrofe2.base.tensors import from_inputs, to_components, to_inputs, transpose
from surrofe2.cache.table.records import input_slopes
from tests.cache.tables import states
from tests.laws import SquareLaw, square_stress

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
MIRROR = np.diag([1.0, -1.0])


def test_canonical_image_is_in_one_sector():
    x = to_inputs(*states(400))[0]
    image = canonical_image(x)
    assert set(image) == {0, 1, 2, 3}
    home = x * INPUT_SIGNS[image]
    assert (home[:, 1] >= 0.0).all()
    assert (home[:, 2] >= 0.0).all()


def test_slopes_are_derivatives_along_the_inputs():
    F, F_dot = states(20)
    x, R = to_inputs(F, F_dot)
    law = SquareLaw()
    answer = law.respond(F, F_dot, tangents=True)
    slopes = input_slopes(R, *answer.tangents.cauchy(F, answer.stress))
    for i in range(7):
        step = np.zeros(7)
        step[i] = 1e-5
        sides = [
            to_components(transpose(R) @ square_stress(*from_inputs(x + sign * step, R)) @ R)
            for sign in (1.0, -1.0)
        ]
        expected = (sides[0] - sides[1]) / 2e-5
        np.testing.assert_allclose(slopes[:, :, i], expected, atol=1e-6)
