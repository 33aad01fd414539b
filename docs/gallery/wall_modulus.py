"""Wall modulus of apple from the force on a disc that is pressed into it, at rest.

The measurement is synthetic: forces of known constants with noise. Least squares take it back.
`python docs/gallery/wall_modulus.py` prints the page's table and draws wall_modulus.png.
"""

from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from surrofe2 import (
    Circle,
    Colours,
    Fixed,
    Problem,
    RigidBody,
    RveLaw,
    Symmetry,
    draw_tissue,
    drawn_bodies,
    fields_at_rest,
    find_rest,
    living_cell,
)
from surrofe2.run.charts import BLUE, VERMILION, encoded

WALL_MODULUS = 300.0  # MPa, behind the measurement
TURGOR = 0.4  # MPa, behind the measurement
START = 200.0  # MPa, the wall modulus with which least squares begin
NOISE = 0.01  # standard deviation of a force over the largest
RADIUS = 1500.0  # µm, of the disc
DEPTH = 300.0  # µm
STEPS = 8  # load steps; a force is measured at the end of each
# Half of a block of 6 mm × 3 mm, with small elements where the disc touches it.
COLUMNS = np.array([0.0, 150, 300, 450, 600, 800, 1200, 1900, 3000])  # µm
HEIGHTS = np.array([0.0, 1000, 1700, 2200, 2600, 2800, 3000])  # µm


def pressed(wall_modulus, turgor=TURGOR, columns=COLUMNS, heights=HEIGHTS):
    """Tissue at rest under the disc, for a wall modulus and a turgor in MPa."""
    top = heights[-1]
    disc = RigidBody(
        name="disc",
        shape=Circle(radius=RADIUS),
        on="top",
        position=(0.0, top + RADIUS),
        displacement=(0.0, -DEPTH),
    )
    problem = Problem(
        mesh=skfem.MeshQuad1.init_tensor(columns, heights).with_defaults(),
        conditions=(Fixed(on="bottom"), Symmetry(on="left")),
        bodies=(disc,),
        watched={"below the disc": (0.0, top)},
    )
    cell = living_cell("apple", turgor=turgor, wall_modulus=wall_modulus, arrangement="hexagon")
    return find_rest(problem, RveLaw(cell), load_steps=STEPS)


def force_over_depth(rest):
    """Depths in µm and forces on the whole disc in µN, (STEPS + 1,) each."""
    factors = np.linspace(0.0, 1.0, STEPS + 1)
    # a load step that was halved left more rows than STEPS
    force = np.interp(factors, rest.columns["t"], -2.0 * rest.columns["force disc y"])
    return DEPTH * factors, force


def measured(rest, seed=1):
    """Forces of a rest with noise, (STEPS,) µN."""
    force = force_over_depth(rest)[1][1:]
    noise = np.random.default_rng(seed).standard_normal(STEPS)
    return force + NOISE * force[-1] * noise


def identified(data, start, forces):
    """Parameters that fit forces (STEPS,), and the covariance of their logarithms.

    Args:
        data: (STEPS,) measured forces, µN.
        start: (p,) parameters to begin with.
        forces: function of p parameters that returns (STEPS + 1,) forces.
    """
    deviation = NOISE * data[-1]

    def residual(logarithms):
        return (forces(*np.exp(logarithms))[1:] - data) / deviation

    fit = least_squares(residual, np.log(start), diff_step=1e-3, xtol=1e-4, ftol=1e-4)
    return np.exp(fit.x), np.linalg.inv(fit.jac.T @ fit.jac)


def draw_specimen(axes, rest):
    """Draw the tissue under the disc, coloured by its vertical stress in MPa."""
    fields = fields_at_rest(rest)
    bodies = rest.system.problem.bodies
    shown = drawn_bodies(bodies, rest.columns["t"], rest.columns, fields)
    stress = rest.element_stress[:, 1, 1] / 10.0  # MPa, of a layer of 10 µm
    colours = Colours.of("vertical stress (MPa)", stress)
    colours.bar(axes, draw_tissue(axes, fields, 1, stress, colours, bodies=shown))


if __name__ == "__main__":
    rest = pressed(WALL_MODULUS)
    depths, truth = force_over_depth(rest)
    data = measured(rest)
    figure = Figure(figsize=(12.0, 3.4), layout="constrained")
    specimen, curve, plane = figure.subplots(1, 3, width_ratios=(1.5, 1.1, 1.1))
    draw_specimen(specimen, rest)

    for turgor in (0.9 * TURGOR, TURGOR, 1.1 * TURGOR):
        values, covariance = identified(
            data, [START], lambda E, turgor=turgor: force_over_depth(pressed(E, turgor))[1]
        )
        error = np.sqrt(covariance[0, 0])
        print(f"turgor {turgor:.2f} MPa: wall modulus {values[0]:.0f} MPa ± {100 * error:.1f} %")
        plane.errorbar(
            turgor, values[0], yerr=values[0] * error, fmt="o", color=BLUE, capsize=3.0,
            label="turgor known" if turgor == TURGOR else None,
        )  # fmt: skip
        if turgor == TURGOR:
            fitted = force_over_depth(pressed(values[0]))[1]

    both, covariance = identified(
        data, [START, TURGOR], lambda E, turgor: force_over_depth(pressed(E, turgor))[1]
    )
    errors = np.sqrt(np.diag(covariance))
    correlation = covariance[0, 1] / errors.prod()
    print(f"both: wall modulus {both[0]:.0f} MPa ± {100 * errors[0]:.1f} %,", end=" ")
    print(f"turgor {both[1]:.3f} MPa ± {100 * errors[1]:.1f} %, correlation {correlation:.3f}")

    start = force_over_depth(pressed(START))[1]
    curve.plot(depths[1:], data, "o", color="0.3", markersize=4.0, label="measurement")
    curve.plot(depths, start, ":", color="0.5", label=f"at the start, {START:g} MPa")
    curve.plot(depths, fitted, color=BLUE, label="identified, turgor known")
    curve.set(xlabel="depth of the disc (µm)", ylabel="force on the disc (µN)")
    curve.legend(fontsize=8)

    # the ellipse that holds 95 % of fits of both, from the covariance of their logarithms
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.sqrt(5.991) * np.stack([np.cos(turn), np.sin(turn)])
    ellipse = both[:, None] * np.exp(np.linalg.cholesky(covariance) @ circle)
    plane.plot(ellipse[1], ellipse[0], color=VERMILION)
    plane.plot(both[1], both[0], "s", color=VERMILION, label="both identified, 95 %")
    plane.plot(TURGOR, WALL_MODULUS, "*", color="black", markersize=10.0, label="truth", zorder=3)
    plane.set(xlabel="turgor (MPa)", ylabel="wall modulus (MPa)")
    plane.legend(fontsize=8)
    for axes in (curve, plane):
        axes.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))
