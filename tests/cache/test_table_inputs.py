"""Inputs of a table: rotation and group taken out, slopes along them."""

import numpy as np
import pytest

from surrofe2.base.sampling import SamplingRange, half_widths
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS, canonical_image
from surrofe2.base.tensors import from_inputs, to_components, to_inputs, transpose
from surrofe2.cache.table.records import input_slopes
from tests.cache.tables import RANGE, states
from tests.laws import SquareLaw, square_stress

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
MIRROR = np.diag([1.0, -1.0])


@pytest.mark.parametrize("image", range(4))
def test_images_are_the_group_of_the_square(image):
    """Bit 0 turns the cell by 90°, bit 1 reflects it: F → G⁻¹ F G in the rotated frame."""
    U, A = states(angle=0.0)
    turned, mirrored = image & 1, image >> 1
    if turned:
        U, A = TURN.T @ U @ TURN, TURN.T @ A @ TURN
    if mirrored:
        U, A = MIRROR @ U @ MIRROR, MIRROR @ A @ MIRROR
    x = to_inputs(*states(angle=0.0))[0]
    np.testing.assert_allclose(to_inputs(U, A)[0], x * INPUT_SIGNS[image], atol=1e-15)
    s = to_components(square_stress(*states(angle=0.0)))
    np.testing.assert_allclose(to_components(square_stress(U, A)), s * COMPONENT_SIGNS[image])


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


def test_scale_is_the_half_width_of_each_input():
    np.testing.assert_allclose(half_widths(RANGE), [0.14, 0.14, 0.12] + [0.032] * 4)
    still = SamplingRange(stretch=(0.9, 1.1), shear=0.0, rate=0.0)
    np.testing.assert_allclose(half_widths(still), [0.2, 0.2, 1, 1, 1, 1, 1])
