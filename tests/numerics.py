"""What many tests compute: rotations, central differences, rates, whether arrays are near."""

import numpy as np


def turn(angle):
    """(..., 2, 2) rotation by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.moveaxis(np.array([[c, -s], [s, c]]), (0, 1), (-2, -1))


def differences(of, at, step, axes=2):
    """Slopes of of(at) by each entry of the last `axes` axes of `at`, which come last, centrally.

    An entry changes along all leading axes at once: give (n, 2, 2) for n points.
    """
    shape, slopes = np.shape(at)[np.ndim(at) - axes :], []
    for k in np.ndindex(*shape):
        change = np.zeros(shape)
        change[k] = step
        slopes.append((of(at + change) - of(at - change)) / (2.0 * step))
    return np.stack(slopes, axis=-1).reshape(*np.shape(slopes[0]), *shape)


def slope_along(of, at, direction, step):
    """d of(at + s direction)/ds, centrally."""
    return (of(at + step * direction) - of(at - step * direction)) / (2.0 * step)


def fine_slope_along(of, at, direction, step):
    """As `slope_along`, with an error of the fourth power of the step."""
    near, far = (slope_along(of, at, direction, k * step) for k in (1, 2))
    return (4.0 * near - far) / 3.0


def rates(errors):
    """Powers of one half by which an error falls from each to the next."""
    return np.log2(np.divide(errors[:-1], errors[1:]))


def assert_near(found, expected, share):
    """Off by no more than a share of the largest expected value."""
    size = np.abs(expected).max()
    assert np.isfinite(size)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=share * size)


def assert_tangents_near(found, expected, share):
    for name in ("P_by_F", "P_by_F_dot"):
        assert_near(getattr(found, name), getattr(expected, name), share)
