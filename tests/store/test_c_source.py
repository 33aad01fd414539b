"""A surrogate in C answers as the surrogate does: stress, status, bound and tangents."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError
from surrofe2.law.stress_law import Status
from surrofe2.macro import MacroSettings, find_rest
from surrofe2.problem.conditions import Fixed, PrescribedMotion, Traction
from surrofe2.problem.mesh import rectangle
from surrofe2.problem.problem import Problem
from surrofe2.store.c_source import c_header, c_source
from surrofe2.store.surrogates import read_surrogate, write_surrogate
from tests.surrogate.twins import make_law, with_bound

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
    call, batch = (getattr(ctypes.CDLL(str(library)), f"surrofe2_stress{of}") for of in ("", "_of"))
    call.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_double] + [ctypes.c_void_p] * 4
    batch.argtypes = [ctypes.c_size_t, *call.argtypes, ctypes.c_void_p]
    batch.restype = ctypes.c_size_t

    def respond(F, F_dot, tolerance=np.inf, tangents=True):
        def at(*arrays):
            return [each.ctypes.data for each in arrays]

        n, F, F_dot = len(F), np.ascontiguousarray(F), np.ascontiguousarray(F_dot)
        stress, bound, status = np.empty((n, 4)), np.empty(n), np.empty(n, dtype=np.int32)
        slopes = np.full((2, n, 16), np.nan)
        for k in range(n):
            to = at(*slopes[:, k]) if tangents else [None, None]
            status[k] = call(*at(F[k], F_dot[k]), tolerance, *at(stress[k], bound[k:]), *to)
        # a batch has the same answers, and leaves the slopes alone where a point has none
        together = [np.empty((n, 4)), np.empty(n), *np.full((2, n, 16), np.nan)]
        statuses, to = np.empty_like(status), at(*together)
        to = to if tangents else [*to[:2], None, None]
        lost = batch(n, *at(F, F_dot), tolerance, *to, *at(statuses))
        assert np.array_equal(statuses, status)
        assert lost == np.count_nonzero(status)
        for found, wanted in zip(together, (stress, bound, *slopes), strict=True):
            amplitude = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12 * amplitude)
        return stress.reshape(-1, 2, 2), status, bound, slopes.reshape(2, -1, 2, 2, 2, 2)

    return respond


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    """By kind: a law, and its function in C."""

    @cache
    def of(kind):
        law = LAWS[kind]()
        return law, compiled(law, tmp_path_factory.mktemp(kind))

    return of


@pytest.mark.parametrize("name", ["version", "data_fingerprint", "initialisation"])
def test_text_of_a_file_does_not_become_code(tmp_path, name):
    code = "*/ __attribute__((constructor)) static void f(void) {} /*"
    law = replace(make_law(), **{name: code})
    with pytest.raises(InputError, match="surrogate: "):
        c_source(law)
    write_surrogate(law, tmp_path / "law.h5")
    with pytest.raises(FileError, match=f"{name}: "):
        read_surrogate(tmp_path / "law.h5")


def states(law, count=403, beyond=1.15):
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
def test_the_same_answers(kind, in_c):
    law, respond = in_c(kind)
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


def test_a_tolerance_and_no_tangents(in_c):
    law, respond = in_c("domain")
    F, F_dot = states(law)
    _, status, bound = law.lookup(F, F_dot)
    # no bound may be the tolerance itself: those of C differ by rounding
    tolerance = float(np.median(bound[status == Status.OK])) * (1.0 + 1e-9)
    _, wanted, _ = law.lookup(F, F_dot, tolerance)
    found = respond(F, F_dot, tolerance, tangents=False)
    assert {Status.OK, Status.NOT_TRUSTED, Status.OUT_OF_RANGE} == set(wanted.tolist())
    assert np.array_equal(found[1], wanted)
    assert np.isnan(found[3]).all()


def test_what_is_not_a_number_is_out_of_range(in_c):
    _, respond = in_c("symmetry")
    F = np.stack([np.full((2, 2), np.nan), np.diag([1.0, -1.0]), np.zeros((2, 2))])
    assert (respond(F, np.zeros_like(F))[1] == Status.OUT_OF_RANGE).all()


def test_the_source_says_whose_it_is():
    law = make_law()
    text = c_source(law)
    assert law.cell.fingerprint in text
    assert law.data_fingerprint in text
    assert max(len(line) for line in text.split("static const")[0].splitlines()) <= 100


FORTRAN = pytest.mark.skipif(shutil.which("gfortran") is None, reason="no Fortran compiler is here")


def umat_of(law, folder):
    """The example of a UMAT for a law: (σ (3,) xx, yy, xy, its slope (3, 3), pnewdt) of a step."""
    (folder / "law.c").write_text(c_source(law), encoding="utf-8")
    example = Path(__file__).parents[2] / "examples" / "umat.f90"
    strict = ["-O1", "-Wall", "-Wno-unused-dummy-argument", "-fcheck=all", "-shared", "-fPIC"]
    for command in (
        [COMPILER, "-O2", "-fPIC", "-c", "-o", "law.o", "law.c"],
        ["gfortran", *strict, "-o", "umat.so", str(example), "law.o"],
    ):
        subprocess.run(command, check=True, cwd=folder)
    call = ctypes.CDLL(str(folder / "umat.so")).umat_

    def umat(F0, F1, dt):
        numbers = {name: np.zeros(size) for name, size in (("stress", 4), ("slope", 16))}
        new_dt = ctypes.c_double(1.0)
        three = [np.eye(3) for _ in range(2)]
        for whole, F in zip(three, (F0, F1), strict=True):
            whole[:2, :2] = F
        f0, f1 = (np.asfortranarray(each).ravel(order="F") for each in three)
        spare, none = np.zeros(16), ctypes.c_int(0)
        pointer = lambda each: each.ctypes.data_as(DOUBLES)  # noqa: E731
        given = dict.fromkeys(range(37), pointer(spare))
        given |= {0: pointer(numbers["stress"]), 2: pointer(numbers["slope"])}
        given |= {13: ctypes.byref(ctypes.c_double(dt)), 18: b" " * 80}
        given |= {k: ctypes.byref(none) for k in (19, 20, 22, 24, *range(31, 37))}
        given |= {21: ctypes.byref(ctypes.c_int(4)), 27: ctypes.byref(new_dt)}
        given |= {29: pointer(f0), 30: pointer(f1)}
        call(*given.values(), ctypes.c_size_t(80))
        at = [0, 1, 3]
        return numbers["stress"][at], numbers["slope"].reshape(4, 4).T[np.ix_(at, at)], new_dt.value

    return umat


@FORTRAN
def test_the_umat_finds_the_element_at_rest_of_our_implicit_solver(tmp_path):
    """One element, stretched along x and pulled across; a step so long that no rate is left."""
    law, stretch, wanted, dt = make_law(), 1.005, 1.001, 1e12
    umat, F = umat_of(law, tmp_path), np.diag([stretch, wanted])[None]
    pull = float(law.respond(F, 0.0 * F).first_piola(F)[0, 1, 1])
    held = (
        Fixed(on="left", components="x"),
        Fixed(on="bottom", components="y"),
        PrescribedMotion(on="right", displacement=(10.0 * (stretch - 1.0), None)),
        Traction(on="top", traction=(0.0, pull)),
    )
    problem = Problem(mesh=rectangle(10.0, 10.0, (1, 1)), conditions=held)
    rest = find_rest(problem, law, MacroSettings(newton_tolerance=1e-11))
    width = 1.0
    for _ in range(12):
        stress, slope, _ = umat(np.eye(2), np.diag([stretch, width]), dt)
        rise = stretch * (slope[1, 1] - stress[1]) / width
        width -= (stretch * stress[1] - pull) / rise
    assert np.abs(rest.F - np.diag([stretch, width])).max() < 1e-8
    exact = law.respond(rest.F[:1], 0.0 * rest.F[:1]).stress[0]
    stress = umat(np.eye(2), rest.F[0], dt)[0]
    assert np.abs(stress - exact[[0, 1, 0], [0, 1, 1]]).max() < 1e-8 * np.abs(exact).max()


@FORTRAN
def test_the_example_of_an_abaqus_umat(tmp_path):
    """A strip that is stretched, turned and free across: solved by UMAT as by the law itself."""
    law, dt = make_law(), 2.0
    umat = partial(umat_of(law, tmp_path), dt=dt)

    def by_law(F0, F1):
        return law.respond(F1[None], (F1 - F0)[None] / dt, tangents=True)

    def sides(angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s], [s, c]])

    normal, before = np.array([0.0, 1.0]), (np.eye(2), np.eye(2))
    for stretch, angle, wanted in ((1.005, 0.01, 1.001), (1.01, 0.02, 1.002), (1.01, 0.03, 1.001)):
        R = sides(angle)
        across = R[:, 1]
        F = R @ np.diag([stretch, wanted])
        pull = across @ by_law(before[1], F).first_piola(F[None])[0] @ normal
        widths, D = [1.0, 1.0], np.array([*across**2, 2.0 * across[0] * across[1]])
        for _ in range(12):  # the nominal traction across is `pull`, by Newton steps
            Fs = [R @ np.diag([stretch, width]) for width in widths]
            stress, slope, _ = umat(before[0], Fs[0])
            rise = stretch * (D @ slope @ D - D @ stress) / widths[0]
            widths[0] -= (stretch * (D @ stress) - pull) / rise
            answer = by_law(before[1], Fs[1])
            tangent = answer.tangents.over_step(dt)[0]
            rise = np.einsum("a,b,abcd,c,d", across, normal, tangent, across, normal)
            P = answer.first_piola(Fs[1][None])[0]
            widths[1] -= (across @ P @ normal - pull) / rise
        assert abs(widths[0] - widths[1]) < 1e-8
        assert abs(widths[1] - wanted) < 1e-8
        stress, _, new_dt = umat(before[0], Fs[0])
        exact = by_law(before[1], Fs[1]).stress[0]
        symmetric = [exact[0, 0], exact[1, 1], 0.5 * (exact[0, 1] + exact[1, 0])]
        assert np.abs(stress - symmetric).max() < 1e-8 * np.abs(exact).max()
        assert new_dt == 1.0
        before = Fs[0], Fs[1]
    # DDSDDE is the slope of J σ along symmetric D, over J
    F0, F1, h = before[0], before[0] @ np.diag([1.002, 0.997]), 1e-6
    _, slope, _ = umat(F0, F1)
    for k, D in enumerate(
        ([[1.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]], [[0, 0.5], [0.5, 0]])
    ):
        moved = [(np.eye(2) + sign * h * np.array(D)) @ F1 for sign in (1.0, -1.0)]
        rise = [np.linalg.det(F) * umat(F0, F)[0] for F in moved]
        by_differences = (rise[0] - rise[1]) / (2.0 * h * np.linalg.det(F1))
        assert np.abs(slope[:, k] - by_differences).max() < 1e-6 * np.abs(slope).max()
    assert umat(F0, 3.0 * F1)[2] == 0.5


def test_two_surrogates_in_one_program(tmp_path):
    law, other = make_law(), make_law("none")
    for name, each in (("first", law), ("second", other)):
        (tmp_path / f"{name}.c").write_text(c_source(each, name), encoding="utf-8")
        (tmp_path / f"{name}.h").write_text(c_header(each, name), encoding="utf-8")
    (tmp_path / "main.cpp").write_text(
        '#include <math.h>\n#include "first.h"\n#include "second.h"\n'
        'extern "C" void ask(const double *F, const double *A, double *out, double *bound,\n'
        "                    int *status) {\n"
        "  first_stress_of(3, F, A, HUGE_VAL, out, bound, 0, 0, status);\n"
        "  second_stress_of(3, F, A, HUGE_VAL, out + 12, bound, 0, 0, status);\n}\n",
        encoding="utf-8",
    )
    for command in (
        ["-std=c99", "-fPIC", "-c", "first.c", "second.c"],
        ["-fPIC", "-x", "c++", "-c", "main.cpp"],
        ["-shared", "-o", "both.so", "main.o", "first.o", "second.o", "-lm"],
    ):
        subprocess.run([COMPILER, *command], check=True, cwd=tmp_path)
    F, F_dot = (each[:3].copy() for each in states(law, beyond=0.3))
    out, bound, status = np.empty((2, 3, 2, 2)), np.empty(3), np.empty(3, dtype=np.int32)
    at = [ctypes.c_void_p(each.ctypes.data) for each in (F, F_dot, out, bound, status)]
    ctypes.CDLL(str(tmp_path / "both.so")).ask(*at)
    for found, each in zip(out, (law, other), strict=True):
        expected = each.respond(F, F_dot).stress
        assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("name", ["", "two words", "1st", "a(b)", "x" * 50, "a;b", "ä"])
def test_a_name_that_is_none_of_c(name):
    with pytest.raises(InputError, match="name: "):
        c_source(make_law(), name)
