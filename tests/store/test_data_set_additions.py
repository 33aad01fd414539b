"""What a data set may hold besides stresses, tangents and marks, and older ones without them."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.base.sampling import sample
from surrofe2.law.stress_law import StressResponse, Tangents
from surrofe2.store.samples import read_data_set, writing_data_set
from tests.laws import SoftLaw
from tests.store.small_data_set import HEADER, RANGE, write_all


def test_tangents_are_kept_to_the_bit(tmp_path):
    path, header = tmp_path / "cells.h5", replace(HEADER, tangents=True)
    law = SoftLaw(fails_above=1.03)
    F, F_dot = sample(RANGE, 20, 3)
    answer = law.respond(F, F_dot)
    values = np.random.default_rng(5).normal(size=(2, 20, 2, 2, 2, 2))
    values[:, answer.status != 0] = np.nan
    with writing_data_set(path, header) as data:
        for rows in (slice(0, 8), slice(8, 20)):
            slopes = Tangents(values[0, rows], values[1, rows])
            part = StressResponse(answer.stress[rows], answer.status[rows], tangents=slopes)
            data.append(F[rows], F_dot[rows], part)
        data.finish()
    samples = read_data_set(path)
    np.testing.assert_array_equal(samples.P_by_F, values[0])
    np.testing.assert_array_equal(samples.P_by_F_dot, values[1])
    with h5py.File(path) as file:
        assert file["P_by_F"].attrs["unit"] == "µN/µm"
        assert file["P_by_F_dot"].attrs["unit"] == "µN µs/µm"
    with h5py.File(path, "r+") as file:
        file["P_by_F_dot"][0, 0, 0, 0, 0] += 1e-12
    with pytest.raises(FileError, match="changed since it was written"):
        read_data_set(path)


def test_a_data_set_without_tangents_has_none_and_is_not_continued_with_them(tmp_path):
    path = tmp_path / "cells.h5"
    write_all(path)
    assert read_data_set(path).P_by_F is read_data_set(path).P_by_F_dot is None
    with (
        pytest.raises(MismatchError, match=r"samples\.tangents: this call has True, what is there"),
        writing_data_set(path, replace(HEADER, tangents=True)),
    ):
        pass


def test_samples_beyond_a_bifurcation_are_marked_and_not_valid(tmp_path):
    path = tmp_path / "cells.h5"
    F, F_dot = sample(RANGE, 20, 3)
    answer = SoftLaw(fails_above=1.03).respond(F, F_dot)
    failed = answer.status != 0
    assert failed[8:].any()
    left = (np.arange(20) % 5 == 0) | failed  # what failed is not counted once more
    with writing_data_set(path, HEADER) as data:
        data.append(F[:8], F_dot[:8], StressResponse(answer.stress[:8], answer.status[:8]))
        rest = StressResponse(answer.stress[8:], answer.status[8:], left_bifurcation=left[8:])
        data.append(F[8:], F_dot[8:], rest)
        assert data.left_count() == 2
        data.finish()
    samples = read_data_set(path)
    assert (samples.left_bifurcation & ~failed).nonzero()[0].tolist() == [10, 15]
    kept = np.flatnonzero((answer.status == 0) & ~samples.left_bifurcation)
    np.testing.assert_array_equal(samples.valid.F, F[kept])
    assert replace(samples, left_bifurcation=None).fingerprint != samples.fingerprint
    with pytest.raises(InputError, match="left_bifurcation"):
        replace(samples, left_bifurcation=left[:3])
