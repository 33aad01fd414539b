"""Wall stiffness and fluid viscosity of a plant cell from a tensile and relaxation test.

`python examples/identification.py` prints a table and draws examples/identification.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from surrofe2 import CellParameters, RveLaw, follow_path, path_gradients, ramp_and_hold

NAMES = ("wall_stiffness", "viscosity")
TRUE, GUESS = (4600.0, 80.0), (3600.0, 40.0)  # µN/µm, ng/µs: a gel of 8 Pa s
FREE = [(1, 1)]  # the sides of the sample
STRETCH, LENGTH, DURATION = 1.03, 0.75, 1.5  # by 3 % within 0.75 µs, then held


def pulled(values, steps):
    """Law and path of the test for values of `NAMES`."""
    law = RveLaw(CellParameters.preset("water", **dict(zip(NAMES, values, strict=True))))
    motion = ramp_and_hold(np.diag([STRETCH, 1.0]), LENGTH)
    return law, follow_path(law, motion, DURATION, steps, free=FREE)


def measured(steps, noise, seed=1):
    """(steps + 1,) nominal stress P₁₁ of the true cell, µN/µm, with noise over the largest."""
    stress = pulled(TRUE, steps)[1].first_piola[:, 0, 0]
    random = np.random.default_rng(seed).standard_normal(len(stress))
    return stress + noise * stress.max() * random


def identified(data):
    """What least squares finds within a factor e of `GUESS`, by logarithms and their gradients."""
    steps, scale = len(data) - 1, data.max()

    def residual(logarithms):
        return (pulled(np.exp(logarithms), steps)[1].first_piola[:, 0, 0] - data) / scale

    def jacobian(logarithms):
        law, path = pulled(np.exp(logarithms), steps)
        by = path_gradients(law, path, NAMES, free=FREE)
        columns = [by[name][:, 0, 0] for name in NAMES]
        return np.column_stack(columns) * np.exp(logarithms) / scale

    start = np.log(GUESS)
    return least_squares(residual, start, jacobian, bounds=(start - 1.0, start + 1.0))


def main():
    """Identify from 1 % of noise, print and draw."""
    data = measured(600, 0.01)
    fit = identified(data)
    values = np.exp(fit.x)
    spread = 0.01 * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    print(f"{fit.nfev} stresses, {fit.njev} gradients")
    for name, true, guess, value, error in zip(NAMES, TRUE, GUESS, values, spread, strict=True):
        off = 100.0 * (value / true - 1.0)
        print(f"{name}: from {guess:g} to {value:.5g}, true {true:g}: {off:+.2f} %, "
              f"expected ±{100.0 * error:.2f} %")  # fmt: skip
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    t = np.linspace(0.0, DURATION, len(data))
    thickness = CellParameters.preset("water").tissue_thickness  # stresses over it are in MPa
    axes.plot(t, data / thickness, ".", color="0.7", ms=3.0, label="test, 1 % of noise")
    curves = ((GUESS, "guess", "#0072B2"), (values, "identified", "#D55E00"))
    for constants, label, colour in curves:
        _, path = pulled(constants, len(data) - 1)
        stress = path.first_piola[:, 0, 0] / thickness
        axes.plot(t, stress, color=colour, label=label)
    axes.set_xlabel("time (µs)")
    axes.set_ylabel("nominal stress (MPa)")
    axes.grid(alpha=0.25)
    axes.legend()
    figure.savefig(Path(__file__).with_name("identification.png"), dpi=300)


if __name__ == "__main__":
    main()
