"""A stress law of your own, a neo-Hookean solid, beside the RVEs of plant cells that it replaces.

`python docs/gallery/own_law.py` prints the page's figures and draws own_law.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surrofe2 import (
    Colours,
    Fixed,
    PrescribedMotion,
    Problem,
    RveLaw,
    StressResponse,
    Tangents,
    draw_tissue,
    drawn_loads,
    fields_at_rest,
    find_rest,
    living_cell,
    rectangle,
)
from surrofe2.run.charts import BLUE, VERMILION, encoded

SIDE = 3000.0  # µm, of a square block: 20 plant cells
STRAIN = 0.15
THICKNESS = 10.0  # µm, of the layer that is computed
IDENTITY = np.eye(2)


class NeoHookean:
    """Compressible neo-Hookean solid, W = µ/2 (F : F − 2 − 2 ln J) + λ/2 (ln J)², J = det F."""

    has_tangents = True

    def __init__(self, mu, lam, density):
        self.mu = mu  # µN/µm, the shear modulus
        self.lam = lam  # µN/µm
        self.density = density  # ng/µm²

    def respond(self, F, F_dot, state=None, *, tangents=False):
        """Cauchy stress, and ∂P/∂F on request, at n points; F (n, 2, 2)."""
        mu, lam = self.mu, self.lam
        J = np.linalg.det(F)
        inverse = np.linalg.inv(F)
        log_J = np.log(J)[:, None, None]
        P = mu * F + (lam * log_J - mu) * np.swapaxes(inverse, 1, 2)
        stress = P @ np.swapaxes(F, 1, 2) / J[:, None, None]
        slopes = None
        if tangents:
            A = mu * np.einsum("ac,bd->abcd", IDENTITY, IDENTITY)
            turned = np.einsum("nbc,nda->nabcd", inverse, inverse)
            A = A + (mu - lam * log_J[..., None, None]) * turned
            A = A + lam * np.einsum("nba,ndc->nabcd", inverse, inverse)
            slopes = Tangents(A, np.zeros_like(A))  # the second: no viscosity
        return StressResponse(stress, np.zeros(len(F), np.int8), state, tangents=slopes)

    def accept(self, F, F_dot, response):
        """Nothing to remember from a finished step."""
        return response


def like(law):
    """Neo-Hookean solid with the shear modulus and λ of an isotropic law at F = I."""
    undeformed = IDENTITY[None]
    answer = law.respond(undeformed, np.zeros_like(undeformed), tangents=True)
    A = answer.tangents.P_by_F[0]
    return NeoHookean(A[0, 1, 0, 1], A[0, 0, 1, 1], law.density)


def loaded(law, strain, elements=(8, 8), steps=15):
    """Block at rest whose glued upper plate has moved; a negative strain presses it."""
    plate = PrescribedMotion(name="plate", on="top", displacement=(0.0, strain * SIDE))
    problem = Problem(
        mesh=rectangle(SIDE, SIDE, elements),
        conditions=(Fixed(on="bottom"), plate),
        watched={"top": (0.5 * SIDE, SIDE)},
    )
    return find_rest(problem, law, load_steps=steps)


def stress_over_strain(rest, strain):
    """Strains, and stresses in MPa of the undeformed section, after each load step."""
    columns = rest.columns
    return strain * columns["t"], columns["force plate y"] / (SIDE * THICKNESS)


def vertical_stress(rest):
    """Vertical Cauchy stress of each element, MPa."""
    return rest.element_stress[:, 1, 1] / THICKNESS


def draw_specimen(axes, rest, colours):
    """Draw the block at rest, coloured by its vertical stress."""
    fields = fields_at_rest(rest)
    loads = drawn_loads(rest.system.problem, fields)
    return draw_tissue(axes, fields, 1, vertical_stress(rest), colours, nodes=loads)


if __name__ == "__main__":
    rve = RveLaw(living_cell("apple", arrangement="hexagon"))
    solid = like(rve)
    print(f"shear modulus {solid.mu / THICKNESS:.3g} MPa, λ {solid.lam / THICKNESS:.3g} MPa")
    figure = Figure(figsize=(12.0, 3.4), layout="constrained")
    cells, own, curve = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.3))
    pressed = []
    for law, name, colour in ((rve, "RVEs", BLUE), (solid, "neo-Hookean", VERMILION)):
        for strain in (-STRAIN, STRAIN):
            rest = loaded(law, strain)
            x, y = stress_over_strain(rest, strain)
            print(f"{name}, {100 * strain:+.0f} %: {y[-1]:.4f} MPa")
            is_pressed = strain < 0.0
            curve.plot(100 * x, y, color=colour, label=name if is_pressed else None)
            if is_pressed:
                pressed.append(rest)
    values = np.concatenate([vertical_stress(rest) for rest in pressed])
    colours = Colours.of("vertical stress (MPa)", values)
    for axes, rest, title in zip(
        (cells, own), pressed, ("RVEs of plant cells", "neo-Hookean solid"), strict=True
    ):
        drawn = draw_specimen(axes, rest, colours)
        axes.set_title(f"{title}, pressed by {100 * STRAIN:g} %", fontsize=9)
    colours.bar([cells, own], drawn)
    curve.set(xlabel="strain (%)", ylabel="stress (MPa)")
    curve.legend(fontsize=8)
    curve.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))
