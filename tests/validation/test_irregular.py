"""Moduli of irregular tissue: the isotropic part of a matrix, and what seeds scatter."""

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import NamedCell
from validation.case import Setting
from validation.irregular import irregular, measure, nearest_isotropic, scatter


def isotropic(K, G):
    return np.array([[K + G, K - G, 0.0], [K - G, K + G, 0.0], [0.0, 0.0, G]])


def turned(C, angle):
    """The matrix in axes that are turned: by the fourth-order tensor, as a twin."""
    index = {(0, 0): 0, (1, 1): 1, (0, 1): 2, (1, 0): 2}
    full = np.zeros((2, 2, 2, 2))
    for i, j, k, m in np.ndindex(full.shape):
        full[i, j, k, m] = C[index[i, j], index[k, m]]
    Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    full = np.einsum("ia,jb,kc,md,abcd->ijkm", Q, Q, Q, Q, full)
    pairs = [(0, 0), (1, 1), (0, 1)]
    return np.array([[full[(*a, *b)] for b in pairs] for a in pairs])


def test_isotropic_moduli_come_back_and_have_no_anisotropy():
    found = nearest_isotropic(isotropic(300.0, 70.0))
    assert found.bulk == pytest.approx(300.0, rel=1e-14)
    assert found.shear == pytest.approx(70.0, rel=1e-14)
    assert found.anisotropy < 1e-14


def test_bulk_shear_and_anisotropy_do_not_depend_on_the_axes():
    rng = np.random.default_rng(1)
    part = rng.uniform(-30.0, 30.0, (3, 3))
    C = isotropic(300.0, 70.0) + part + part.T
    of_C = nearest_isotropic(C)
    of_turned = nearest_isotropic(turned(C, 0.7))
    assert of_C.anisotropy > 0.02
    for name in ("bulk", "shear", "anisotropy"):
        assert getattr(of_turned, name) == pytest.approx(getattr(of_C, name), rel=1e-12)


def test_a_square_is_stiffer_at_45_degrees_and_so_anisotropic():
    """K of one square plant cell is that of its moduli; G lies between both shear moduli."""
    cell = CellParameters.preset("printed", fluid="uniform")
    row = measure(cell, (1,))
    assert row.bulk[0] == pytest.approx(304.0, rel=2e-3)
    assert row.anisotropy[0] > 0.15
    assert scatter(row.bulk) is None


def test_seeds_scatter_and_the_study_is_made(capsys):
    assert scatter(np.array([1.0, 3.0])) == pytest.approx(100.0 * np.sqrt(2.0) / 2.0)
    setting = Setting(of=NamedCell.of("printed"), out=None, sizes=(4,), quick=True)
    study = irregular(setting)
    rows = study.table.to_records()
    assert [len(panel.curves) for panel in study.panels] == [3, 3, 3]
    assert [row["plant_cells"] for row in rows][:1] == ["4 voronoi"]
    assert "seed 2" in capsys.readouterr().out
