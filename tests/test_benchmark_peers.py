"""What other codes are given, and what the table says where they are not there."""

import sys

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.report import Outcome, make_report, to_markdown
from benchmarks.setting import Setting, rve
from surrofe2.tissue import make_tissue


@pytest.fixture(scope="module")
def tissue():
    law = rve(peers.PRESET)
    return make_tissue(law.cell, law.reference, (3, 2))


def test_the_tissue_as_others_read_it(tissue):
    """3 × 2 plant cells share 9 + 8 walls of ten springs each, and each has 16 fluid particles."""
    told = peers.describe(tissue)
    x, bonds = np.array(told["x"]), np.array(told["bonds"])
    assert bonds.shape == (170, 2)
    np.testing.assert_allclose(np.linalg.norm(x[bonds[:, 1]] - x[bonds[:, 0]], axis=1), 2.5, 0.1)
    assert np.bincount(told["plant_cell"]).tolist() == [tissue.wall_particles, *[16] * 6]
    for number in range(1, 7):
        inside = x[np.array(told["plant_cell"]) == number]
        middle = 25.0 * np.array([(number - 1) % 3 + 0.5, (number - 1) // 3 + 0.5])
        assert abs(inside - middle).max() < 12.5


def test_only_what_a_python_can_import_is_installed(tmp_path):
    assert peers.is_installed(sys.executable, "numpy")
    assert not peers.is_installed(sys.executable, "no_such_code")
    assert not peers.is_installed(str(tmp_path / "no" / "python"), "numpy")


def test_absent_codes_are_rows_that_say_so(tmp_path, monkeypatch, tissue):
    monkeypatch.delenv(peers.VARIABLE, raising=False)
    monkeypatch.setattr(peers, "_ours", lambda setting, tissue: 30.0)
    setting = Setting(quick=True, out=tmp_path)
    rows = peers.run(setting)
    assert [row.value for row in rows] == [30.0, None, None]
    outcome = Outcome("peers", peers.TITLE, rows)
    page = to_markdown(make_report([outcome], quick=True, load=0.0), [outcome])
    for peer in peers.PEERS:
        assert f"a second and core: {peer} | not installed |" in page


def test_a_code_that_fails_is_named_with_its_last_words(tmp_path, monkeypatch):
    (tmp_path / "with_code.py").write_text("raise SystemExit('no licence')")
    monkeypatch.setattr(peers, "SCRIPTS", tmp_path)
    with pytest.raises(RuntimeError, match="code failed: no licence"):
        peers._ask(sys.executable, "code", {}, 1)
