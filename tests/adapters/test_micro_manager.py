"""The real Micro Manager of preCICE asks RVEs and surrogate at points, from one rank and from two.

The preCICE library itself, for which there is no wheel, is a stand-in in `stand_in/`.
"""

import importlib.util
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from surrofe2 import CalibrationSettings, calibrate, sample_stress, train, write_surrogate
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.workflow.laws import true_law

if importlib.util.find_spec("micro_manager") is None:
    pytest.skip("the Micro Manager is not installed; see the Makefile", allow_module_level=True)
ROOT = Path(__file__).parents[2]
STAND_IN = Path(__file__).with_name("stand_in")
RECIPE = """
[cell]
preset = "printed"
[range]
stretch = [0.94, 1.06]
shear = 0.03
rate = 0.01
[training]
file = "trained-surrogate.h5"
iterations = 30
[cache]
tolerance = 3e-3
"""
MODULE = "surrofe2.adapters.micro_manager"
IN = ["F-1", "F-2", "F-dot-1", "F-dot-2"]
OUT = ["Stress-1", "Stress-2", "P-12-by-F-1", "P-12-by-F-dot-1"]
WINDOWS, ITERATIONS, POINTS = 6, 2, 6


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """With a surrogate of few samples and a bound from few paths."""
    path = tmp_path_factory.mktemp("study") / "recipe.toml"
    path.write_text(RECIPE, encoding="utf-8")
    found = load_recipe(path)
    law = true_law(found.study())
    samples = sample_stress(law, found.study().cell.range, 400)
    paths = CalibrationSettings(walks=50, runs=0, alpha=0.1, length=6)
    surrogate = calibrate(train(samples, found.study().cell.training), samples, law, paths)
    write_surrogate(surrogate, found.study().training_path())
    return found


@pytest.fixture(scope="module")
def law(recipe):
    return true_law(recipe.study())


@pytest.fixture
def adapter(monkeypatch, recipe):
    monkeypatch.syspath_prepend(STAND_IN)
    monkeypatch.setenv("SURROFE2_RECIPE", str(recipe.path))
    return importlib.import_module(MODULE)


def history():
    """(windows, iterations, points, 2, 2) F and Ḟ: the last points leave the data and come back."""
    t = np.arange(1.0, WINDOWS + 1.0)
    way = np.sin(np.pi * t / (WINDOWS + 1.0))
    F = np.tile(np.eye(2), (WINDOWS, ITERATIONS, POINTS, 1, 1))
    reach = np.linspace(0.02, 0.12, POINTS)
    F[..., 0, 0] += way[:, None, None] * reach * np.array([0.9, 1.0])[:, None]
    F[..., 0, 1] += 0.3 * way[:, None, None] * reach
    F_dot = np.zeros_like(F)
    F_dot[..., 0, 0] = 0.005 * np.cos(np.pi * t / (WINDOWS + 1.0))[:, None, None]
    return F, F_dot


def truth(law, F, F_dot):
    """Stress and tangents of every iteration, as by a time loop that keeps the last of each."""
    found, state = [], None
    for window in range(WINDOWS):
        for iteration in range(ITERATIONS):
            at = F[window, iteration], F_dot[window, iteration]
            answer = law.respond(*at, state, tangents=True)
            found.append(answer)
        state = law.accept(*at, answer).state
    stress, P_by_F, P_by_F_dot = (
        np.stack(parts).reshape(WINDOWS, ITERATIONS, POINTS, *parts[0].shape[1:])
        for parts in zip(
            *((a.stress, a.tangents.P_by_F, a.tangents.P_by_F_dot) for a in found), strict=True
        )
    )
    return {
        "Stress-1": stress[..., 0, :],
        "Stress-2": stress[..., 1, :],
        "P-12-by-F-1": P_by_F[..., 0, 1, 0, :],
        "P-12-by-F-dot-1": P_by_F_dot[..., 0, 1, 0, :],
    }


def rows(F, F_dot):
    return dict(zip(IN, (F[..., 0, :], F[..., 1, :], F_dot[..., 0, :], F_dot[..., 1, :]),
                    strict=True))  # fmt: skip


