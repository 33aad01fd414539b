"""The surrogate as a stress law, and its file."""

import os
import pickle
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from surrofe2.errors import FileError, InputError
from surrofe2.sampling import sample
from surrofe2.stress_law import Status
from surrofe2.surrogate import SurrogateLaw, TrainingSettings, train
from tests.laws import RANGE, WELL_INSIDE, lattice_samples


@pytest.fixture
def file(law, tmp_path):
    path = tmp_path / "surrogate.pt"
    law.save(path)
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
    assert np.abs(law.reference(F, F_dot) - first.stress).max() < 1e-12 * scale


def test_out_of_range_has_a_status_and_no_stress(law):
    F = np.stack([np.eye(2), 1.2 * np.eye(2), np.eye(2)])
    F_dot = np.zeros((3, 2, 2))
    F_dot[2, 0, 1] = 0.02
    answer = law.respond(F, F_dot)
    assert answer.status.tolist() == [Status.OK, Status.OUT_OF_RANGE, Status.OUT_OF_RANGE]
    assert np.isnan(answer.stress[1:]).all()
    assert not answer.stress[0].any()
    assert law.in_range(F, F_dot).tolist() == [True, False, False]
    F[0, 0, 0] = np.nan
    assert not law.in_range(F, F_dot).any()


def test_wrong_input_is_refused(law):
    F, F_dot = np.eye(2)[None], np.zeros((1, 2, 2))
    with pytest.raises(InputError, match="shape"):
        law.respond(F[0], F_dot[0])
    with pytest.raises(InputError, match="does not match"):
        law.respond(F, np.zeros((2, 2, 2)))
    with pytest.raises(InputError, match="not finite"):
        law.respond(np.nan * F, F_dot)
    with pytest.raises(InputError, match="det F = -1"):
        law.respond(np.diag([1.0, -1.0])[None], F_dot)


def test_lists_and_views_are_taken(law):
    F, F_dot = sample(WELL_INSIDE, 6, seed=4)
    expected = law.respond(F, F_dot).stress
    assert np.array_equal(law.respond(F.tolist(), F_dot.tolist()).stress, expected)
    assert np.array_equal(law.respond(F[::-1], F_dot[::-1]).stress, expected[::-1])


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_file_gives_the_same_surrogate(precision, tmp_path):
    settings = TrainingSettings(
        hidden=(6, 6), baseline_degree=2, iterations=20, precision=precision
    )
    law = train(lattice_samples(400), settings)
    law.save(tmp_path / "a.pt")
    loaded = SurrogateLaw.load(str(tmp_path / "a.pt"))
    F, F_dot = sample(WELL_INSIDE, 100, seed=4)
    assert np.array_equal(law.respond(F, F_dot).stress, loaded.respond(F, F_dot).stress)
    assert loaded.network.input_scale.dtype == getattr(torch, precision)
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
    bytes_each = 8 if precision == "float64" else 4
    assert law.network.members[0].factors.layers[0].weight.element_size() == bytes_each


def test_file_is_replaced_whole(law, file):
    mode = stat.S_IMODE(os.stat(file).st_mode)
    law.save(file)
    assert os.listdir(file.parent) == [file.name]
    assert stat.S_IMODE(os.stat(file).st_mode) == mode
    assert mode & stat.S_IRUSR


def test_a_folder_that_is_not_there_or_a_folder_in_the_way(law, tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        law.save(tmp_path / "missing" / "a.pt")
    with pytest.raises(FileError, match="cannot be written"):
        law.save(tmp_path)
    assert os.listdir(tmp_path) == []


def test_a_failed_write_leaves_the_old_file(law, file, monkeypatch):
    before = file.read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(FileError, match="No space left"):
        law.save(file)
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == [file.name]


def assert_refused(path, message):
    with pytest.raises(FileError, match=message) as error:
        SurrogateLaw.load(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_no_file(tmp_path):
    assert_refused(tmp_path / "none.pt", "cannot be read: No such file")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file(file, share):
    stored = file.read_bytes()
    file.write_bytes(stored[: int(share * len(stored))])
    assert_refused(file, "not a surrogate: truncated")


@pytest.mark.parametrize("content", [b"hello", b"\x89HDF\r\n\x1a\n" + bytes(600), b"PK\x03\x04"])
def test_a_foreign_file(tmp_path, content):
    path = tmp_path / "foreign.pt"
    path.write_bytes(content)
    assert_refused(path, "not a surrogate")


@pytest.mark.parametrize("content", [{"a": 1}, [1, 2], torch.zeros(3), {"format": "other"}])
def test_a_torch_file_of_something_else(tmp_path, content):
    torch.save(content, tmp_path / "other.pt")
    assert_refused(tmp_path / "other.pt", "not a surrogate that this version")


def test_a_surrogate_of_an_older_version(file):
    content = torch.load(file, weights_only=True)
    content["format"] = "surrofe2 surrogate 1"
    torch.save(content, file)
    assert_refused(file, "surrogate 1, from before the network had an energy; train it anew")


class Payload:
    """Creates a file when unpickled."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return (Path.touch, (self.target,))


@pytest.mark.parametrize("legacy", [False, True])
def test_a_payload_is_never_run(file, tmp_path, legacy):
    target = tmp_path / "owned"
    content = torch.load(file, weights_only=True)
    content["settings"] = Payload(target)
    torch.save(content, file, _use_new_zipfile_serialization=not legacy)
    assert_refused(file, "holding more than weights")
    assert not target.exists()
    torch.load(file, weights_only=False)
    assert target.exists()  # the payload would have worked


def test_a_bare_pickle_is_never_run(tmp_path):
    target, path = tmp_path / "owned", tmp_path / "a.pt"
    path.write_bytes(pickle.dumps(Payload(target)))
    assert_refused(path, "not a surrogate")
    assert not target.exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("weights", {}),
        ("settings", {"hidden": [4]}),
        ("settings", {"depth": 3}),
        ("settings", None),
        ("cell", {"cell_side": -1.0}),
        ("range", {"stretch": [1.0, 0.9], "shear": 0.1, "rate": 0.1}),
    ],
)
def test_damaged_entries(file, key, value):
    content = torch.load(file, weights_only=True)
    content[key] = value
    torch.save(content, file)
    assert_refused(file, "missing or damaged entries")


@pytest.mark.parametrize("key", ["weights", "range", "cell", "cell_fingerprint", "errors"])
def test_missing_entries(file, key):
    content = torch.load(file, weights_only=True)
    del content[key]
    torch.save(content, file)
    assert_refused(file, "missing or damaged entries")


def test_cell_parameters_that_were_altered(file):
    content = torch.load(file, weights_only=True)
    content["cell"]["viscosity"] = 0.2
    torch.save(content, file)
    assert_refused(file, "its cell parameters give fingerprint")


def test_units_stand_in_the_file(file):
    content = torch.load(file, weights_only=True)
    assert content["units"]["stress"] == "µN/µm"
    assert content["units"]["rate"] == "1/µs"


def test_a_shifted_range_is_obeyed(law):
    narrow = replace(law, range=replace(RANGE, rate=0.001))
    F, F_dot = sample(WELL_INSIDE, 50, seed=4)
    assert (narrow.respond(F, F_dot).status == Status.OUT_OF_RANGE).sum() > 40
