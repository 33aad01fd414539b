"""The surrogate as a stress law, and its file."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.base.sampling import sample
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.store import surrogates
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from surrofe2.surrogate import TrainingSettings, train
from tests.laws import WELL_INSIDE, TrueLattice, lattice_samples
from tests.surrogate.twins import read_parts, torch_stress, with_bound, write_parts


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


def test_file_gives_the_same_surrogate(tmp_path):
    settings = TrainingSettings(hidden=(6, 6), baseline_degree=2, iterations=20)
    law = train(lattice_samples(400), settings)
    write_surrogate(law, tmp_path / "a-surrogate.h5")
    loaded = read_surrogate(str(tmp_path / "a-surrogate.h5"))
    F, F_dot = sample(WELL_INSIDE, 100, seed=4)
    assert np.array_equal(law.respond(F, F_dot).stress, loaded.respond(F, F_dot).stress)
    for name in (
        "cell",
        "initialisation",
        "range",
        "settings",
        "errors",
        "data_fingerprint",
        "rest_length",
        "version",
    ):
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
