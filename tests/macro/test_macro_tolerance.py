"""A motion that is small against the absolute tolerance: the run says so, and what to set."""

import re
from dataclasses import replace

import numpy as np

from surrofe2.macro import MacroSettings, simulate
from tests.laws import SquareLaw
from tests.macro.bars import LOAD_CASE, SETTINGS, with_load

LONG = replace(LOAD_CASE, duration=60.0, output_interval=1.0)
IMPLICIT = replace(SETTINGS, integrator="implicit")
"""Whose steps no stability limits."""


def error_of(settings, share):
    """(largest error of the curve over its amplitude, run), the load times a share."""
    problem = with_load(LONG, acceleration=(0.0, -0.1 * share))
    run = simulate(problem, SquareLaw(), settings)
    amplitude = run.largest_displacement
    fine = replace(SETTINGS, absolute_tolerance=1e-8 * amplitude, relative_tolerance=1e-7)
    exact = simulate(problem, SquareLaw(), fine).curve.displacement
    return abs(run.curve.displacement - exact).max() / abs(exact).max(), run


def test_a_load_of_a_millionth_is_remarked_and_right_by_the_advice():
    usual, run = error_of(IMPLICIT, 1.0)
    assert usual < 5.0 * IMPLICIT.relative_tolerance
    assert "remark" not in run.facts()
    wrong, run = error_of(IMPLICIT, 1e-6)
    assert wrong > 100.0 * IMPLICIT.relative_tolerance
    remark = run.facts()["remark"]
    assert remark == IMPLICIT.remark(run.largest_displacement)
    advised = float(re.search(r"set it to (\S+)$", remark)[1])
    right, _ = error_of(replace(IMPLICIT, absolute_tolerance=advised), 1e-6)
    assert right < 5.0 * IMPLICIT.relative_tolerance


def test_the_remark_begins_where_the_relative_tolerance_allows_less():
    settings = MacroSettings(absolute_tolerance=1e-5, relative_tolerance=1e-3)
    assert settings.remark(0.0) is None
    assert settings.remark(np.nextafter(0.01, 1.0)) is None
    assert settings.remark(0.0099) == (
        "macro.absolute_tolerance: 1e-05 µm is not small against the largest displacement, "
        "0.0099 µm, so the relative tolerance of 0.001 does not hold; set it to 1e-07"
    )


def test_what_is_not_remarked_is_right():
    error, run = error_of(IMPLICIT, 1e-2)
    assert IMPLICIT.remark(run.largest_displacement) is None
    assert error < 5.0 * IMPLICIT.relative_tolerance
