"""Storage and loss modulus of a plant cell over frequency: a problem stated in Python.

`python examples/cyclic_shear.py` prints a table and draws examples/cyclic-shear.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import (
    CellParameters,
    Fixed,
    MacroSettings,
    PrescribedMotion,
    Problem,
    RveLaw,
    Sine,
    rectangle,
    simulate,
)

WIDTH, HEIGHT, SHEAR = 40.0, 1.0, 0.005
FREQUENCIES = (0.1, 0.2, 0.4)  # 1/µs
COLOURS = ("#0072B2", "#D55E00", "#009E73")


def loop_of(law, frequency, steps=100):
    """The third cycle of a thin sample in shear: (m,) shear and shear stress in µN/µm."""
    drive = PrescribedMotion(
        on="top",
        name="drive",
        displacement=(SHEAR * HEIGHT, 0.0),
        amplitude=Sine(frequency=frequency),
    )
    interval = 1.0 / (steps * frequency)
    problem = Problem(
        mesh=rectangle(WIDTH, HEIGHT, (1, 2)),
        conditions=(Fixed(on="bottom"), drive),
        duration=3.0 / frequency,
        output_interval=interval,
    )
    settings = MacroSettings(integrator="implicit", largest_step=interval)
    run = simulate(problem, law, settings)
    last = slice(-steps - 1, None)
    shear = SHEAR * np.sin(2.0 * np.pi * frequency * run.curve.t[last])
    return shear, run.history["force drive x"][last] / WIDTH


def moduli_of(shear, stress):
    """Storage and loss modulus, µN/µm: projections of a whole cycle, its first point left out."""
    phase = 2.0 * np.pi * np.arange(1, len(shear)) / (len(shear) - 1)
    return tuple(2.0 * np.mean(stress[1:] * f(phase)) / SHEAR for f in (np.sin, np.cos))


def tangent_moduli(law, frequency):
    """The same from the exact tangents at rest: C₁₂₁₂ and 2π f D₁₂₁₂."""
    answer = law.respond(np.eye(2)[None], np.zeros((1, 2, 2)), tangents=True)
    by_F, by_rate = answer.tangents.P_by_F, answer.tangents.P_by_F_dot
    return by_F[0, 0, 1, 0, 1], 2.0 * np.pi * frequency * by_rate[0, 0, 1, 0, 1]


def main():
    """Measure at each frequency and draw the loops."""
    law = RveLaw(CellParameters.preset("printed"), initialisation="slow-manifold")
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    print("frequency (1/µs), storage and loss modulus from the loop, from the tangents (MPa)")
    thickness = law.cell.tissue_thickness
    for frequency, colour in zip(FREQUENCIES, COLOURS, strict=True):
        shear, stress = loop_of(law, frequency)
        moduli = (*moduli_of(shear, stress), *tangent_moduli(law, frequency))
        print(f"{frequency:g}", *(f"{modulus / thickness:.4g}" for modulus in moduli))
        axes.plot(100.0 * shear, stress / thickness, color=colour, label=f"{frequency:g} /µs")
    axes.set_xlabel("shear (%)")
    axes.set_ylabel("shear stress (MPa)")
    axes.grid(alpha=0.25)
    axes.legend(title="frequency")
    figure.savefig(Path(__file__).with_name("cyclic-shear.png"), dpi=300)


if __name__ == "__main__":
    main()
