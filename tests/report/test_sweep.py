"""The table of a sweep over tolerances."""

from surrofe2.report.sweep import QUANTITIES, SweepRow
from surrofe2.report.tables import Table


def test_shares_are_shown_in_percent_and_what_is_missing_by_a_dash():
    rows = (
        SweepRow(0.01, 0.0021, 0.987, 40, 1, 0.004, 0.02, 6.54, 1.012, 1.5, off=False),
        SweepRow(0.001, 0.0002, 0.0, 0, 0, None, None, 0.98, 1.0, 1.0, off=True),
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
