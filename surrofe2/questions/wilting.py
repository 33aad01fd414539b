"""Wilting: size and stiffness of a tissue that loses water, against the turgor that is left.

A tissue lies in a bath of an osmotic pressure Π and is left until no water flows. Its cells keep
what is dissolved in them, and the pressure of a uniform fluid is inversely proportional to the
area of its plant cell, as that of a dilute solution is to its volume (van 't Hoff). So cells shrink
until their sap has the pressure Π and what the walls still carry::

    turgor T = c_s² ρ/t − Π          T t = −(virial of the walls)/2

There are no air spaces, so that Π on every plant cell is Π on the outline of the tissue: the RVE is
in the state σ(F) = −Π t I, with one reference and one wall rest length all along. The wilted state
is the reference of its own moduli, whose stress σ + Π t I vanishes there::

    C_ijkl = ∂σ_ij/∂F_km F_lm

The water potential of the tissue is −Π, that of the unwilted reference 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # scipy.linalg is loaded where cells wilt

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.moduli import poisson, shear_modulus, voigt, young
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw

POINTS = 16  # states along the way
# Newton's method for the shape of the box: iterations, and the part of the stress that is no
# pressure, over the turgor, at which it ends.
_TRIALS = 30
_EVEN = 1e-10
# Moduli along x and y that differ by less than this fraction are drawn as one.
_SAME = 1e-3
# Digits of a water potential: that of the reference is 0 up to rounding.
_DIGITS = 9
# Fraction of the way to no turgor that is left out at its end, where the stiffness ends, too.
_SLACK = 1e-2


@dataclass(frozen=True, slots=True, kw_only=True)
class Wilting:
    """States of a plant cell along wilting, n of them; pressures and moduli in MPa.

    Attributes:
        bath: (n,) osmotic pressure of the bath.
        turgor: (n,) pressure that the walls carry.
        F: (n, 2, 2) of the box, from the unwilted reference.
        wall_stretch: (n,) mean length of wall springs over their rest length.
        elastic: (n, 3, 3) drained moduli in the bath, about the wilted state; xx, yy, xy.
        stable: (n,) whether the state is stable and on the branch of the reference.
    """

    bath: Array
    turgor: Array
    F: Array
    wall_stretch: Array
    elastic: Array
    stable: Flags

    @property
    def size(self) -> Array:
        """Length of a side over that of the reference, (n,): the root of the area."""
        return np.asarray(np.sqrt(np.linalg.det(self.F)))

    def rows(self) -> list[dict[str, Any]]:
        """Return the stable states, as tables have them."""
        rows = []
        for k in np.flatnonzero(self.stable):
            C = self.elastic[k]
            rows.append(
                {
                    "turgor": self.turgor[k],
                    "water potential": 0.0 - round(self.bath[k], _DIGITS),
                    "size": self.size[k],
                    "wall stretch": self.wall_stretch[k],
                    "Young's modulus along x": young(C, 0.0),
                    "Young's modulus along y": young(C, 90.0),
                    "Young's modulus at 45°": young(C, 45.0),
                    "shear modulus along the axes": shear_modulus(C, 0.0),
                    "shear modulus at 45°": shear_modulus(C, 45.0),
                    "Poisson's ratio along x": poisson(C, 0.0),
                    "bulk modulus": (C[0, 0] + C[0, 1] + C[1, 0] + C[1, 1]) / 4.0,
                }
            )
        return rows


def wilt(cell: CellParameters, points: int = POINTS) -> Wilting:
    """Compute states of equal steps in size from the reference to where the walls carry no turgor.

    Raises:
        InputError: fewer than two points, SPH fluid, whose pressure is not that of a solution,
            sap that cannot leave its cell, or a reference without a stable equilibrium.
    """
    if points < 2:
        raise InputError(f"points: {points}; wilting needs at least 2")
    if not cell.has_uniform_fluid:
        raise InputError(
            "cell.fluid: 'sph'; wilting needs the pressure of a solution: take fluid uniform"
        )
    if cell.sap_bulk_modulus > 0.0:
        raise InputError(
            f"cell.sap_bulk_modulus: {cell.sap_bulk_modulus}; cells that wilt lose water: it must "
            "be 0"
        )
    law = RveLaw(cell, initialisation="elastic")
    size = np.linspace(1.0, _limp_size(law), points)
    F, stable = _shapes(law, size)
    answer = law.respond(F, np.zeros_like(F), tangents=True)
    assert answer.tangents is not None
    known = answer.status == Status.OK
    if answer.left_bifurcation is not None:
        stable &= ~answer.left_bifurcation
    if not (stable & known)[0]:
        raise InputError("wilting: the reference itself has no stable equilibrium")
    by_F, _ = answer.tangents.cauchy(F, answer.stress)
    about = np.einsum("nijkm,nlm->nijkl", by_F, F)
    thickness = cell.tissue_thickness
    turgor = np.full(points, np.nan)
    walls = np.full(points, np.nan)
    turgor[known], walls[known] = _walls(law, F[known])
    return Wilting(
        bath=-np.trace(answer.stress, axis1=1, axis2=2) / 2.0 / thickness,
        turgor=turgor,
        F=F,
        wall_stretch=walls,
        elastic=np.array([voigt(moduli) for moduli in about]) / thickness,
        stable=stable & known & (turgor > 0.0),
    )


def _walls(law: RveLaw, F: Array) -> tuple[Array, Array]:
    """Return the turgor (n,) that walls carry at F, MPa, and the mean stretch of their springs."""
    seen = law.particles(F, np.zeros_like(F))
    carried = np.trace(seen.wall_stress, axis1=1, axis2=2) / 2.0 / law.cell.tissue_thickness
    return carried, seen.stretch.mean(axis=1)


def _limp_size(law: RveLaw) -> float:
    """Estimate the size at which walls carry next to no turgor, of a box that keeps its shape.

    There walls are nearly slack: repulsion between walls stretches them a little.
    """
    _, stretch = _walls(law, np.eye(2)[None])
    end = 1.0 / float(stretch[0])  # where all springs would have their rest length
    # three sizes for the parabola: the turgid one, and two on the way to that end
    sizes = np.array([1.0, 1.0 - 0.5 * (1.0 - end), 1.0 - 0.8 * (1.0 - end)])
    turgor, _ = _walls(law, sizes[:, None, None] * np.eye(2))
    # the turgor falls nearly as a parabola of the size
    roots = np.roots(np.polyfit(sizes, turgor, 2))
    real = roots.real[np.abs(roots.imag) < _SLACK]
    # a root counts only below the turgid size, and at most twice as far down as that end
    below = real[(real < 1.0) & (real > 2.0 * end - 1.0)]
    limp = float(below.max()) if below.size else end
    return 1.0 - (1.0 - _SLACK) * (1.0 - limp)


def _shapes(law: RveLaw, size: Array) -> tuple[Array, Flags]:
    """Find symmetric F (n, 2, 2) of these sizes whose stress is a pressure.

    Regular cells shrink evenly, by symmetry; the box of irregular ones changes its shape, too.

    Returns:
        F, and (n,) where it was found.
    """
    shape = np.zeros((len(size), 2))
    pressure = law.cell.fluid_density * law.cell.sound_speed**2
    F = size[:, None, None] * np.eye(2)
    even = np.zeros(len(size), dtype=np.bool_)
    # Newton's method for F = size · exp(shape): no difference of normal stresses, and no shear
    for _ in range(_TRIALS):
        answer = law.respond(F, np.zeros_like(F), tangents=True)
        assert answer.tangents is not None
        s = answer.stress
        rest = np.stack([s[:, 0, 0] - s[:, 1, 1], s[:, 0, 1] + s[:, 1, 0]], axis=1)
        even = np.abs(rest).max(axis=1) <= _EVEN * pressure  # NaN is not
        if even.all() or not np.isfinite(rest[0]).all():
            break
        by_F, _ = answer.tangents.cauchy(F, s)
        for k in np.flatnonzero(~even & np.isfinite(rest).all(axis=1)):
            # columns: by more length along x and less along y, and by shear
            stretching = np.diag([1.0, -1.0])
            shearing = np.array([[0.0, 1.0], [1.0, 0.0]])
            columns = []
            for change in (stretching, shearing):
                slope = np.einsum("ijkl,kl->ij", by_F[k], size[k] * change)
                columns.append([slope[0, 0] - slope[1, 1], slope[0, 1] + slope[1, 0]])
            matrix = np.array(columns).T
            shape[k] -= np.linalg.solve(matrix, rest[k])
            a, b = shape[k]
            F[k] = size[k] * scipy.linalg.expm(np.array([[a, b], [b, -a]]))
    return F, even


def _MPa(name: str) -> Quantity[Any]:
    """Make a column in MPa."""
    return Quantity(name, "MPa", ".3g")


COLUMNS: tuple[Quantity[Any], ...] = (
    _MPa("turgor"),
    _MPa("water potential"),
    Quantity("size", "", ".4f"),
    Quantity("wall stretch", "", ".4f"),
    _MPa("Young's modulus along x"),
    _MPa("Young's modulus along y"),
    _MPa("Young's modulus at 45°"),
    _MPa("shear modulus along the axes"),
    _MPa("shear modulus at 45°"),
    Quantity("Poisson's ratio along x", "", ".3g"),
    _MPa("bulk modulus"),
)


def wilting_study(
    cell: CellParameters,
    points: int = POINTS,
    *,
    progress: Callable[[float], None] = lambda done: None,
) -> Study:
    """Compute size and moduli against the turgor; see `wilt`."""
    rows = wilt(cell, points).rows()
    progress(1.0)
    turgor = np.array([row["turgor"] for row in rows])

    def curve(name: str, colour: int | None = None) -> Curve:
        """Make the curve of a column over the turgor."""
        return Curve(name, turgor, np.array([row[name] for row in rows]), colour=colour)

    label = "turgor (MPa)"
    moduli = [name for name in rows[0] if "modulus" in name and "bulk" not in name]
    along_x = "Young's modulus along x"
    along_y = "Young's modulus along y"
    if np.allclose(curve(along_x).y, curve(along_y).y, rtol=_SAME):
        moduli.remove(along_y)  # one curve would hide the other
    return Study(
        title="Wilting in a bath: size and drained moduli against the turgor that is left",
        panels=(
            Panel(label, "modulus (MPa)", tuple(curve(name) for name in moduli)),
            Panel(label, "size over that of the turgid tissue", (curve("size", 5),)),
        ),
        columns=2,
        table=Table(COLUMNS, rows),
    )
