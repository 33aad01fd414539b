"""The tissue in PySPH: density summation, pressure and viscosity, springs, cut-off repulsion.

Walls and fluid are two particle arrays. Fluid feels all fluid within reach, that of other plant
cells too, and there are no dashpots.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
import pysph
from pysph.base.kernels import CubicSpline
from pysph.base.utils import get_particle_array
from pysph.solver.application import Application
from pysph.solver.solver import Solver
from pysph.sph.basic_equations import SummationDensity
from pysph.sph.equation import Equation, Group
from pysph.sph.integrator import EulerIntegrator
from pysph.sph.integrator_step import IntegratorStep

STEP = 1e-5


class Kick(IntegratorStep):
    """v += Δt a, x += Δt v."""

    def stage1(self, d_idx, d_x, d_y, d_u, d_v, d_au, d_av, dt):
        d_u[d_idx] += dt * d_au[d_idx]
        d_v[d_idx] += dt * d_av[d_idx]
        d_x[d_idx] += dt * d_u[d_idx]
        d_y[d_idx] += dt * d_v[d_idx]


class Pressure(Equation):
    """Eq. (8): pressure c² ρ and Morris viscosity."""

    def __init__(self, dest, sources, c, mu):
        self.c, self.mu = c, mu
        super().__init__(dest, sources)

    def initialize(self, d_idx, d_au, d_av):
        d_au[d_idx] = 0.0
        d_av[d_idx] = 0.0

    def loop(self, d_idx, s_idx, d_au, d_av, d_rho, s_rho, s_m, R2IJ, XIJ, VIJ, DWIJ):
        if R2IJ > 1e-12:
            p = self.c * self.c * (1.0 / d_rho[d_idx] + 1.0 / s_rho[s_idx])
            dot = XIJ[0] * DWIJ[0] + XIJ[1] * DWIJ[1]
            b = 2.0 * self.mu / (d_rho[d_idx] * s_rho[s_idx]) * dot / R2IJ
            d_au[d_idx] += s_m[s_idx] * (b * VIJ[0] - p * DWIJ[0])
            d_av[d_idx] += s_m[s_idx] * (b * VIJ[1] - p * DWIJ[1])


class Repulsion(Equation):
    """Eq. (2) without its dashpot."""

    def __init__(self, dest, sources, strength, cutoff):
        self.strength, self.square = strength, cutoff * cutoff
        super().__init__(dest, sources)

    def loop(self, d_idx, d_m, d_au, d_av, R2IJ, XIJ):
        if R2IJ > 1e-12 and R2IJ < self.square:
            f = self.strength * (
                1.0 / (R2IJ * R2IJ * R2IJ) - 1.0 / (self.square * self.square * self.square)
            )
            f = f / (sqrt(R2IJ) * d_m[d_idx])
            d_au[d_idx] += f * XIJ[0]
            d_av[d_idx] += f * XIJ[1]


class Springs(Equation):
    """Eq. (1) without its dashpot; at most four bonds a particle, −1 where there is none."""

    def __init__(self, dest, sources, stiffness, rest):
        self.stiffness, self.rest = stiffness, rest
        super().__init__(dest, sources)

    def initialize(self, d_idx, d_x, d_y, d_m, d_au, d_av, d_bonds):
        i, j = declare("int", 2)
        dx, dy, length, f = declare("double", 4)
        d_au[d_idx] = 0.0
        d_av[d_idx] = 0.0
        for i in range(4):
            j = d_bonds[4 * d_idx + i]
            if j >= 0:
                dx = d_x[j] - d_x[d_idx]
                dy = d_y[j] - d_y[d_idx]
                length = sqrt(dx * dx + dy * dy)
                f = self.stiffness * (length - self.rest) / (length * d_m[d_idx])
                d_au[d_idx] += f * dx
                d_av[d_idx] += f * dy


class Tissue(Application):
    """The tissue for a number of steps."""

    def __init__(self, tissue, steps, **options):
        self.tissue, self.steps = tissue, steps
        super().__init__(**options)

    def create_particles(self):
        tissue = self.tissue
        x, cell = np.array(tissue["x"]), np.array(tissue["plant_cell"])
        reach = 0.5 * max(tissue["cutoff"], 2.0 * tissue["smoothing_length"])
        arrays = []
        for name, chosen, mass in (
            ("walls", cell == 0, tissue["wall_mass"]),
            ("fluid", cell > 0, tissue["fluid_mass"]),
        ):
            part = x[chosen]
            arrays.append(
                get_particle_array(
                    name=name, x=part[:, 0], y=part[:, 1], m=mass, h=reach, rho=0.07,
                    additional_props=["au", "av"],
                )
            )  # fmt: skip
        bonds = np.full((len(arrays[0].x), 4), -1, dtype=np.int32)
        used = np.zeros(len(bonds), dtype=int)
        for i, j in tissue["bonds"]:
            for a, b in ((i, j), (j, i)):
                bonds[a, used[a]] = b
                used[a] += 1
        arrays[0].add_property("bonds", type="int", stride=4, data=bonds.ravel())
        return arrays

    def create_solver(self):
        return Solver(
            kernel=CubicSpline(dim=2), dim=2, dt=STEP, tf=STEP * self.steps, pfreq=10**9,
            integrator=EulerIntegrator(walls=Kick(), fluid=Kick()),
        )  # fmt: skip

    def create_equations(self):
        t, both = self.tissue, ["walls", "fluid"]
        repel = (t["repulsion_strength"], t["cutoff"])
        return [
            Group([SummationDensity("fluid", ["fluid"])]),
            Group(
                [
                    Springs("walls", None, t["wall_stiffness"], t["rest_length"]),
                    Repulsion("walls", both, *repel),
                    Pressure("fluid", ["fluid"], t["sound_speed"], t["viscosity"]),
                    Repulsion("fluid", ["walls"], *repel),
                ]
            ),
        ]


def main():
    tissue = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    steps = int(sys.argv[2])
    seconds = []
    with TemporaryDirectory() as folder:
        for count in (10, steps + 10):  # set-up and compilation are in both
            app = Tissue(tissue, count, output_dir=folder)
            app.setup(["--disable-output", "--no-adaptive-timestep", "--quiet"])
            begin = perf_counter()
            app.solver.solve(show_progress=False)
            seconds.append(perf_counter() - begin)
    if not all(np.isfinite(part.x).all() for part in app.particles):
        raise SystemExit("particles flew apart")
    print(json.dumps({"version": pysph.__version__, "seconds": seconds[1] - seconds[0]}))


if __name__ == "__main__":
    main()
