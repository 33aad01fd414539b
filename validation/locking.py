"""Whether elements lock where the tissue is nearly incompressible, as with undrained sap.

Cook's membrane and a cantilever of a linear law with the bulk modulus K and the shear modulus G, by
the package's own elements against scikit-fem's mixed ones (Taylor and Hood: quadratic displacement,
linear pressure) on a finer mesh. Beside them stand two elements that lock, which the package does
not have: quadrilaterals and triangles of the first order with the whole stress at every point.

docs/validation/locking.md has the table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from skfem.helpers import ddot, div, sym_grad

from surrofe2.law.stress_law import StressResponse, Tangents, check_deformation
from surrofe2.macro import find_rest
from surrofe2.macro.equations_of_motion import factorised
from surrofe2.problem import Fixed, Problem
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from validation.case import Setting

Array = NDArray[np.float64]

STIFFNESS_RATIOS = (2.0, 400.0, 3500.0)
"""K/G: drained tissue has some 2, where nothing locks, `apple` with the sap of real water 3,300."""
SHEAR_MODULUS = 10.0
SIZES = (2, 4, 8, 16)
"""Elements across."""
REFERENCE = {"Cook's membrane": 64, "cantilever": 20}
"""Elements across of the mixed solution."""
_I2 = np.eye(2)


@dataclass(frozen=True, slots=True)
class LinearLaw:
    """P = K tr ε I + 2 G dev ε with ε = sym(F − I), as a stress law; both moduli in µN/µm."""

    bulk_modulus: float
    shear_modulus: float = SHEAR_MODULUS
    density: float = 1.0
    has_tangents: bool = True

    @property
    def lame(self) -> float:
        """λ = K − G of the plane, µN/µm."""
        return self.bulk_modulus - self.shear_modulus

    @property
    def slope(self) -> Array:
        """(2, 2, 2, 2) ∂P/∂F."""
        same = np.einsum("ik,jl->ijkl", _I2, _I2)
        volume = self.lame * np.einsum("ij,kl->ijkl", _I2, _I2)
        whole: Array = volume + self.shear_modulus * (same + same.transpose(0, 1, 3, 2))
        return whole

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """σ = P Fᵀ/det F of points (n, 2, 2)."""
        F, F_dot = check_deformation(F, F_dot)
        P = np.einsum("ijkl,nkl->nij", self.slope, F - _I2)
        stress = P @ F.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None]
        shape = (len(F), 2, 2, 2, 2)
        slopes = Tangents(np.broadcast_to(self.slope, shape), np.zeros(shape)) if tangents else None
        return StressResponse(stress, np.zeros(len(F), dtype=np.int8), None, {}, slopes)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """The response as it is: the law has no state."""
        return response


def cook(n: int) -> skfem.MeshQuad1:
    """Cook's membrane: a tapered panel of n × n quadrilaterals, in µm."""
    mesh = skfem.MeshQuad1.init_tensor(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, 1.0, n + 1))
    s, t = mesh.p
    low, high = 44.0 * s, 44.0 + 16.0 * s
    return skfem.MeshQuad1(np.stack([48.0 * s, low + t * (high - low)]), mesh.t)


def cantilever(n: int) -> skfem.MeshQuad1:
    """A beam ten times as long as high, of 10 n × n squares, in µm."""
    along, across = np.linspace(0.0, 400.0, 10 * n + 1), np.linspace(0.0, 40.0, n + 1)
    return skfem.MeshQuad1.init_tensor(along, across)


PROBLEMS: Mapping[str, Callable[[int], skfem.MeshQuad1]] = {
    "Cook's membrane": cook,
    "cantilever": cantilever,
}
"""Clamped at the left end; a traction along y acts at the right end."""


def with_ends(mesh: skfem.Mesh) -> skfem.Mesh:
    """The mesh with its boundaries left and right."""
    x = mesh.p[0]
    left, right = x.min(), x.max()
    slack = 1e-9 * (right - left)
    return mesh.with_boundaries(
        {
            "left": lambda at: abs(at[0] - left) < slack,
            "right": lambda at: abs(at[0] - right) < slack,
        }
    )


QUADRILATERAL, SIX_NODES = "quadrilateral", "six-node triangle"
LOCKING_QUADRILATERAL = "quadrilateral, all stress at each point"
LOCKING_TRIANGLE = "three-node triangle"
OWN: Mapping[str, Callable[[skfem.MeshQuad1], skfem.Mesh]] = {
    QUADRILATERAL: lambda mesh: mesh,
    SIX_NODES: lambda mesh: skfem.MeshTri2.from_mesh(mesh.to_meshtri()),
}
"""Elements of the package. Three-node triangles of a file become six-node ones."""
OTHERS: Mapping[str, tuple[Any, bool]] = {
    LOCKING_QUADRILATERAL: (skfem.ElementQuad1(), False),
    LOCKING_TRIANGLE: (skfem.ElementTriP1(), True),
}
"""Elements for comparison, and whether they are triangles."""


def by_package(mesh: skfem.Mesh, law: LinearLaw) -> float:
    """Mean displacement of the right end along y over the traction, µm per µN/µm, by the stiffness
    that the package has at rest."""
    problem = Problem(mesh=with_ends(mesh), conditions=(Fixed(on="left", components="xy"),))
    rest = find_rest(problem, law, factor=0.0)
    mesh, free = rest.system.problem.mesh, rest.system.free
    load = _load(mesh, skfem.ElementVector(mesh.elem()))
    solve = factorised(rest.stiffness)
    assert solve is not None
    return float(load[free] @ solve(load[free])) / _length(mesh)


