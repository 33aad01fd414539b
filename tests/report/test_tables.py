"""One list of quantities gives every rendering of a table."""

import pytest

from surrofe2.report.tables import Quantity, Table, percent

QUANTITIES = (
    Quantity("run", "", "", lambda row: row[0]),
    Quantity("first minimum", "µm", ".2f", lambda row: row[1]),
    Quantity("period off", "%", "+.1f", lambda row: row[2]),
    Quantity("hits", "", percent(3), lambda row: row[3]),
    Quantity("seed", "", None, lambda row: 7),
)
TABLE = Table(QUANTITIES, (("a, b", -1.234, None, 0.5), ("c", float("nan"), None, 0.1234)))


def test_people_are_shown_formatted_columns_that_have_a_value():
    headings, texts = TABLE.for_people()
    assert headings == ["run", "first minimum (µm)", "hits"]
    assert texts == [["a, b", "-1.23", "50 %"], ["c", "–", "12.3 %"]]


def test_csv_holds_every_quantity_and_leaves_missing_ones_empty():
    assert TABLE.to_csv().splitlines() == [
        "run,first minimum (µm),period off (%),hits,seed",
        '"a, b",-1.234,,0.5,7',
        "c,,,0.1234,7",
    ]


def test_json_has_values_by_name_and_their_units():
    assert TABLE.to_records()[0] == {
        "run": "a, b", "first_minimum": -1.234, "period_off": None, "hits": 0.5, "seed": 7
    }  # fmt: skip
    assert TABLE.units == {"first_minimum": "µm", "period_off": "%"}


@pytest.mark.parametrize(
    ("share", "text"), [(0.1, "10 %"), (0.00123, "0.123 %"), (4e-7, "0.00004 %"), (1e-15, "0 %")]
)
def test_shares_are_written_in_percent(share, text):
    assert percent(3)(share) == text
