"""Other particle codes on a comparable tissue, where they are installed; one thread each.

They live in a Python of their own, named by `--peers PYTHON` or $SURROFE2_PEERS, never in ours.
Ours computes the whole model of the paper, its dashpots and its halved boundary walls included;
what each of the others leaves out or adds, its row says.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.row import Row
from benchmarks.setting import Setting, rve
from benchmarks.timing import threads, time_calls
from surrofe2 import LoadCase
from surrofe2.rve import RveLaw
from surrofe2.tissue import Tissue, TissueSettings, make_tissue
from surrofe2.tissue.simulation import held_and_loaded, make_conditions

TITLE = "Full tissue against other particle codes"
VARIABLE = "SURROFE2_PEERS"
PRESET = "printed"
PLANT_CELLS = (16, 16)
SCRIPTS = Path(__file__).parent / "peer_runs"
PEERS = {
    "LAMMPS": (
        "lammps",
        "without dashpots and bonded contacts, Lennard-Jones for r⁻⁶; fluid also meets the walls "
        "of other plant cells; velocity Verlet",
    ),
    "PySPH": (
        "pysph",
        "without dashpots; every pair computed from both sides; fluid also meets fluid and walls "
        "of other plant cells; one neighbour search a step",
    ),
}
_MILLION = 1e-6
ABSENT = "not installed"


def run(setting: Setting) -> list[Row]:
    """Million particle-steps a second and core: ours, then each peer's."""
    law = rve(PRESET)
    tissue = make_tissue(law.cell, law.reference, PLANT_CELLS)
    ours = _ours(setting, law)
    name = "million particle-steps a second and core"
    rows = [
        Row(
            name=f"{name}: full tissue of {tissue.particles:,} particles",
            value=ours,
            unit="",
            note="all pair laws with their dashpots",
        )
    ]
    python = setting.peers or os.environ.get(VARIABLE)
    for peer, (module, differs) in PEERS.items():
        if python is None or not is_installed(python, module):
            rows.append(Row(name=f"{name}: {peer}", value=None, unit="", note=ABSENT))
            continue
        steps = setting.pick(2000, 200) if peer == "LAMMPS" else setting.pick(200, 20)
        found = _ask(python, module, describe(tissue), steps)
        speed = _MILLION * tissue.particles * steps / found["seconds"]
        rows.append(
            Row(
                name=f"{name}: {peer} {found['version']}",
                value=speed,
                unit="",
                baseline="ours",
                baseline_value=ours,
                ratio=ours / speed,
                note=differs,
            )
        )
    return rows


def _ours(setting: Setting, law: RveLaw) -> float:
    width, height = (count * law.cell.cell_side for count in PLANT_CELLS)
    load = LoadCase(width=width, height=height, watched=(width, 0.5 * height))
    conditions = make_conditions(load, law.cell, law.reference)
    tissue, dynamics = conditions.tissue, held_and_loaded(conditions, TissueSettings())
    steps = setting.pick(500, 50)
    even = np.full(steps, 1e-3)
    with threads(1):
        taken = time_calls(lambda: dynamics.leap(even, even, np.zeros(steps)), setting.pick(7, 2))
    return _MILLION * tissue.particles * steps / taken.median


def describe(tissue: Tissue) -> dict[str, Any]:
    """Particles, bonds and constants as the scripts read them.

    plant_cell: 0 for a wall particle, else the number, from 1, of the cell the fluid is in.
    """
    x = tissue.to_particles(tissue.start)
    cell, walls = tissue.cell, tissue.wall_particles
    spring = cell.cell_side / cell.wall_springs_per_side
    bonds = cKDTree(x[:walls]).query_pairs(1.25 * spring, output_type="ndarray")
    column, row = np.floor(x[walls:] / cell.cell_side).astype(int).T
    number = 1 + column + tissue.cells[0] * row
    return {
        "x": x.tolist(),
        "bonds": bonds.tolist(),
        "plant_cell": [0] * walls + number.tolist(),
        "wall_mass": cell.wall_particle_mass,
        "fluid_mass": cell.fluid_particle_mass,
        "wall_stiffness": cell.wall_stiffness,
        "rest_length": tissue.constants.rest_length,
        "repulsion_strength": cell.repulsion_strength,
        "cutoff": cell.repulsion_cutoff,
        "smoothing_length": cell.smoothing_length,
        "sound_speed": cell.sound_speed,
        "viscosity": cell.viscosity,
    }


def is_installed(python: str, module: str) -> bool:
    """Whether that Python can import the module."""
    done = _start(python, ["-c", f"import {module}"])
    return done is not None and done.returncode == 0


def _ask(python: str, module: str, tissue: dict[str, Any], steps: int) -> dict[str, Any]:
    with TemporaryDirectory() as folder:
        path = Path(folder, "tissue.json")
        path.write_text(json.dumps(tissue), encoding="utf-8")
        done = _start(python, [str(SCRIPTS / f"with_{module}.py"), str(path), str(steps)])
    if done is None or done.returncode:
        said = "" if done is None else (done.stderr or done.stdout).strip()
        raise RuntimeError(f"{module} failed: {said.splitlines()[-1] if said else 'no message'}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def _start(python: str, arguments: list[str]) -> subprocess.CompletedProcess[str] | None:
    """Run that Python on one thread, with the libraries of its environment; None: there is none."""
    executable = Path(python).absolute()
    library = executable.parents[1] / "lib"
    known = [str(library), os.environ.get("LD_LIBRARY_PATH", "")]
    environment = {
        **os.environ,
        "LD_LIBRARY_PATH": os.pathsep.join(filter(None, known)),
        "OMP_NUM_THREADS": "1",
    }
    environment.pop("PYTHONPATH", None)
    try:
        return subprocess.run(
            [str(executable), *arguments], env=environment, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
    except OSError:
        return None
