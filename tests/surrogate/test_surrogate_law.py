"""The surrogate as a stress law, its tangents and its file; the quadratic law of tangents."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.base.sampling import sample
from surrofe2.base.tensors import stress_error, transpose
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.law.stress_law import Status
from surrofe2.store import surrogates
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from surrofe2.surrogate.piola import QuadraticLaw, to_piola, to_slopes, to_tangents
from tests.laws import (
    RANGE,
    WELL_INSIDE,
    SoftLaw,
    TrueLattice,
    lattice_stress,
    tangents_by_differences,
)
from tests.numerics import assert_tangents_near
from tests.surrogate.twins import make_law, read_parts, torch_stress, with_bound, write_parts


@pytest.fixture(scope="module")
def trusted(law):
    return with_bound(law)


@pytest.fixture
def file(law, tmp_path):
    path = tmp_path / "surrogate.h5"
    write_surrogate(law, path)
    return path


def test_answers_like_a_stress_law(law):
    F, F_dot = sample(WELL_INSIDE, 100, seed=4)
    state = object()
    first, second = (law.respond(F, F_dot, state) for _ in range(2))
    assert np.array_equal(first.stress, second.stress)
    assert first.status.dtype == np.int8
    assert not first.status.any()
    assert first.effort == {"surrogate_points": 100}
    accepted = law.accept(F, F_dot, first)
    assert accepted.state is state
    assert accepted.status is first.status
    scale = np.abs(first.stress).max()
    assert np.abs(torch_stress(law, F, F_dot) - first.stress).max() < 1e-12 * scale
    assert np.abs(law.extrapolate(F, F_dot) - first.stress).max() < 1e-12 * scale


def test_file_gives_the_same_surrogate(law, file):
    loaded = read_surrogate(str(file))
    F, F_dot = sample(WELL_INSIDE, 100, seed=4)
    assert np.array_equal(law.respond(F, F_dot).stress, loaded.respond(F, F_dot).stress)
    names = ("cell", "initialisation", "range", "settings", "errors", "data_fingerprint")
    for name in (*names, "rest_length", "version"):
        assert getattr(law, name) == getattr(loaded, name), name
    assert all(values.dtype == np.float64 for values in loaded.network.tensors.values())


def assert_refused(path, message):
    with pytest.raises(FileError, match=message) as error:
        read_surrogate(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_foreign_files(tmp_path):
    path = tmp_path / "a-surrogate.h5"
    assert_refused(path, "cannot be read: No such file")
    for content in (b"hello", b"\x80\x04."):
        path.write_bytes(content)
        assert_refused(path, "not an HDF5 file; train again with: surrofe2 train")
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    assert_refused(path, "no SHA-256 in it; .*; train again")


def test_a_surrogate_of_an_older_schema_says_what_to_do(file, monkeypatch):
    content, tensors = read_parts(file)
    with monkeypatch.context() as older:
        older.setattr(surrogates, "SURROGATE", replace(surrogates.SURROGATE, version=5))
        write_parts(file, content, tensors)
    assert_refused(file, "surrogate schema 5; this .* train again with: surrofe2 train RECIPE")


def test_a_flipped_bit_anywhere_is_seen(file):
    """One bit in each of 400 bytes all over the file, the header and its digest among them."""
    stored = file.read_bytes()
    places = {*range(0, 200), *np.linspace(200, len(stored) - 1, 200).astype(int).tolist()}
    for k, place in enumerate(sorted(places)):
        damaged = bytearray(stored)
        damaged[place] ^= 1 << k % 8
        file.write_bytes(damaged)
        assert_refused(file, "damaged|not an HDF5 file|no SHA-256")
    file.write_bytes(stored)
    read_surrogate(file)


def test_nothing_in_a_file_is_executed(tmp_path):
    target, path = tmp_path / "owned", tmp_path / "a-surrogate.h5"
    path.write_bytes(pickle.dumps(Payload(target)))
    assert_refused(path, "not an HDF5 file")
    assert not target.exists()


class Payload:
    """Creates a file when unpickled."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return (Path.touch, (self.target,))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("network", {"symmetry": "other", "degree": 3}),
        ("settings", {"depth": 3}),
        ("cell", {"cell_side": -1.0}),
        ("range", {"stretch": [1.0, 0.9], "shear": 0.1, "rate": 0.1}),
        ("errors", "missing"),
        ("calibration", {"alpha": 0.01}),
        ("network/factors.1.bias", "missing"),
        ("domain/boundary", np.ones(3)),
    ],
)
def test_damaged_entries(trusted, file, key, value):
    write_surrogate(trusted, file)
    content, tensors = read_parts(file)
    parts = tensors if key in tensors else content
    assert key in parts
    parts[key] = value
    if isinstance(value, str):
        del parts[key]
    write_parts(file, content, tensors)
    assert_refused(file, "not a whole surrofe2 surrogate")


