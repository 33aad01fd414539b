"""What a person sees of results in a notebook, and hands on to other libraries."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.dom import minidom

import matplotlib as mpl
import numpy as np
import pytest

from surrofe2 import (
    CachedLaw,
    LoadCase,
    MacroSettings,
    RveLaw,
    StressResponse,
    TrainingSettings,
    read_run,
)
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.macro.simulation import simulate
from surrofe2.surrogate.training import train
from surrofe2.workflow.run import save_run
from tests.laws import CELL, SoftLaw, lattice_samples


@pytest.fixture(scope="module")
def surrogate():
    settings = TrainingSettings(hidden=(4,), baseline_degree=1, iterations=9)
    return train(lattice_samples(100), settings)


@pytest.fixture(scope="module")
def run():
    load = LoadCase(width=100.0, height=100.0, watched=(100.0, 50.0), elements=(2, 2), duration=4.0)
    return simulate(load, SoftLaw(), MacroSettings())


@pytest.fixture
def stored(run, tmp_path):
    save_run(run, tmp_path / "saved")
    return read_run(tmp_path / "saved")


def test_what_is_not_of_its_rve_is_not_scored(surrogate):
    samples = lattice_samples(20)
    with pytest.raises(MismatchError, match=r"samples\.initialisation: other, the surrogate's is"):
        surrogate.score(replace(samples, initialisation="other"))
    none = replace(samples, status=np.ones(20, np.int8))
    with pytest.raises(InputError, match="samples: none of 20 has a stress"):
        surrogate.score(none)


@pytest.mark.parametrize("kind", ["run", "stored"])
def test_a_run_is_plotted(request, kind):
    shown = request.getfixturevalue(kind)
    before = mpl.get_backend()
    mpl.use("agg")
    try:
        axes = shown.plot()
    finally:
        mpl.use(before)
    labels = [place.get_ylabel() for place in axes]
    assert labels == ["displacement (µm)", "force (µN)", "energy (pJ)"]
    (line,) = [each for each in axes[0].lines if each.get_label().startswith("u_y")]
    np.testing.assert_array_equal(line.get_ydata(), shown.curve.displacement[:, 1])
    mpl.pyplot.close(axes[0].figure)


class Library(SimpleNamespace):
    """Stands in for one that takes arrays: keeps what each kind is given."""

    def __init__(self, *kinds):
        for kind in kinds:
            setattr(self, kind, lambda *a, **k: SimpleNamespace(a=a, k=k, attrs={}))


def test_a_run_for_pandas(run, stored, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", Library("DataFrame", "Index"))
    for shown in (run, stored):
        frame = shown.to_pandas()
        (columns,) = frame.a
        (name,) = [each for each in columns if each.startswith("u_y")]
        np.testing.assert_array_equal(columns[name], run.curve.displacement[:, 1])
        np.testing.assert_array_equal(columns["energy kinetic"], run.energies["kinetic"])
        np.testing.assert_array_equal(frame.k["index"].a[0], run.curve.t)
        units = frame.attrs["units"]
        assert (units[name], units["energy kinetic"], units["t_us"]) == ("µm", "pJ", "µs")


def test_a_run_for_xarray(run, stored, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", Library("Dataset"))
    of_run, of_frames, _ = run.to_xarray().a
    for shown in (run, stored):
        variables, coordinates, _ = shown.to_xarray().a
        sizes = {}
        for names, values, *_ in (*variables.values(), *coordinates.values()):
            names = (names,) if isinstance(names, str) else names
            for name, size in zip(names, values.shape, strict=True):
                assert sizes.setdefault(name, size) == size, name
        assert (sizes["node"], sizes["element"], sizes["t"]) == (9, 4, run.curve.t.size)
        if shown is stored:
            assert variables["field von_mises_in_plane"][2] == {"units": "µN/µm"}
        for name in ("displacement", "velocity", "stress", "F", "F_dot"):
            axes, values, units = variables[f"field {name}"]
            of_axes, of_values, of_units = of_run[f"field {name}"]
            assert (axes, units) == (of_axes, of_units)
            np.testing.assert_array_equal(values, of_values)
        np.testing.assert_array_equal(coordinates["frame"][1], of_frames["frame"][1])


def test_a_stored_run_for_pyvista(run, stored):
    pytest.importorskip("pyvista")
    grid = stored.to_pyvista()
    assert (grid.n_points, grid.n_cells, grid.field_data["t"][0]) == (9, 4, run.frames.t[-1])
    assert grid.compute_cell_sizes()["Area"].sum() == pytest.approx(1e4)
    moved = grid.warp_by_vector("displacement_um")
    np.testing.assert_allclose(
        moved.points[:, :2], run.nodes + run.frames.displacement[-1], rtol=1e-6
    )
    stress = grid.cell_data["cauchy_stress_uN_per_um"].reshape(-1, 3, 3)
    np.testing.assert_array_equal(stress[:, :2, :2], run.frames.stress[-1])
    assert not stored.to_pyvista(0).point_data["displacement_um"].any()
    with pytest.raises(InputError, match=r"frame: 999; there are \d+ of them"):
        stored.to_pyvista(999)
    with pytest.raises(InputError, match=r"frame: 0\.5; it must be a whole number"):
        stored.to_pyvista(0.5)


def test_a_rest_is_over_the_factor_of_its_load(stored, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", Library("DataFrame", "Index"))
    monkeypatch.setitem(sys.modules, "xarray", Library("Dataset"))
    record = replace(stored.record, recipe={**stored.record.recipe, "rest": {"factor": 1.0}})
    rest = replace(stored, record=record)
    frame = rest.to_pandas()
    assert frame.k["index"].k == {"name": "factor"}
    assert frame.attrs["units"]["factor"] == "1"
    variables, coordinates, source = rest.to_xarray().a
    columns = [values for name, values in variables.items() if name in rest.series()]
    assert {values[0] for values in columns} == {"factor"}
    assert {*coordinates} == {"factor", "frame", "position"}
    assert coordinates["factor"][2] == {"units": "1"}
    assert "µs" not in source["source"]


@pytest.mark.parametrize("library", ["pandas", "xarray", "pyvista"])
def test_what_is_not_installed_is_told(stored, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=f"to_{library}: {library} is not installed; install it"):
        getattr(stored, f"to_{library}")()


def test_the_libraries_take_what_they_are_given(stored):
    pandas = pytest.importorskip("pandas")
    xarray = pytest.importorskip("xarray")
    frame = stored.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    data = stored.to_xarray()
    assert isinstance(data, xarray.Dataset)
    assert data["field stress"].isel(frame=-1).sizes == {"element": 4, "row": 2, "column": 2}


def test_html_is_whole_and_a_line_says_what_matters(run, stored, surrogate):
    law, samples = RveLaw(CELL), lattice_samples(100)
    error = f"{100 * surrogate.errors['rms']['xy']:.2g} % RMS"
    expected = [
        (run, "<MacroRun: 4 elements, ", ["SoftLaw", "4 elements, 9 nodes", "<img alt="]),
        (stored, "<StoredRun: folder ", ["saved", "SoftLaw", "<img alt="]),
        (samples, "<StressSamples: samples 100, usable 100, ", ["100</td>", "bifurcation"]),
        (surrogate, "<SurrogateLaw: plant cell ", ["error of xy", error]),
        (law, "<RveLaw: plant cell ", ["constrained-runs", f"{law.rest_length:.4g} µm"]),
        (CachedLaw(surrogate, law), "<CachedLaw: surrogate <SurrogateLaw: plant cell ",
         ["0.001 of the spread of stress", "by the fallback"]),
    ]  # fmt: skip
    for shown, line, words in expected:
        text = shown._repr_html_()
        minidom.parseString(text)  # each tag that opens is closed
        for word in words:
            assert word in text, (word, text)
        assert not re.search(r"https?:|<script", text)
        assert repr(shown).startswith(line)
        assert "\n" not in repr(shown)
    curve, answer = run.curve, StressResponse(np.full((2, 2, 2), np.nan), np.int8([0, 1]))
    assert repr(curve).startswith("<DisplacementCurve: ")
    assert repr(answer) == "<StressResponse: 2 points, 1 without stress>"


NOTEBOOK = """
from surrofe2 import Fixed, Problem, Traction, find_rest, rectangle, simulate
from tests.laws import KelvinVoigt

pull = Traction(on="right", traction=(0.1, 0.0))
mesh = rectangle(20.0, 10.0, (2, 1))
problem = Problem(mesh=mesh, conditions=(Fixed(on="left"), pull), duration=1.0)
rest = find_rest(problem, KelvinVoigt(), progress=True)
run = simulate(problem, KelvinVoigt(), progress=True)
run
"""


@pytest.mark.slow
def test_a_notebook_shows_progress_and_the_run():
    """By a kernel of Jupyter, which has no terminal."""
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(NOTEBOOK)])
    where = {"metadata": {"path": Path(__file__).parents[2]}}
    nbclient.NotebookClient(book, timeout=120, kernel_name="python3", resources=where).execute()
    (cell,) = book.cells
    shown = "".join(each.text for each in cell.outputs if each.output_type == "stream")
    assert shown.count("100.0 % of 1 in") == 2
    (result,) = [each for each in cell.outputs if each.output_type == "execute_result"]
    assert result.data["text/html"].startswith("<div><strong>MacroRun</strong>")
