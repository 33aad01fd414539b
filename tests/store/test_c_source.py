"""A surrogate in C answers as the surrogate does: stress, status, bound and tangents."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.law.stress_law import Status
from surrofe2.store.c_source import c_source
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from tests.surrogate.networks import make_law, with_bound

COMPILER = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler is here")
DOUBLES = ctypes.POINTER(ctypes.c_double)


LAWS = {
    "symmetry": make_law,
    "no-symmetry": lambda: make_law("none"),
    "domain": lambda: with_bound(make_law()),
}


def compiled(law, folder):
    """The function in C, of points (n, 2, 2): stress, status, bound and tangents."""
    source, library = folder / "law.c", folder / "law.so"
    source.write_text(c_source(law), encoding="utf-8")
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    subprocess.run(
        [COMPILER, *strict, "-shared", "-fPIC", "-o", str(library), str(source), "-lm"], check=True
    )
    call = ctypes.CDLL(str(library)).surrofe2_stress
    call.argtypes = [DOUBLES, DOUBLES, ctypes.c_double, *[DOUBLES] * 4]

    def respond(F, F_dot, tolerance=np.inf, tangents=True):
        n = len(F)
        stress, bound, status = np.empty((n, 4)), np.empty(n), np.empty(n, dtype=int)
        slopes = np.full((2, n, 16), np.nan)
        for k in range(n):
            given = [np.ascontiguousarray(each[k]) for each in (F, F_dot)]
            pointers = [each.ctypes.data_as(DOUBLES) for each in given]
            out = [stress[k], bound[k : k + 1], slopes[0, k], slopes[1, k]]
            written = [each.ctypes.data_as(DOUBLES) for each in out]
            if not tangents:
                written[2:] = [None, None]
            status[k] = call(*pointers, tolerance, *written)
        return stress.reshape(-1, 2, 2), status, bound, slopes.reshape(2, -1, 2, 2, 2, 2)

    return respond


@pytest.mark.parametrize("name", ["version", "data_fingerprint", "initialisation"])
def test_text_of_a_file_does_not_become_code(tmp_path, name):
    code = "*/ __attribute__((constructor)) static void f(void) {} /*"
    law = replace(make_law(), **{name: code})
    with pytest.raises(InputError, match="surrogate: "):
        c_source(law)
    write_surrogate(law, tmp_path / "law.h5")
    with pytest.raises(FileError, match=f"{name}: "):
        read_surrogate(tmp_path / "law.h5")


def states(law, count=400, beyond=1.15):
    """Within the range of a law, at its edge and beyond, all of them turned."""
    rng = np.random.default_rng(3)
    low, high = law.range.stretch
    U = np.eye(2) + beyond * (high - low) / 2 * rng.uniform(-1.0, 1.0, (count, 2, 2))
    U = 0.5 * (U + np.swapaxes(U, 1, 2))
    angle = rng.uniform(-3.0, 3.0, count)
    c, s = np.cos(angle), np.sin(angle)
    R = np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2)
    return R @ U, beyond * law.range.rate * rng.uniform(-1.0, 1.0, (count, 2, 2))


@pytest.mark.parametrize("kind", LAWS)
def test_the_same_answers(kind, tmp_path):
    law = LAWS[kind]()
    respond = compiled(law, tmp_path)
    F, F_dot = states(law)
    stress, status, bound = law.lookup(F, F_dot)
    known = status == Status.OK
    assert 50 < known.sum() < len(F)
    found = respond(F, F_dot)
    scale = np.abs(stress[known]).max()
    assert np.array_equal(found[1], status)
    assert np.abs(found[0][known] - stress[known]).max() < 1e-12 * scale
    assert np.isnan(found[0][~known]).all()
    finite = np.isfinite(bound)
    assert np.array_equal(np.isfinite(found[2]), finite)
    assert np.allclose(found[2][finite], bound[finite], rtol=1e-12, atol=0.0)
    tangents = law.tangents(F[known], F_dot[known])
    for by, wanted in zip(found[3], (tangents.P_by_F, tangents.P_by_F_dot), strict=True):
        assert np.abs(by[known] - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_a_tolerance_and_no_tangents(tmp_path):
    law = with_bound(make_law())
    respond = compiled(law, tmp_path)
    F, F_dot = states(law)
    _, status, bound = law.lookup(F, F_dot)
    # no bound may be the tolerance itself: those of C differ by rounding
    tolerance = float(np.median(bound[status == Status.OK])) * (1.0 + 1e-9)
    _, wanted, _ = law.lookup(F, F_dot, tolerance)
    found = respond(F, F_dot, tolerance, tangents=False)
    assert {Status.OK, Status.NOT_TRUSTED, Status.OUT_OF_RANGE} == set(wanted.tolist())
    assert np.array_equal(found[1], wanted)
    assert np.isnan(found[3]).all()


def test_what_is_not_a_number_is_out_of_range(tmp_path):
    law = make_law()
    respond = compiled(law, tmp_path)
    F = np.stack([np.full((2, 2), np.nan), np.diag([1.0, -1.0]), np.zeros((2, 2))])
    assert (respond(F, np.zeros_like(F))[1] == Status.OUT_OF_RANGE).all()


def test_the_source_says_whose_it_is():
    law = make_law()
    text = c_source(law)
    assert law.cell.fingerprint in text
    assert law.data_fingerprint in text
    assert max(len(line) for line in text.split("static const")[0].splitlines()) <= 100


def test_the_example_of_a_material_routine(tmp_path):
    """Its stresses are the surrogate's, its slope that of a step by backward differences."""
    law = make_law()
    (tmp_path / "law.c").write_text(c_source(law), encoding="utf-8")
    example = Path(__file__).parents[2] / "examples" / "umat.c"
    command = [COMPILER, "-std=c99", "-Wall", "-Werror", str(example), str(tmp_path / "law.c")]
    subprocess.run([*command, "-o", str(tmp_path / "umat"), "-lm"], check=True)
    said = subprocess.run([str(tmp_path / "umat")], capture_output=True, text=True, check=True)
    rows = np.loadtxt(said.stdout.splitlines(), delimiter=",", skiprows=1)
    assert len(rows) == 20
    F, F_dot = np.tile(np.eye(2), (20, 1, 1)), np.zeros((20, 2, 2))
    F[:, 0, 0] = rows[:, 1]
    F_dot[:, 0, 0] = np.diff(rows[:, 1], prepend=1.0) / 2.0
    answer = law.respond(F, F_dot, tangents=True)
    assert np.allclose(rows[:, 2], answer.stress[:, 0, 0], rtol=1e-12, atol=1e-14)
    assert np.allclose(rows[:, 3], answer.stress[:, 1, 1], rtol=1e-12, atol=1e-14)
    slopes = answer.tangents
    whole = slopes.P_by_F[:, 0, 0, 0, 0] + slopes.P_by_F_dot[:, 0, 0, 0, 0] / 2.0
    assert np.allclose(rows[:, 4], whole, rtol=1e-11)