def run_manager(recipe, folder, ranks, settings, *options):
    (folder / "config.json").write_text(json.dumps(settings), encoding="utf-8")
    command = [sys.executable, "-m", "micro_manager", *options, "config.json", "log"]
    if ranks > 1:
        command = [str(Path(sys.executable).with_name("mpiexec")), "-n", str(ranks), *command]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(STAND_IN), str(ROOT)]),
        "SURROFE2_RECIPE": str(recipe.path),
        "NUMBA_NUM_THREADS": "1",
    }
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    log = (folder / "log").read_text(encoding="utf-8") if (folder / "log").exists() else ""
    assert done.returncode == 0, done.stdout + done.stderr + log


def coupled(ranks, models, stateless, **parameters):
    return {
        "participant_name": "Micro-Manager",
        "precice_config_file_path": "precice-config.xml",
        "interfaces": [
            {
                "mesh_name": "Macro-Mesh",
                "read_data": [{"name": name} for name in IN],
                "write_data": [{"name": name} for name in OUT],
            }
        ],
        "micro_manager": {
            "micro_file_names": models,
            "micro_stateless_flags": stateless,
            "simulation_params": {
                "micro_dt": 1.0,
                "macro_domain_bounds": [0.0, float(POINTS), 0.0, 1.0],
                "decomposition": [ranks, 1],
                **parameters,
            },
        },
    }


def write_macro(folder):
    F, F_dot = history()
    vertices = np.column_stack([np.arange(POINTS) + 0.5, np.full(POINTS, 0.5)])
    np.savez(folder / "macro.npz", vertices=vertices, **rows(F, F_dot))
    return F, F_dot


def read_written(folder, ranks):
    parts = [np.load(folder / f"written-{rank}.npz") for rank in range(ranks)]
    return {name: np.nansum([part[name] for part in parts], axis=0) for name in parts[0]}


@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_coupled_loop_has_the_stress_of_rves_and_where_it_may_the_surrogate_s(
    ranks, recipe, law, adapter, tmp_path
):
    F, F_dot = write_macro(tmp_path)
    function = {"switching_function": MODULE}
    switching = {"model_switching": True, "model_switching_settings": function}
    settings = coupled(ranks, [f"{MODULE}_surrogate", MODULE], [True, False], **switching)
    run_manager(recipe, tmp_path, ranks, settings)
    found, exact = read_written(tmp_path, ranks), truth(law, F, F_dot)
    surrogate = adapter.the_bound()
    flat = F.reshape(-1, 2, 2), F_dot.reshape(-1, 2, 2)
    trusted = surrogate.status_and_risk(*flat, 1.0)[0].reshape(F.shape[:3]) == 0
    resolution = found.pop("Model-Resolution")
    # within a window a point may leave the surrogate but not come back
    assert (resolution == np.maximum.accumulate(~trusted, axis=1)).all()
    assert 0.2 < resolution.mean() < 0.8
    assert (np.diff(resolution[:, -1], axis=0) < 0).any()
    by_rve = resolution == 1
    for name, values in found.items():
        scale = np.abs(exact[name]).max()
        assert np.abs(values - exact[name])[by_rve].max() < 1e-6 * scale
    learnt = surrogate.extrapolate(*flat).reshape(F.shape)
    for row, name in enumerate(OUT[:2]):
        assert np.abs(found[name] - exact[name])[~by_rve].max() < surrogate.tolerance[-1]
        assert np.abs(found[name] - learnt[..., row, :])[~by_rve].max() < 1e-9


@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_snapshots_have_the_stress_of_rves(ranks, recipe, law, tmp_path):
    """The Micro Manager stores them in single precision."""
    F, F_dot = (tensors[-1, -1] for tensors in history())
    with h5py.File(tmp_path / "parameters.hdf5", "w") as file:
        for name, values in rows(F, F_dot).items():
            file[name] = values
    settings = {
        "micro_manager": {
            "micro_file_names": [MODULE],
            "coupling_params": {
                "parameter_file_name": "parameters.hdf5",
                "read_data_names": IN,
                "write_data_names": OUT,
            },
            "simulation_params": {"micro_dt": 1.0},
            "snapshot_params": {"output_file_name": "snapshots"},
        }
    }
    run_manager(recipe, tmp_path, ranks, settings, "--snapshot")
    exact = law.respond(F, F_dot, tangents=True)
    with h5py.File(tmp_path / "snapshots.hdf5") as file:
        assert file.attrs["status"] == "finished"
        for row in (0, 1):
            np.testing.assert_allclose(file[f"Stress-{row + 1}"], exact.stress[:, row], rtol=1e-6)
        np.testing.assert_allclose(
            file["P-12-by-F-1"], exact.tangents.P_by_F[:, 0, 1, 0], rtol=1e-5, atol=1e-4
        )