def by_one_field(mesh: skfem.MeshQuad1, law: LinearLaw, element: Any, is_triangle: bool) -> float:
    """The same by an element of displacements alone, all of the stress at each of its points."""
    mesh = with_ends(mesh.to_meshtri() if is_triangle else mesh)
    basis = skfem.Basis(mesh, skfem.ElementVector(element))
    stiffness = _shear_form(law).assemble(basis) + law.lame * _volume_form.assemble(basis)
    load = _load(mesh, skfem.ElementVector(element))
    u = skfem.solve(*skfem.condense(stiffness, load, D=basis.get_dofs("left")))
    return float(load @ u) / _length(mesh)


def by_mixed_elements(name: str, law: LinearLaw, across: int) -> float:
    """The same by Taylor–Hood elements: p = λ div u is an unknown of its own."""
    mesh = with_ends(PROBLEMS[name](across).to_meshtri())
    element = skfem.ElementVector(skfem.ElementTriP2())
    basis = skfem.Basis(mesh, element)
    pressure = basis.with_element(skfem.ElementTriP1())
    A = _shear_form(law).assemble(basis)
    B = _divergence_form.assemble(basis, pressure)
    C = _mass_form.assemble(pressure) / law.lame
    load = _load(mesh, element)
    both = skfem.bmat([[A, B.T], [B, -C]], "csr")
    right = np.concatenate([load, np.zeros(pressure.N)])
    u = skfem.solve(*skfem.condense(both, right, D=basis.get_dofs("left")))
    return float(right @ u) / _length(mesh)


def _shear_form(law: LinearLaw) -> skfem.BilinearForm:
    G = law.shear_modulus
    return skfem.BilinearForm(lambda u, v, w: 2.0 * G * ddot(sym_grad(u), sym_grad(v)))


_volume_form = skfem.BilinearForm(lambda u, v, w: div(u) * div(v))
_divergence_form = skfem.BilinearForm(lambda u, q, w: div(u) * q)
_mass_form = skfem.BilinearForm(lambda p, q, w: p * q)


def _load(mesh: skfem.Mesh, element: Any) -> Array:
    """Nodal forces of a traction of 1 µN/µm along y at the right end."""
    basis = skfem.FacetBasis(mesh, element, facets=mesh.boundaries["right"])
    forces: Array = skfem.LinearForm(lambda v, w: v[1]).assemble(basis)
    return forces


def _length(mesh: skfem.Mesh) -> float:
    """Length of the right end, µm."""
    y = mesh.p[1, np.unique(mesh.facets[:, mesh.boundaries["right"]])]
    return float(np.ptp(y))


@dataclass(frozen=True, slots=True)
class Measured:
    """The mean deflection of the loaded end, % off the reference."""

    problem: str
    element: str
    ratio: float
    across: int
    off: float


QUANTITIES: tuple[Quantity[Measured], ...] = (
    Quantity("problem", "", "", lambda row: row.problem),
    Quantity("element", "", "", lambda row: row.element),
    Quantity("K/G", "", "g", lambda row: row.ratio),
    Quantity("elements across", "", "d", lambda row: row.across),
    Quantity("deflection off", "%", "+.2f", lambda row: row.off),
)


def locking(setting: Setting) -> Study:
    """Every element at every ratio of K and G, on ever finer meshes."""
    sizes = setting.sizes or (SIZES[:2] if setting.quick else SIZES)
    rows = [
        row
        for name in PROBLEMS
        for ratio in STIFFNESS_RATIOS
        for row in measure(name, ratio, sizes)
    ]
    return Study(
        title="Elements of nearly incompressible tissue",
        panels=tuple(_panel(name, ratio, rows) for name in PROBLEMS for ratio in STIFFNESS_RATIOS),
        columns=len(STIFFNESS_RATIOS),
        table=Table(QUANTITIES, rows),
    )


def measure(
    name: str, ratio: float, sizes: tuple[int, ...], reference: int | None = None
) -> list[Measured]:
    """Rows of all elements on meshes of so many elements across.

    Args:
        reference: elements across of the mixed solution; None: those of `REFERENCE`.
    """
    law = LinearLaw(ratio * SHEAR_MODULUS)
    exact = by_mixed_elements(name, law, reference or REFERENCE[name])
    rows = []
    for element, meshed in OWN.items():
        for n in sizes:
            deflection = by_package(meshed(PROBLEMS[name](n)), law)
            rows.append(Measured(name, element, ratio, n, 100.0 * (deflection / exact - 1.0)))
    for element, (of_skfem, is_triangle) in OTHERS.items():
        for n in sizes:
            deflection = by_one_field(PROBLEMS[name](n), law, of_skfem, is_triangle)
            rows.append(Measured(name, element, ratio, n, 100.0 * (deflection / exact - 1.0)))
    return rows


def _panel(name: str, ratio: float, rows: list[Measured]) -> Panel:
    """Deflection over the number of elements across, a line for each element."""
    these = [row for row in rows if (row.problem, row.ratio) == (name, ratio)]
    curves = []
    for element in dict.fromkeys(row.element for row in these):
        points = [(row.across, row.off) for row in these if row.element == element]
        x, y = np.array(points, dtype=float).T
        curves.append(Curve(element, x, y))
    return Panel(
        title=f"{name}, K/G = {ratio:g}",
        x_label="elements across",
        y_label="deflection off (%)",
        curves=tuple(curves),
        log_x=True,
        x_ticks=tuple(sorted({float(row.across) for row in these})),
        zero=True,
    )
