"""What commands leave in a folder: all numbers but those of time, and whether two are the same.

To the bit; or, of runs that solve their RVEs in other tiles, as ranks do, curves to 1e-9 of their
amplitude, histories with forces to 1e-8, each frame of fields to 1e-7.
"""

import json

import h5py
import numpy as np

from surrofe2.store.store import SEAL

OF_TIME = {
    "created", "wall_time", "true_wall_time", "speed_up", "seconds", "cost", "all_counted",
    "sha256", "inputs", "of", SEAL,
}  # fmt: skip
OF_SOLVES = ("force_evaluations", "newton_solves", "files")
"""What depends on the factors that a solve starts with, and digests of what differs by rounding."""


def numbers(folder):
    """All numbers in a folder by file, but when they were made and how long that took."""
    return {
        path.relative_to(folder).as_posix(): _numbers(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _numbers(path):
    if path.suffix == ".png" or path.name == "grid.csv":
        return None
    if path.suffix == ".h5":
        return _stored(path)
    if path.suffix not in (".json", ".jsonl", ".csv"):
        return path.read_bytes()
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return _lasting(json.loads(text))
    head, *rows = text.splitlines() or [""]
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in text.splitlines()]
    return {head: np.array([row.split(",") for row in rows], dtype=float)}


def _lasting(value):
    if isinstance(value, dict):
        return {key: _lasting(entry) for key, entry in value.items() if key not in OF_TIME}
    return [_lasting(entry) for entry in value] if isinstance(value, list) else value


def _stored(path):
    found = {}
    with h5py.File(path) as file:
        found["attributes"] = {k: str(v) for k, v in file.attrs.items() if k not in OF_TIME}

        def collect(name, item):
            if isinstance(item, h5py.Dataset):
                found[name] = item[()]

        file.visititems(collect)
    return found


def assert_same(folder, whole):
    """Folders, or what `numbers` gave of them, are the same to the bit."""
    mine, theirs = (each if isinstance(each, dict) else numbers(each) for each in (folder, whole))
    assert_equal(mine, theirs, exact=True)


def assert_equal(mine, theirs, exact=False, name=""):
    if isinstance(theirs, dict):
        assert set(mine) == set(theirs), name
        for key, value in theirs.items():
            # of points.xdmf only the values that it quotes differ, of which points.h5 has all
            if exact or not (key in OF_SOLVES or key.endswith(".xdmf")):
                assert_equal(mine[key], value, exact, f"{name}/{key}")
    elif isinstance(theirs, list) and not is_tensor(theirs):
        assert len(mine) == len(theirs), name
        for k, value in enumerate(theirs):
            assert_equal(mine[k], value, exact, f"{name}/{k}")
    elif exact or np.asarray(theirs).dtype.kind != "f":
        np.testing.assert_array_equal(mine, theirs, err_msg=name)
    else:
        curve = 1e-8 if "force" in name else 1e-9
        share = curve if ".csv" in name else 1e-7  # of each frame, where stresses nearly cancel
        amplitude = np.nanmax(np.abs(theirs), initial=0.0)
        np.testing.assert_allclose(mine, theirs, rtol=0.0, atol=share * amplitude, err_msg=name)


def is_tensor(values):
    """Whether nested lists are floats throughout, which have one amplitude."""
    if isinstance(values, list):
        return bool(values) and all(map(is_tensor, values))
    return isinstance(values, float)
