"""`surrofe2 export`."""

import pytest

from surrofe2.store.surrogates import write_surrogate
from tests.surrogate.twins import make_law


@pytest.fixture
def surrogate(tmp_path):
    write_surrogate(make_law(), tmp_path / "law-surrogate.h5")
    return tmp_path / "law-surrogate.h5"


def test_the_source_lies_beside_the_surrogate(surrogate, invoke):
    done = invoke("export", surrogate, "--to", "c")
    source = surrogate.with_suffix(".c")
    lines = source.read_text(encoding="utf-8").count("\n")
    assert f"{source}: {lines} lines of C, " in done.output


def test_what_is_there_stays(surrogate, invoke):
    source = surrogate.with_suffix(".c")
    source.write_text("mine", encoding="utf-8")
    done = invoke("export", surrogate, code=1)
    assert "another source is there; --fresh" in done.output
    assert source.read_text(encoding="utf-8") == "mine"
    invoke("export", surrogate, "--fresh")
    invoke("export", surrogate)  # the same, so nothing is lost
    assert source.read_text(encoding="utf-8").startswith("/*")
