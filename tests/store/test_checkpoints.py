from __future__ import annotations

import numpy as np
import pytest

from surrofe2.base.errors import FileError
from surrofe2.store.hdf5 import read_checkpoint, write_checkpoint


def test_arrays_come_back_as_they_were(tmp_path):
    path = tmp_path / "checkpoint.h5"
    arrays = {
        "t": np.array(0.1 + 0.2),
        "y": np.random.default_rng(0).normal(size=(3, 2)),
        "counts.steps": np.array(7),
        "empty": np.empty((0, 2)),
    }
    write_checkpoint(path, arrays, "an rve run")
    back = read_checkpoint(path, "an rve run")
    assert back.keys() == arrays.keys()
    for name, values in arrays.items():
        np.testing.assert_array_equal(back[name], values)
        assert back[name].dtype == values.dtype


def test_checkpoint_of_something_else(tmp_path):
    path = tmp_path / "checkpoint.h5"
    write_checkpoint(path, {}, "a training")
    with pytest.raises(FileError) as caught:
        read_checkpoint(path, "an rve run")
    assert str(caught.value) == f"{path}: a checkpoint of a training, not of an rve run"
