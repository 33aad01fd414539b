"""The range of deformations, its sequence of points, and the samples."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import (
    QUANTITIES,
    SamplingRange,
    contains,
    farthest_out,
    out_of_range,
    sample,
    training_points,
)
from surrofe2.law.samples import StressSamples
from surrofe2.plant_cell.parameters import CellParameters
from tests.numerics import turn

RANGE = SamplingRange(stretch=(0.9, 1.05), shear=0.08, rate=0.01)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stretch": (1.1, 0.9)}, r"range.stretch: \(1.1, 0.9\); low must be below high"),
        ({"stretch": (-0.1, 1.0)}, "both positive"),
        ({"stretch": (0.9, np.inf)}, "range.stretch"),
        ({"shear": -0.1}, "range.shear: -0.1; it must be at least 0"),
        ({"shear": 0.9}, "det U > 0"),
        ({"rate": np.nan}, "range.rate: nan"),
    ],
)
def test_a_range_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(InputError, match=message) as error:
        SamplingRange(**{"stretch": (0.9, 1.1), "shear": 0.1, "rate": 0.01, **changes})
    assert "\n" not in str(error.value)


def test_points_are_those_of_data_sets_of_before():
    """Point 1000 by seed 7 of `scipy.stats.qmc.Sobol` 1.17, to the bit, however it is cut out."""
    unit = SamplingRange(stretch=(1.0, 2.0), shear=0.5, rate=0.5)
    known = [
        0.523336467333138, 0.9700869442895055, 0.9816194521263242, 0.12429645750671625,
        0.7514833947643638, 0.8737063156440854, 0.8571016620844603,
    ]  # fmt: skip
    for start, count in ((1000, 1), (990, 20), (0, 1001)):
        F, F_dot = sample(unit, count, 7, start)
        found = F[1000 - start, [0, 1, 0], [0, 1, 1]] - [1.0, 1.0, -0.5]
        np.testing.assert_array_equal([*found, *(F_dot[1000 - start].ravel() + 0.5)], known)


def test_points_fill_the_range_and_no_more():
    F, F_dot = sample(RANGE, 4096, seed=3)
    assert F.shape == F_dot.shape == (4096, 2, 2)
    assert np.array_equal(F[:, 0, 1], F[:, 1, 0])
    for values, low, high in [
        (F[:, 0, 0], 0.9, 1.05),
        (F[:, 1, 1], 0.9, 1.05),
        (F[:, 0, 1], -0.08, 0.08),
        *[(F_dot[:, i, j], -0.01, 0.01) for i in (0, 1) for j in (0, 1)],
    ]:
        width = high - low
        assert low <= values.min() < low + 0.01 * width
        assert high - 0.01 * width < values.max() <= high
        # a Sobol sequence is far more even than chance, whose counts scatter by about 20
        counts = np.histogram(values, bins=8, range=(low, high))[0]
        assert np.abs(counts - 512).max() <= 2
    assert contains(RANGE, F, F_dot).all()


def test_points_of_a_data_set_begin_at_rest_and_a_third_is_near_it():
    F, F_dot = training_points(RANGE, 3000, seed=5)
    even = sample(RANGE, 3000, seed=5)
    assert np.array_equal(F[0], np.eye(2))
    assert not F_dot[0].any()
    size, was = ([np.abs(U - np.eye(2)).max(axis=(1, 2)), np.abs(A).max(axis=(1, 2))]
                 for U, A in ((F, F_dot), even))  # fmt: skip
    share = size[0] / was[0]
    np.testing.assert_allclose(size[1], share * was[1], rtol=1e-12)
    drawn = share < 1.0 - 1e-9
    assert drawn[1:].sum() == 1000
    # the logarithm of the factor is even from that of 0.03 to 0
    counts = np.histogram(np.log(share[1:][drawn[1:]]) / np.log(0.03), 10, (0.0, 1.0))[0]
    assert np.abs(counts - 100).max() <= 2
    assert contains(RANGE, F, F_dot).all()
    later = training_points(RANGE, 1500, seed=5, start=1500)
    assert np.array_equal(F[1500:], later[0])
    assert np.array_equal(F_dot[1500:], later[1])


def test_range_is_of_stretch_and_of_rates_seen_by_the_material():
    F, F_dot = np.eye(2) * np.ones((6, 1, 1)), np.zeros((6, 2, 2))
    F[1, 0, 0] = 1.0501
    F[2] = turn(2.0) @ np.diag([0.91, 1.04])  # a rotation alone takes nothing out of range
    F[3, 0, 1] = F[3, 1, 0] = -0.0801
    F_dot[4, 1, 0] = 0.0101
    F[5, 1, 1] = -1.0
    expected = [True, False, True, False, False, False]
    assert contains(RANGE, F, F_dot).tolist() == expected


def test_edges_belong_to_the_range_in_any_orientation():
    angles = np.linspace(0.0, 6.0, 50)
    edge = np.array([[0.9, 0.08], [0.08, 1.05]])
    F, F_dot = turn(angles) @ edge, turn(angles) @ np.full((2, 2), -0.01)
    assert contains(RANGE, F, F_dot).all()
    assert not contains(RANGE, F, F_dot * (1.0 + 1e-9)).any()
    assert not contains(RANGE, F * (1.0 + 1e-9), F_dot).any()


def test_what_is_not_a_number_is_not_in_range():
    for value, k, which in product((np.nan, np.inf), range(4), (0, 1)):
        both = np.array([np.eye(2)[None], np.zeros((1, 2, 2))])
        both[which].flat[k] = value
        assert not contains(RANGE, *both).any()
    assert not contains(RANGE, np.zeros((1, 2, 2)), np.zeros((1, 2, 2))).any()


def samples(**changes):
    F, F_dot = sample(RANGE, 8, seed=1)
    values = {
        "F": F,
        "F_dot": F_dot,
        "stress": F + F_dot,
        "status": np.zeros(8, dtype=np.int8),
        "cell": CellParameters(),
        "initialisation": "elastic",
        "range": RANGE,
        "seed": 1,
    }
    return StressSamples(**{**values, **changes})


def test_samples_with_a_stress_are_valid():
    status = np.array([0, 1, 0, 2, 0, 0, 0, 0], dtype=np.int8)
    stress = np.where(status[:, None, None] == 0, 1.0, np.nan) * np.ones((8, 2, 2))
    valid = samples(status=status, stress=stress).valid
    assert len(valid.F) == len(valid.status) == 6
    assert np.array_equal(valid.F, samples().F[status == 0])
    assert np.isfinite(valid.stress).all()


def test_fingerprint_sees_every_field():
    moved = samples().stress.copy()
    moved[3, 0, 1] = np.nextafter(moved[3, 0, 1], 2.0)
    others = [
        samples(stress=moved),
        samples(F=samples().F + 1e-15),
        samples(F_dot=samples().F_dot + 1e-17),
        samples(status=np.array([0] * 7 + [1], dtype=np.int8)),
        samples(cell=CellParameters.preset("water")),
        samples(initialisation="constrained-runs"),
        samples(range=SamplingRange(stretch=(0.9, 1.06), shear=0.08, rate=0.01)),
        samples(seed=2),
        samples(rest_length=1.4),
    ]
    fingerprints = {item.fingerprint for item in others} | {samples().fingerprint}
    assert len(fingerprints) == 1 + len(others)
    assert samples().fingerprint == samples().fingerprint
    assert len(samples().fingerprint) == 16


SLOPES = np.random.default_rng(0).normal(size=(2, 8, 2, 2, 2, 2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stress": np.zeros((7, 2, 2))}, "stress: shape"),
        ({"status": np.zeros(9, np.int8)}, "status: shape"),
        ({"stress": np.full((8, 2, 2), np.nan)}, "stress: not finite"),
        ({"P_by_F": SLOPES[0]}, "give both or neither"),
        ({"P_by_F": np.ones((8, 2, 2)), "P_by_F_dot": SLOPES[1]}, "P_by_F: shape (8, 2, 2);"),
        ({"P_by_F": np.nan * SLOPES[0], "P_by_F_dot": SLOPES[1]}, "P_by_F: not finite"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_samples_of_the_wrong_shape_or_without_a_number_are_refused(changes, message):
    with pytest.raises(InputError, match=r"samples\..*" + re.escape(message)):
        samples(**changes)


def test_tangents_belong_to_the_samples():
    slopes = SLOPES.copy()
    status = np.array([0, 1, 0, 2, 0, 0, 0, 0], dtype=np.int8)
    slopes[:, status != 0] = np.nan
    whole = samples(status=status, P_by_F=slopes[0], P_by_F_dot=slopes[1])
    assert np.array_equal(whole.valid.P_by_F_dot, slopes[1][status == 0])
    other = replace(whole, P_by_F_dot=slopes[1] * (1.0 + 1e-15))
    assert len({samples().fingerprint, whole.fingerprint, other.fingerprint}) == 3


@pytest.mark.parametrize(
    ("U", "A", "said"),
    [
        ([[1.1, 0.0], [0.0, 0.95]], 0.0, "U₁₁ = 1.1 of at most 1.05 .*, 0.05 beyond"),
        ([[1.0, 0.0], [0.0, 0.8]], 0.0, "U₂₂ = 0.8 of at least 0.9 .*, 0.1 beyond"),
        ([[1.06, -0.1], [-0.1, 1.0]], 0.0, "U₁₂ = -0.1 of at least -0.08 .*, 0.02 beyond"),
        ([[1.06, 0.0], [0.0, 1.0]], 0.03, r"\(RᵀḞ\)₂₁ = 0.03 of at most 0.01 .*, 0.02 beyond"),
        ([[1.05, 0.08], [0.08, 0.9]], 0.01, None),
    ],
)
def test_what_is_farthest_out_is_named_after_the_rotation_is_taken_out(U, A, said):
    F = turn(0.7)[None] @ np.array(U)
    F_dot = turn(0.7)[None] @ np.array([[0.0, 0.0], [A, 0.0]])
    (which,), (value,), (bound,) = farthest_out(RANGE, F, F_dot)
    assert (which < 0) == (said is None)
    if said is not None:
        assert re.fullmatch(said, out_of_range(QUANTITIES[which], value, bound))
