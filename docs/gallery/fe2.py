"""FE² on one page: a block of apple flesh, 4 mm × 2 mm, glued to two plates, is sheared at rest.

`python docs/gallery/fe2.py` prints Newton's residuals and the force, and draws fe2.png.
"""

from pathlib import Path

import numpy as np
import skfem
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from skfem.element import DiscreteField
from skfem.helpers import grad

from surrofe2 import CellParameters, Colours, RveLaw, draw_scale_bar

MESH = skfem.MeshQuad1.init_tensor(np.linspace(0, 4000, 9), np.linspace(0, 2000, 5)).with_defaults()
SHEAR = 200.0  # µm, by which the upper plate moves


@skfem.LinearForm
def internal_force(v, w):
    """∫ P : ∇v."""
    return np.einsum("ij...,ij...", w.P, grad(v))


@skfem.BilinearForm
def stiffness(u, v, w):
    """∫ ∇v : ∂P/∂F : ∇u."""
    return np.einsum("ij...,ijkl...,kl...", grad(v), w.A, grad(u))


def stress_of(law, basis, u, state):
    """P and ∂P/∂F at all quadrature points, one RVE at each, and the state to begin with next."""
    F = np.eye(2)[:, :, None, None] + grad(basis.interpolate(u))
    elements, points = F.shape[2:]
    F = np.moveaxis(F, (0, 1), (2, 3)).reshape(-1, 2, 2)
    answer = law.respond(F, np.zeros_like(F), state, tangents=True)
    assert not answer.status.any()
    P = answer.first_piola(F).reshape(elements, points, 2, 2)
    A = answer.tangents.P_by_F.reshape(elements, points, 2, 2, 2, 2)
    return np.moveaxis(P, (2, 3), (0, 1)), np.moveaxis(A, (2, 3, 4, 5), (0, 1, 2, 3)), answer.state


def solve(law, mesh=MESH, shear=SHEAR, tolerance=1e-8):
    """Rest of the block: basis, displacement, stress, residuals, force of the upper plate in µN."""
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()), intorder=4)
    plates = basis.get_dofs({"bottom", "top"}).all()
    u, state, residuals = basis.zeros(), None, []
    u[basis.get_dofs("top").all("u^1")] = shear
    while not residuals or residuals[-1] > tolerance:
        P, A, state = stress_of(law, basis, u, state)
        force = internal_force.assemble(basis, P=DiscreteField(P))
        K = stiffness.assemble(basis, A=DiscreteField(A))
        residuals.append(abs(np.delete(force, plates)).max() / abs(force).max())
        u = u + skfem.solve(*skfem.condense(K, -force, x=basis.zeros(), D=plates))
    return basis, u, P, residuals, force[basis.get_dofs("top").all("u^1")].sum()


if __name__ == "__main__":
    basis, u, P, residuals, force = solve(RveLaw(CellParameters.preset("apple")))
    print("residuals:", *(f"{each:.1e}" for each in residuals), f"force: {force:.0f} µN")
    shear = P[0, 1].mean(axis=1) / 10.0  # MPa, of a layer of 10 µm
    moved = MESH.p + u[basis.nodal_dofs]
    corners = moved[:, MESH.t].T
    axes = Figure(figsize=(7.5, 3.6), layout="constrained").subplots()
    colours = Colours.of("shear stress (MPa)", shear)
    drawn = PolyCollection([*corners], edgecolors="0.4", linewidths=0.5)
    colours.bar(axes, axes.add_collection(colours.paint(drawn, shear)))
    for plate in ("bottom", "top"):
        axes.plot(*moved[:, MESH.facets[:, MESH.boundaries[plate]]], color="0.15", linewidth=4.0)
    draw_scale_bar(axes, corners.min(axis=(0, 1)), corners.max(axis=(0, 1)))
    axes.figure.savefig(Path(__file__).with_suffix(".png"), dpi=150)
