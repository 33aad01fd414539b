"""What the fuzz tests share: how many examples, what an answer may be, damage to text and bytes."""

import time
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from surrofe2.base.errors import Surrofe2Error

LONGEST, SLOWEST = 300, 20.0
"""Characters of a sentence; seconds of an answer."""
EXTREME = (
    "0", "-0.0", "1", "-1", "2", "1e-320", "1e308", "1e-30", "-1e30", "inf", "-inf", "nan", "true",
    '""', '"é\\n\\u0000"', "[]", "{}", "[[]]", "[nan, 1]", "[1e308, -1e308]", "[1, 2, 3, 4]",
    "1979-05-27", "07:32:00", "9223372036854775808", "10000000", "0.5", '"free"', '"/dev/zero"',
    '".."', '"left"', "1" + "0" * 400, "0x" + "f" * 5000, "9" * 5000, '"' + "x" * 5000 + '"',
    "[" * 2000 + "]" * 2000, "{a=" * 300 + "1" + "}" * 300, "[0, " * 90 + "1" + "]" * 90,
    "[" + "1, " * 2000 + "1]",
)  # fmt: skip
"""Values that a recipe may hold and no author wants."""


def examples(number):
    """A few examples of a test, always the same; the whole `number` in the slow one."""
    return settings(
        max_examples=number,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def few_and_all(few, all_of_them):
    """Parameters `number`: a few examples in the quick tests, all in the nightly ones."""
    every = pytest.param(all_of_them, marks=pytest.mark.nightly)
    return pytest.mark.parametrize("number", [few, every])


@contextmanager
def answered(*names):
    """The block answers within `SLOWEST`, rightly or by a short sentence with one of the names."""
    began = time.perf_counter()
    try:
        yield
    except Surrofe2Error as error:
        told = str(error)
        assert len(told) <= LONGEST, told
        assert any(name in told for name in names), told
    assert time.perf_counter() - began < SLOWEST


@st.composite
def damaged_lines(draw, texts, values=EXTREME):
    """A text of `texts` with a few lines cut, doubled, swapped or with other values."""
    lines = draw(st.sampled_from(texts)).splitlines()
    for _ in range(draw(st.integers(1, 4))):
        at, other = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        line = lines[at]
        key, equals, _ = line.partition("=")
        match draw(st.sampled_from(["value"] * 6 + ["cut", "double", "swap", "flip", "key"])):
            case "value" if equals:
                lines[at] = f"{key}= {draw(st.sampled_from(values))}"
            case "cut":
                del lines[at]
            case "double":
                lines.insert(other, line)
            case "swap":
                lines[at], lines[other] = lines[other], line
            case "flip" if line:
                place = draw(st.integers(0, len(line) - 1))
                new = draw(st.characters(exclude_categories=["Cs"]))
                lines[at] = line[:place] + new + line[place + 1 :]
            case "key" if equals:
                lines[at] = f"{draw(st.sampled_from(KEYS))} ={line.partition('=')[2]}"
        if not lines:
            lines = [""]
    return "\n".join(lines) + "\n"


KEYS = ("a.b", '""', '"' + "k" * 400 + '"', '"\\u0000\\n"', "file", "kind", "name", "on", "box")


class Content(bytes):
    """Bytes of a file that a report does not show."""

    def __repr__(self):
        return f"<{len(self)} bytes>"


@st.composite
def damaged_bytes(draw, whole):
    """The bytes of a file truncated, flipped, overwritten, doubled or with others in between."""
    content = bytearray(whole)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(content) - 1, 0)))
        length = draw(st.integers(1, 64))
        match draw(st.sampled_from(["flip", "cut", "drop", "write", "insert", "double"])):
            case "flip" if content:
                content[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del content[at:]
            case "drop":
                del content[at : at + length]
            case "write":
                content[at : at + length] = draw(st.binary(min_size=length, max_size=length))
            case "insert":
                content[at:at] = draw(st.binary(min_size=1, max_size=64))
            case "double":
                content[at:at] = content[at : at + length]
    return bytes(content)
