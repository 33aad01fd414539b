"""The table of a sweep over tolerances."""

from surrofe2.displacement_curve import CurveDifference
from surrofe2.report.comparison import ComparedRun
from surrofe2.report.sweep import QUANTITIES
from surrofe2.report.tables import Table


def row(tolerance, error, hits, audit, ratios):
    counts = {"hits": hits, "fallbacks": 1000 - hits}
    cache = {
        "tolerance": {"share": tolerance, "spread": 10.0},
        "audit": audit,
        "trust": {"off": not hits, "factor": 1.5},
    }
    speed_up = dict(zip(("wall_time", "right_hand_sides"), ratios, strict=True))
    apart = CurveDifference(error, error, 0.0, 0.0)
    return ComparedRun("run", "cached", "water", apart, 1.0, counts, speed_up, cache)


def test_shares_are_shown_in_percent_and_what_is_missing_by_a_dash():
    found = {"audited": 40, "violations": 1, "quantiles": {"0.99": 0.04}, "largest": 0.2}
    nothing = {"audited": 0, "violations": 0, "quantiles": {}, "largest": 0.0}
    rows = (
        row(0.01, 0.0021, 987, found, (6.54, 1.0 / 1.012)),
        row(0.001, 0.0002, 0, nothing, (0.98, 1.0)),
    )
    headings, texts = Table(QUANTITIES, rows).for_people()
    assert headings == [
        "tolerance", "stress error", "above", "displacement error", "hits", "speed-up (×)",
        "right-hand sides", "switched off",
    ]  # fmt: skip
    assert texts == [
        ["1 %", "0.4 %", "1 of 40", "0.21 %", "98.7 %", "6.54", "101.2 %", "–"],
        ["0.1 %", "–", "0 of 0", "0.02 %", "0 %", "0.98", "100 %", "yes"],
    ]