def entries(F, F_dot):
    return rows(np.array(F), np.array(F_dot))


def test_a_point_that_moves_to_another_rank_keeps_its_state(adapter):
    """Its RVE by what is sent, and that it may not come back to the surrogate in this window; of
    points that are gone nothing is kept."""
    inside = entries([[1.01, 0.0], [0.0, 1.0]], np.zeros((2, 2)))
    outside = entries([[1.2, 0.0], [0.0, 1.0]], np.zeros((2, 2)))
    here, there, at = adapter.Switching(), adapter.Switching(), np.array([1.5, 0.5])
    assert here(0, at, 3.0, outside, None) == 1
    assert here(1, at, 3.0, inside, None) == 0
    one, other = adapter.MicroSimulation(3), adapter.MicroSimulation(3)
    one.solve(inside, 1.0)
    other.set_state(pickle.loads(pickle.dumps(one.get_state())))
    for name, values in one.solve(inside, 1.0).items():
        assert (values == other.solve(inside, 1.0)[name]).all()
    assert there(1, at, 3.0, inside, None) == 0
    assert there(1, at, 4.0, inside, None) == -1
    assert here(1, at, 4.0, inside, None) == -1
    for window in range(5, 40):
        for k in range(10):
            here(0, np.array([window, k]), float(window), inside, None)
    assert len(here.switched) == 10


def test_the_manager_may_initialise_and_write_out(adapter, monkeypatch, tmp_path):
    one, still = adapter.MicroSimulation(3), entries(np.eye(2), np.zeros((2, 2)))
    assert one.requires_initialize()
    assert one.requires_output()
    for name, values in one.initialize().items():
        assert (values == one.solve(still, 1.0)[name]).all()
    one.output()
    assert not [*tmp_path.iterdir()]
    monkeypatch.setenv("SURROFE2_POINTS", str(tmp_path / "points"))
    for k in range(2):
        answer = one.solve(entries([[1.0 + 0.01 * k, 0.0], [0.0, 1.0]], np.zeros((2, 2))), 1.0)
        one.output()
    table = np.genfromtxt(tmp_path / "points" / "point-3.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["F_11"], [1.0, 1.01])
    assert table["stress_11"][1] == answer["Stress-1"][0]


def test_what_is_wrong_is_named(adapter, monkeypatch):
    simulation = adapter.MicroSimulation(0)
    good = entries(np.eye(2), np.zeros((2, 2)))
    with pytest.raises(InputError, match="F-dot-2 is missing among F-1, F-2, F-dot-1"):
        simulation.solve({name: good[name] for name in IN[:3]}, 1.0)
    with pytest.raises(InputError, match=r"F-1: \[1.0, 0.0, 0.0\]; it must be a finite vector"):
        simulation.solve(good | {"F-1": np.array([1.0, 0.0, 0.0])}, 1.0)
    learnt = importlib.import_module(f"{MODULE}_surrogate").MicroSimulation(0)
    with pytest.raises(SimulationError, match=r"range of the surrogate.*U₁₁ = 1\.2"):
        learnt.solve(good | {"F-1": np.array([1.2, 0.0])}, 1.0)
    iterated = RveLaw(adapter.the_rve().cell, solver="iterated")
    adapter.the_rve.cache_clear()
    monkeypatch.setattr(adapter, "true_law", lambda recipe: iterated)
    with pytest.raises(InputError, match="micro_manager: RveLaw has no tangents"):
        adapter.MicroSimulation(0)
    adapter.the_rve.cache_clear()
