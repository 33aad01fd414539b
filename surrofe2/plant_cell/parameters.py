"""Every constant of the particle model of a plant cell, with unit and source."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields, replace
from math import isqrt
from typing import Any

from surrofe2.errors import InputError
from surrofe2.plant_cell.tessellation import Tessellation, make_tessellation
from surrofe2.settings import check_settings, setting
from surrofe2.units import FORCE, LENGTH, MASS, NONE, STIFFNESS, TIME, VELOCITY

_PAPER = "Ghysels et al. 2009, TW 550"

SYMMETRIES = {"square": "D4", "hexagon": "D6", "voronoi": "none"}
"""Arrangements of plant cells in an RVE, and the point group of each."""
FEWEST_VORONOI = 4
_ARRANGEMENT = ("arrangement", "cells", "arrangement_seed")


def _constant(default: Any, unit: str, source: str, **bounds: Any) -> Any:
    return setting(default, unit=unit, source=source, **(bounds or {"above": 0.0}))


@dataclass(frozen=True, slots=True, kw_only=True)
class CellParameters:
    """Plant cells of an RVE: walls of bonded particles around SPH fluid.

    One square plant cell unless `arrangement` says otherwise. The wall rest length is not among
    them: it follows from zero stress at F = I.
    """

    cell_side: float = _constant(25.0, LENGTH, f"{_PAPER}, section 6")
    wall_springs_per_side: int = _constant(
        10, NONE, f"{_PAPER}, section 6: 11 particles a side", least=4
    )
    fluid_particles_per_side: int = _constant(
        4, NONE, f"{_PAPER}, section 6: 16 SPH particles", least=1
    )
    fluid_particle_mass: float = _constant(
        2.7, MASS, f"{_PAPER}, section 6, as printed; water fills 0.27 (preset `water`)"
    )
    wall_particle_mass: float = _constant(0.5, MASS, f"{_PAPER}, section 6")
    wall_stiffness: float = _constant(4000.0, STIFFNESS, f"{_PAPER}, section 6 (eq. 1)")
    repulsion_strength: float = _constant(5e5, f"{FORCE} {LENGTH}⁶", f"{_PAPER}, section 6 (eq. 2)")
    repulsion_cutoff: float = _constant(10.0, LENGTH, f"{_PAPER}, section 6 (eq. 2)")
    smoothing_length: float = _constant(5.5, LENGTH, f"{_PAPER}, section 6 (eq. 5)")
    sound_speed: float = _constant(
        50.0, VELOCITY, f"{_PAPER}, section 6 (eq. 9), where it is printed in µm/s"
    )
    viscosity: float = _constant(
        0.1,
        f"{MASS}/{TIME}",
        f"{_PAPER}, section 6: 1e-2 Pa s times 10 µm (eq. 8)",
        least=0.0,
    )
    wall_damping_ratio: float = _constant(
        1.0, NONE, f"{_PAPER}, section 6: critical (eq. 1)", least=0.0
    )
    contact_damping_ratio: float = _constant(
        1.0, NONE, f"{_PAPER}, section 2.1: critical (eq. 2)", least=0.0
    )
    tissue_thickness: float = _constant(
        10.0, LENGTH, f"{_PAPER}, section 6; turns 2D stress into MPa"
    )
    arrangement: str = _constant(
        "square", NONE, "of an RVE's plant cells", one_of=tuple(SYMMETRIES)
    )
    cells: int = _constant(1, NONE, "plant cells of an RVE, of cell_side² µm² on average", least=1)
    arrangement_seed: int = _constant(1, NONE, "of Voronoi plant cells", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "cell")
        _check_arrangement(self.arrangement, self.cells)

    @classmethod
    def preset(cls, name: str, **changes: Any) -> CellParameters:
        """The parameters called `name` ("printed" or "water"), with single fields changed."""
        if name not in PRESETS:
            raise InputError(f"cell.preset: {name!r}; it must be one of {', '.join(PRESETS)}")
        known = {item.name for item in fields(cls)}
        for key in changes:
            if key not in known:
                raise InputError(f"cell.{key}: unknown; known are {', '.join(sorted(known))}")
        return replace(PRESETS[name], **changes)

    @property
    def symmetry(self) -> str:
        """Point group of the RVE: "D4", "D6" or "none"."""
        return SYMMETRIES[self.arrangement]

    @property
    def is_one_square(self) -> bool:
        """Whether the RVE is the paper's: one square plant cell."""
        return self.arrangement == "square" and self.cells == 1

    @property
    def fluid_particles(self) -> int:
        """Fluid particles of a plant cell, of which Voronoi cells have more or less by their area.

        A hexagon has the next centred hexagonal number (19 for 16), which its symmetry D6 bears.
        """
        wanted = self.fluid_particles_per_side**2
        if self.arrangement != "hexagon":
            return wanted
        centred = (3 * k * (k + 1) + 1 for k in range(wanted))
        return min(centred, key=lambda number: abs(number - wanted))

    @property
    def fluid_mass(self) -> float:
        """Mass of one fluid particle, ng: all arrangements hold the same fluid per area."""
        if self.arrangement != "hexagon":
            return self.fluid_particle_mass
        return self.fluid_particle_mass * self.fluid_particles_per_side**2 / self.fluid_particles

    @property
    def spring_length(self) -> float:
        """Reference length of a wall spring on a square's side, µm."""
        return self.cell_side / self.wall_springs_per_side

    @property
    def tessellation(self) -> Tessellation:
        """Polygons of the RVE's plant cells."""
        return make_tessellation(
            self.arrangement, self.cell_side, self.cells, self.arrangement_seed
        )

    @property
    def mass(self) -> float:
        """Mass of one cell in a tissue (the mean), shared wall particles counted once, ng."""
        walls = self.tessellation.wall_particles(self.spring_length)
        fluid = self.fluid_particles * self.cells
        return (walls * self.wall_particle_mass + fluid * self.fluid_mass) / self.cells

    @property
    def density(self) -> float:
        """Macroscopic density: mass per reference area, ng/µm² (section 6.2)."""
        return self.mass / self.cell_side**2

    @property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that two equal sets of parameters share and no others."""
        values = asdict(self)
        if self.is_one_square:  # as before there were arrangements
            values = {k: v for k, v in values.items() if k not in _ARRANGEMENT}
        text = json.dumps({k: repr(v) for k, v in sorted(values.items())})
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)


def _check_arrangement(arrangement: str, cells: int) -> None:
    if arrangement == "voronoi" and cells < FEWEST_VORONOI:
        raise InputError(
            f"cell.cells: {cells}; with arrangement voronoi it must be at least {FEWEST_VORONOI}"
        )
    if arrangement != "voronoi" and isqrt(cells) ** 2 != cells:
        raise InputError(
            f"cell.cells: {cells}; with arrangement {arrangement} it must be a square number"
        )


PRESETS = {
    "printed": CellParameters(),
    "water": CellParameters(fluid_particle_mass=0.27),
}
