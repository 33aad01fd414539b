"""Your own solver on a `StressLaw`, by scikit-fem: a block of tissue at rest under a load.

`python examples/own_solver.py` prints Newton's residuals and draws examples/own-solver.png,
displacements fifty times as large.
"""

from pathlib import Path

import numpy as np
import skfem
from skfem.element import DiscreteField
from skfem.helpers import grad

from surrofe2 import CellParameters, RveLaw

MESH = skfem.MeshQuad1.init_tensor(np.linspace(0, 200, 9), np.linspace(0, 100, 5)).with_defaults()
ELEMENT = skfem.ElementQuad2()
PULL = (0.5, -0.05)  # µN/µm on the right side, in x and y


@skfem.LinearForm
def internal(v, w):
    """∫ P : ∇v dV."""
    return np.einsum("ij...,ij...", w.P, grad(v))


@skfem.BilinearForm
def stiffness(u, v, w):
    """∫ ∇v : ∂P/∂F : ∇u dV."""
    return np.einsum("ij...,ijkl...,kl...", grad(v), w.A, grad(u))


def solve(law, mesh=MESH, pull=PULL, element=ELEMENT, intorder=4, tolerance=1e-9):
    """Rest u of a block clamped on its left: basis, nodal vector, residuals of the iterations."""
    basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=intorder)
    held, state, residuals = basis.get_dofs("left").all(), None, []
    free = basis.complement_dofs(held)
    load = skfem.LinearForm(lambda v, w: pull[0] * v[0] + pull[1] * v[1]).assemble(
        basis.boundary("right")
    )
    u = basis.zeros()
    while not residuals or residuals[-1] > tolerance:
        F = np.eye(2)[:, :, None, None] + grad(basis.interpolate(u))
        shape, F = F.shape[2:], np.moveaxis(F, (0, 1), (2, 3)).reshape(-1, 2, 2)
        answer = law.respond(F, 0.0 * F, state, tangents=True)
        if answer.status.any() or len(residuals) > 20:
            raise RuntimeError("no rest found; load in steps")
        state, by_F = answer.state, answer.tangents.P_by_F.reshape(*shape, 2, 2, 2, 2)
        P = np.moveaxis(answer.first_piola(F).reshape(*shape, 2, 2), (2, 3), (0, 1))
        force = load - internal.assemble(basis, P=DiscreteField(P))
        residuals.append(np.abs(force[free]).max() / np.abs(load).max())
        A = np.moveaxis(by_F, (2, 3, 4, 5), (0, 1, 2, 3))
        K = stiffness.assemble(basis, A=DiscreteField(A))
        u = u + skfem.solve(*skfem.condense(K, force, x=basis.zeros(), D=held))
    return basis, u, residuals


def draw(basis, u):
    """The mesh before and at rest, clamped on its left, and the direction of its load."""
    moved = skfem.MeshQuad1(basis.mesh.p + 50.0 * u[basis.nodal_dofs], basis.mesh.t)
    axes = basis.mesh.draw(linewidth=0.5, color="0.6")
    moved.draw(ax=axes, linewidth=1.5, color="#0072B2")
    axes.plot([0, 0], [0, 100], color="0.15", linewidth=5)
    for y in (20, 50, 80):
        arrow = {"arrowstyle": "-|>", "color": "#D55E00"}
        axes.annotate("", (232, y - 2.5), (212, y), arrowprops=arrow)
    axes.axis("on")
    axes.set(xlabel="x (µm)", ylabel="y (µm)", xlim=(-8, 236))
    axes.set_title(
        "grey: before; blue: at rest, displacements 50-fold; arrows: the load", fontsize=9
    )
    axes.figure.savefig(Path(__file__).with_name("own-solver.png"), dpi=200, bbox_inches="tight")


if __name__ == "__main__":
    basis, u, residuals = solve(RveLaw(CellParameters.preset("printed")))
    print("residuals:", *(f"{each:.1e}" for each in residuals))
    draw(basis, u)
