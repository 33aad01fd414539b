"""The law of contact: the same numbers from kernels as from arrays, its slopes, its far ends."""

import numpy as np
import pytest

from surrofe2.base.compilation import kernel
from surrofe2.problem import Circle, Corner, Plane, contact_law
from surrofe2.tissue.external_forces import _drag
from tests.numerics import slope_along

LAW = (3000.0, 0.01, 4.0)
PLANE = Plane(normal=(3.0, -4.0)).outline
CIRCLE = Circle(radius=2.0).outline
CORNER = Corner(axis=(0.6, -0.8), angle=80.0, radius=3.0).outline
NUMBERS = np.random.default_rng(2)
FORMULAS = {
    "pressure": (lambda d, w: contact_law.pressure(d, w, LAW)),
    "stored": (lambda d, w: (contact_law.stored(d, 3000.0, 0.01),)),
    "friction": (lambda d, w: contact_law.friction(d, w, (0.3, 0.05))),
    "plane": (lambda d, w: contact_law.gap(300.0 * d - 4.0, 5.0 * w, PLANE)),
    "circle": (lambda d, w: contact_law.gap(300.0 * d - 4.0, 5.0 * w, CIRCLE)),
    "corner": (lambda d, w: contact_law.gap(300.0 * d - 4.0, 5.0 * w, CORNER)),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_kernels_and_arrays_have_one_law(name):
    depth, speed = 0.03 * NUMBERS.random(200), NUMBERS.normal(size=200)
    arrays = FORMULAS[name](depth, speed)
    compiled = kernel(FORMULAS[name])
    one_by_one = np.array([compiled(*both) for both in zip(depth, speed, strict=True)]).T
    for found, expected in zip(one_by_one, arrays, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * abs(expected).max())


def test_a_disc_and_a_half_plane_are_wedges_in_all_directions():
    """On the axis of the wedge, too, and in the middle of the disc."""
    points = 5.0 * NUMBERS.normal(size=(200, 2))
    points[:4] = (3.0, -4.0), (-3.0, 4.0), (0.0, 0.0), (4.0, 3.0)
    distance, normal, curvature = Plane(normal=(3.0, -4.0)).gap(points)
    np.testing.assert_allclose(distance, points @ (0.6, -0.8), atol=1e-14)
    np.testing.assert_array_equal(normal, np.tile((0.6, -0.8), (200, 1)))
    assert not curvature.any()
    distance, normal, curvature = Circle(radius=2.0).gap(points)
    np.testing.assert_allclose(distance, np.hypot(*points.T) - 2.0, atol=1e-14)
    np.testing.assert_allclose(normal, points * curvature[:, None], atol=1e-14)


def test_pressure_is_the_slope_of_what_is_stored_and_never_pulls():
    depth = 10.0 ** NUMBERS.uniform(-300.0, 1.0, 1000)
    for sign in (-1.0, 1.0):
        closing = sign * 10.0 ** NUMBERS.uniform(-300.0, 2.0, 1000)
        with np.errstate(under="ignore"):
            found = contact_law.pressure(depth, closing, LAW)
        assert np.isfinite(found).all()
        assert (found[0] >= 0.0).all()
    d = np.linspace(1e-4, 0.03, 50)
    slope = slope_along(lambda d: contact_law.stored(d, *LAW[:2]), d, 1.0, 1e-7)
    np.testing.assert_allclose(slope, contact_law.pressure(d, 0.0 * d, LAW)[0], rtol=1e-6)


def test_the_dashpot_never_drives():
    """Below the smoothing and at speeds far above k δ/c, too."""
    depth, closing = np.meshgrid(np.geomspace(1e-6, 10.0, 60), np.linspace(-9.0, 9.0, 37))
    stiffness, smoothing, damping = law = 50.0, 0.1, 30.0
    pressure, _, by_closing = contact_law.pressure(depth, closing, law)
    spring, *_ = contact_law.pressure(depth, 0.0 * closing, law)
    assert by_closing.min() > 0.0
    assert ((pressure - spring) * closing).min() >= 0.0
    far = depth > smoothing
    straight = stiffness * (depth[far] - 0.5 * smoothing)
    np.testing.assert_allclose(spring[far], straight, rtol=1e-12)
    closes = far & (closing > 0.0)
    np.testing.assert_allclose((pressure - spring)[closes], damping * closing[closes], rtol=1e-9)


@pytest.mark.parametrize("yielding", [0.0, 1e-6, 1.0, 1e6])
def test_friction_leaves_the_sliding_that_it_is_of(yielding):
    """w + yielding · friction(w) = sliding, from creep to slip."""
    law = 0.3, 1e-3
    for sliding in (-5.0, -1e-4, 0.0, 1e-7, 0.02, 30.0):
        drag = _drag(40.0, sliding, yielding, law)
        left = contact_law.friction(40.0, sliding - yielding * drag, law)[0]
        assert abs(drag) < 0.3 * 40.0
        if yielding < 1e6:  # else what is left is lost in rounding
            assert drag == pytest.approx(left, rel=1e-6, abs=1e-12)
        else:
            assert yielding * drag == pytest.approx(sliding, rel=1e-4)
