"""`python -m tests.all_laws FOLDER SETTING…`: figures of all laws where the caller has set things.

A setting is `numpy` (every error state raises), `warnings` (each is an error), `locale` (decimal
commas, of `LC_ALL` in the environment) or the start method of processes. What is printed is JSON
of figures by name, as hexadecimal numbers, so that bits can be compared.
"""

import json
import locale
import multiprocessing
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from surrofe2 import (
    CachedLaw,
    CacheSettings,
    CellParameters,
    LoadCase,
    MacroSettings,
    RegionalLaw,
    RveLaw,
    SamplingRange,
    SlabLaw,
    TrainingSettings,
    find_rest,
    follow_path,
    load_mesh,
    load_recipe,
    points_by_region,
    ramp_and_hold,
    read_data_set,
    read_run,
    read_surrogate,
    sample,
    sample_stress,
    save_run,
    simulate,
    tabulate_surface,
    train,
    with_regions,
    write_surrogate,
)
from surrofe2.cache import StressTable
from surrofe2.problem import Box
from surrofe2.store.fields import DISPLACEMENT_NAME, read_fields
from surrofe2.workflow.generate import generate_data_set
from tests.conftest import RECIPE
from tests.laws import KelvinVoigt

RANGE = SamplingRange(stretch=(0.97, 1.03), shear=0.03, rate=0.005)
WAYS = ("cauchy-born", "elastic", "constrained-runs", "slow-manifold")
BAR = {"width": 60.0, "height": 40.0, "watched": (60.0, 20.0), "elements": (2, 2), "duration": 1.0}
SETTINGS = MacroSettings(frames=3)
MESH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
1 1 "left"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 100.5 0 0
3 100.5 50.25 0
4 0 50.25 0
$EndNodes
$Elements
2
1 1 2 1 1 4 1
2 3 2 0 1 1 2 3 4
$EndElements
"""


def set_up(setting):
    if setting == "numpy":
        np.seterr(all="raise")
    elif setting == "warnings":
        warnings.simplefilter("error")
    elif setting == "locale":
        locale.setlocale(locale.LC_ALL, "")
        assert locale.localeconv()["decimal_point"] == ","
    else:
        multiprocessing.set_start_method(setting)


def of_response(answer):
    tangents = answer.tangents
    assert not answer.status.any()
    return answer.stress.sum() + (0.0 if tangents is None else tangents.P_by_F.sum())


def of_run(run):
    assert run.finished
    return run.curve.displacement.sum() + sum(each[-1] for each in run.energies.values())


def figures(folder, start_method=None):
    """Figures of every law, alone and in a run, and of files that are written and read."""
    cell = CellParameters.preset("printed")
    F, F_dot = sample(RANGE, 20, seed=1)
    laws = {way: RveLaw(cell, initialisation=way) for way in WAYS}
    found = {
        f"rve {way}": of_response(law.respond(F, F_dot, tangents=True)) for way, law in laws.items()
    }
    rve = laws["cauchy-born"]
    problem = LoadCase(**BAR)
    found["rve run"] = of_run(simulate(problem, rve, SETTINGS))
    found["rest"] = find_rest(LoadCase(**BAR, body_force=(0.0, -0.01)), rve, SETTINGS).u.sum()
    pulled = follow_path(rve, ramp_and_hold(np.diag([1.02, 1.0]), 2.0), 4.0, 8, free=[(1, 1)])
    found["path"] = pulled.stress.sum()

    samples = sample_stress(rve, RANGE, count=128)
    surrogate = train(samples, TrainingSettings(iterations=40, hidden=(4,)))
    write_surrogate(surrogate, folder / "surrogate.h5")
    surrogate = read_surrogate(folder / "surrogate.h5")
    found["surrogate"] = of_response(surrogate.respond(F, F_dot, tangents=True))
    loose = CacheSettings(tolerance=np.inf, audit=0.2)
    run = simulate(problem, CachedLaw(surrogate, rve, loose), SETTINGS)
    assert run.effort["hits"]
    found["cached run"] = of_run(run)
    save_run(run, folder / "run")
    found["run that is read"] = read_run(folder / "run").curve.displacement.sum()
    found["fields"] = read_fields(folder / "run", [DISPLACEMENT_NAME]).displacement.sum()

    table = StressTable(rve, 0.1, RANGE, 3.0)
    found["table run"] = of_run(simulate(problem, CachedLaw(table, rve), SETTINGS))
    halves = {
        "upper": Box((0.0, 20.0), (60.0, 40.0)),
        "lower": Box((0.0, 0.0), (60.0, 20.0)),
    }
    mesh = with_regions(problem.mesh, **halves)
    points = points_by_region(mesh, ("upper", "lower"))
    stiff = RveLaw(CellParameters.preset("water"), initialisation="cauchy-born")
    found["regional run"] = of_run(
        simulate(problem, RegionalLaw({"upper": rve, "lower": stiff}, points), SETTINGS)
    )
    for integrator in ("explicit", "implicit"):
        settings = MacroSettings(frames=3, integrator=integrator)
        found[f"user's law, {integrator}"] = of_run(simulate(problem, KelvinVoigt(), settings))
    slab = SlabLaw(CellParameters.preset("water"), initialisation="slow-manifold", rows=4)
    sides = np.array([0.99, 1.0, 1.01])
    found["slab"] = slab.respond(sides, 0.0 * sides).tension.sum()
    surface = tabulate_surface(slab, (0.99, 1.01), 0.005)
    found["surface table"] = surface.respond(sides, 0.0 * sides).tension.sum()

    (folder / "recipe.toml").write_text(RECIPE, encoding="utf-8")
    (folder / "mesh.msh").write_text(MESH, encoding="utf-8")
    found["mesh"] = load_mesh(folder / "mesh.msh").p.sum()
    recipe = load_recipe(folder / "recipe.toml")
    data = generate_data_set(recipe.study())
    found["data set"] = read_data_set(data.path).stress.sum()
    if start_method is not None:
        with ProcessPoolExecutor(1) as executor:
            by_pool = sample_stress(rve, RANGE, count=128, executor=executor)
        assert by_pool.fingerprint == samples.fingerprint
    return {name: float(value).hex() for name, value in found.items()}


def main():
    folder, *settings = sys.argv[1:]
    for each in settings:
        set_up(each)
    methods = {"spawn", "forkserver"} & {*settings}
    json.dump(figures(Path(folder), *methods), sys.stdout)


if __name__ == "__main__":
    main()