def test_a_cached_law_says_that_a_surrogate_was_not_calibrated(law, caplog):
    fallback = TrueLattice()
    finding = "the surrogate's error was not calibrated"
    cached = CachedLaw(law, fallback)
    assert finding in cached.history()["trust"]["events"][0]["finding"]
    assert finding in caplog.text
    F, F_dot = np.eye(2)[None], np.zeros((1, 2, 2))
    assert cached.respond(F, F_dot).effort["fallbacks"] == 1
    trusting = CachedLaw(law, fallback, CacheSettings(tolerance=np.inf))
    assert trusting.history()["trust"]["events"] == []
    assert trusting.respond(F, F_dot).effort["hits"] == 1


Q = np.array([[0.6, -0.8], [0.8, 0.6]])


def turned_points(count):
    F, F_dot = sample(RANGE, count, seed=5)
    F = np.eye(2) + 0.99 * (F - np.eye(2))
    return Q @ F, 0.99 * Q @ F_dot


@pytest.mark.parametrize("symmetry", ["D4", "none"])
def test_tangents_are_the_slopes_of_the_stress(symmetry):
    law = make_law(symmetry)
    F, F_dot = turned_points(10)
    found = law.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(lambda *at: law.respond(*at).stress, F, F_dot, 1e-6)
    assert_tangents_near(found, expected, 1e-6)


def test_slopes_and_tangents_are_each_others_inverse():
    """Slopes by the inputs, differenced from the lattice's stress, against those of tangents."""
    F, F_dot = turned_points(10)
    exact = tangents_by_differences(lattice_stress, F, F_dot, 1e-6)
    slopes = to_slopes(F, exact.P_by_F, exact.P_by_F_dot)
    found = to_tangents(F, F_dot, to_piola(F, lattice_stress(F, F_dot)), slopes)
    assert_tangents_near(found, exact, 1e-7)


def test_no_tangents_where_there_is_no_stress():
    F = np.stack([np.eye(2), 1.5 * np.eye(2)])
    answer = make_law().respond(F, np.zeros((2, 2, 2)), tangents=True)
    assert answer.status.tolist() == [Status.OK, Status.OUT_OF_RANGE]
    for tangent in (answer.tangents.P_by_F, answer.tangents.P_by_F_dot):
        assert np.isfinite(tangent[0]).all()
        assert np.isnan(tangent[1]).all()
    assert make_law().respond(F, np.zeros((2, 2, 2))).tangents is None


LAW = QuadraticLaw.of(TrueLattice())


def stress(F, F_dot):
    return LAW.respond(F, F_dot).stress


def test_it_agrees_with_the_law_to_first_order():
    """The error falls with the square of strain and rate, the stress with the first power."""
    F, F_dot = sample(RANGE, 40, 1)
    errors = []
    for factor in (0.2, 0.1):
        at = np.eye(2) + factor * (F - np.eye(2)), factor * F_dot
        errors.append(stress_error(stress(*at), lattice_stress(*at)).max() / factor)
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.1 * np.abs(stress(F, F_dot)).max()


def test_its_tangents_are_exact_far_from_rest():
    F, F_dot = sample(RANGE, 5, 2)
    F, F_dot = Q @ F @ np.diag([1.4, 0.7]), Q @ F_dot
    found = LAW.respond(F, F_dot, tangents=True).tangents
    expected = tangents_by_differences(stress, F, F_dot)
    np.testing.assert_allclose(found.P_by_F, expected.P_by_F, rtol=0, atol=2e-6)
    np.testing.assert_allclose(found.P_by_F_dot, expected.P_by_F_dot, rtol=0, atol=2e-6)


def test_it_turns_with_the_material_and_has_an_energy():
    F, F_dot = sample(RANGE, 5, 3)
    np.testing.assert_allclose(stress(Q @ F, Q @ F_dot), Q @ stress(F, F_dot) @ Q.T, atol=1e-12)
    answer = LAW.respond(F, 0.0 * F, tangents=True)
    by_F = answer.tangents.P_by_F
    np.testing.assert_allclose(by_F, by_F.transpose(0, 3, 4, 1, 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(answer.stress, transpose(answer.stress), rtol=0, atol=1e-12)


def test_a_law_without_tangents_is_refused():
    with pytest.raises(InputError, match="quadratic law: SoftLaw has no tangents"):
        QuadraticLaw.of(SoftLaw())
