"""Where the stress came from, as a cached law tells it and fields keep it."""

import numpy as np

from surrofe2 import LoadCase
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.stress_law import SURROGATE, Status
from surrofe2.macro import MacroSettings, simulate
from tests.laws import Learnt, Truth


def strain(F):
    return abs(F - np.eye(2)).max(axis=(1, 2))


def make_law(tolerance=0.01):
    """Out of range above a strain of 0.02, bound above the tolerance from 0.01 on."""
    surrogate = Learnt(
        error=lambda F, F_dot: np.zeros(len(F)),
        bound=lambda F, F_dot: strain(F),
        outside=lambda F: strain(F) > 0.02,
    )
    return CachedLaw(surrogate, Truth(), CacheSettings(tolerance=tolerance / 10.0, audit=0.0))


def test_sources_and_risks_of_an_answer():
    F = np.tile(np.eye(2), (3, 1, 1))
    F[:, 0, 1] = 0.005, 0.015, 0.025
    told = make_law().respond(F, 0.0 * F).sources()
    assert told.source.tolist() == [SURROGATE, Status.NOT_TRUSTED, Status.OUT_OF_RANGE]
    np.testing.assert_allclose(told.risk, [0.5, 0.0, 0.0])


def test_frames_keep_the_largest_of_each_element():
    load = LoadCase(duration=20.0, body_force=(0.0, -0.2), elements=(4, 2))
    frames = simulate(load, make_law(), MacroSettings(frames=6)).frames
    assert frames.source.shape == frames.risk.shape == (len(frames.t), 8)
    assert (frames.source[0] == SURROGATE).all()
    hit = frames.source == SURROGATE
    assert 0 < hit.sum() < hit.size
    known = {SURROGATE, Status.NOT_TRUSTED, Status.OUT_OF_RANGE}
    assert known.issuperset(frames.source.ravel())
    assert (frames.risk <= 1.0).all()
    # Of the points of an element the middle one is among those whose largest risk is told.
    middle = strain(frames.F.reshape(-1, 2, 2)).reshape(hit.shape)
    assert (frames.risk[hit] >= middle[hit] / 0.01 * (1.0 - 1e-12)).all()
