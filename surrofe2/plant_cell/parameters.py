"""Every constant of the particle model of a plant cell, with unit and source."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields, replace
from importlib.resources import files
from math import isqrt, sqrt
from typing import Any

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import FORCE, LENGTH, MASS, NONE, STIFFNESS, TIME, VELOCITY
from surrofe2.plant_cell.tessellation import (
    AS_THEY_COME,
    Shape,
    Tessellation,
    make_tessellation,
)

_PAPER = "Ghysels et al. 2009, TW 550"

SYMMETRIES = {"square": "D4", "hexagon": "D6", "voronoi": "none"}
"""Arrangements of plant cells in an RVE, and the point group of each."""
FLUIDS = ("sph", "uniform")
USUAL_FLUID = {"square": "sph", "hexagon": "uniform", "voronoi": "uniform"}
"""Fluid that "auto" stands for in each arrangement."""
FEWEST_VORONOI = 4
"""Fewest Voronoi cells of an RVE; among fewer, some are neighbours of their own images."""
_ARRANGEMENT = ("arrangement", "cells", "arrangement_seed")
_UNIFORM = ("fluid", "sap_bulk_modulus")
_SHAPE = ("area_variation", "elongation", "elongation_direction")
"""Fields that a fingerprint leaves out where they are as before they existed."""
_AS_LAID_OUT = {"area_variation": 0.0, "elongation": 1.0, "elongation_direction": 0.0}
"""Values of the fields of a shape that leave Voronoi cells as they are laid out."""
LEAST_VARIATION = 0.1
"""Smallest variation of areas, beside 0, that can be asked for: not every seed comes below 0.06,
however often its points move to centroids."""


def _constant(default: Any, unit: str, about: str, section: str = "6", **bounds: Any) -> Any:
    """Make a field with its unit, its bounds and its source.

    Args:
        section: section of the paper, and after a colon what is printed there; empty: the constant
            is not of the paper.
        bounds: bounds as of `setting`; without any, the value must be positive.
    """
    source = f"{_PAPER}, section {section}" if section else about
    return setting(default, about, unit, source=source, **(bounds or {"above": 0.0}))


@dataclass(frozen=True, slots=True, kw_only=True)
class CellParameters:
    """Plant cells of an RVE: walls of bonded particles around fluid.

    One square plant cell unless `arrangement` says otherwise. The wall rest length is not among
    them: it follows from zero stress at F = I. `dataclasses.replace` keeps the fluid; with
    `fluid="auto"` it takes that of the new arrangement.

    Examples:
        >>> from surrofe2 import CellParameters
        >>> cell = CellParameters.preset("apple")
        >>> cell.cell_side  # µm
        150.0
        >>> print(f"{1e6 * cell.density / cell.tissue_thickness:.0f} kg/m³")
        860 kg/m³
        >>> stiffer = CellParameters.preset("apple", wall_stiffness=1.5 * cell.wall_stiffness)
        >>> print(f"{stiffer.wall_stiffness / cell.wall_stiffness:.1f}")
        1.5
    """

    cell_side: float = _constant(25.0, LENGTH, "side of a square with a plant cell's area")
    wall_springs_per_side: int = _constant(
        10, NONE, "wall springs on a side", "6: 11 particles a side", least=4
    )
    fluid_particles_per_side: int = _constant(
        4,
        NONE,
        "side of the square grid of a plant cell's fluid particles",
        "6: 16 SPH particles",
        least=1,
    )
    fluid_particle_mass: float = _constant(
        2.7,
        MASS,
        "mass of a fluid particle",
        "6, as printed; water fills 0.27 (preset `water`)",
    )
    wall_particle_mass: float = _constant(0.5, MASS, "mass of a wall particle")
    wall_stiffness: float = _constant(4000.0, STIFFNESS, "stiffness of a wall spring", "6 (eq. 1)")
    repulsion_strength: float = _constant(
        5e5, f"{FORCE} {LENGTH}⁶", "repulsion of walls by walls and fluid", "6 (eq. 2)"
    )
    repulsion_cutoff: float = _constant(10.0, LENGTH, "reach of the repulsion", "6 (eq. 2)")
    smoothing_length: float = _constant(
        5.5, LENGTH, "h of the SPH kernel, whose support is 2 h", "6 (eq. 5)"
    )
    sound_speed: float = _constant(
        50.0, VELOCITY, "sound speed of the fluid", "6 (eq. 9), where it is printed in µm/s"
    )
    viscosity: float = _constant(
        0.1,
        f"{MASS}/{TIME}",
        "dynamic viscosity of the fluid in the plane",
        "6: 1e-2 Pa s times 10 µm (eq. 8)",
        least=0.0,
    )
    wall_damping_ratio: float = _constant(
        1.0, NONE, "damping of the walls over critical damping", "6: critical (eq. 1)", least=0.0
    )
    contact_damping_ratio: float = _constant(
        1.0,
        NONE,
        "damping of contacts over critical damping",
        "2.1: critical (eq. 2)",
        least=0.0,
    )
    fluid: str = _constant(
        "auto",
        NONE,
        "SPH particles or one pressure for each plant cell; auto: by arrangement and preset",
        "",
        one_of=("auto", *FLUIDS),
    )
    sap_bulk_modulus: float = _constant(
        0.0,
        "MPa",
        "bulk modulus of sap that cannot leave its plant cell (water: 2200); 0: drained",
        "",
        least=0.0,
    )
    outer_wall: float = _constant(
        1.0,
        NONE,
        "stiffness, damping and mass of a tissue's outer walls over those of half an inner wall",
        "",
    )
    tissue_thickness: float = _constant(10.0, LENGTH, "divides a 2D stress to give MPa")
    arrangement: str = _constant(
        "square", NONE, "shape of an RVE's plant cells", "", one_of=tuple(SYMMETRIES)
    )
    cells: int = _constant(
        1, NONE, "plant cells per RVE, each of cell_side² µm² on average", "", least=1
    )
    arrangement_seed: int = _constant(1, NONE, "seed of the points of Voronoi cells", "", least=0)
    area_variation: float = _constant(
        0.0,
        NONE,
        "variation coefficient of the areas of Voronoi cells as laid out; 0: as they come",
        "",
        least=0.0,
        most=0.6,
    )
    elongation: float = _constant(
        1.0,
        NONE,
        "mean aspect ratio of Voronoi cells as laid out; 1: as they come",
        "",
        least=1.0,
        most=10.0,
    )
    elongation_direction: float = _constant(
        0.0, "°", "direction of the long axis from x to y", "", least=-180.0, most=180.0
    )

    def __post_init__(self) -> None:
        check_settings(self, "cell")
        if self.fluid == "auto":
            object.__setattr__(self, "fluid", USUAL_FLUID[self.arrangement])
        if self.sap_bulk_modulus > 0.0 and not self.has_uniform_fluid:
            raise InputError(
                "cell.sap_bulk_modulus",
                f"{self.sap_bulk_modulus}; with fluid sph it must be 0: take fluid uniform",
            )
        for name, usual in _AS_LAID_OUT.items():
            value = getattr(self, name)
            if value != usual and self.arrangement != "voronoi":
                raise InputError(
                    f"cell.{name}",
                    f"{value}; with arrangement {self.arrangement} it must be {usual}",
                )
        if 0.0 < self.area_variation < LEAST_VARIATION:
            raise InputError(
                "cell.area_variation",
                f"{self.area_variation}; it must be 0, or {LEAST_VARIATION} to 0.6",
            )
        if self.arrangement == "voronoi":
            is_allowed = self.cells >= FEWEST_VORONOI
            allowed = f"at least {FEWEST_VORONOI}"
        else:
            is_allowed = isqrt(self.cells) ** 2 == self.cells
            allowed = "a square number"
        if not is_allowed:
            raise InputError(
                "cell.cells",
                f"{self.cells}; with arrangement {self.arrangement} it must be {allowed}",
            )

    @classmethod
    def preset(cls, name: str, **changes: Any) -> CellParameters:
        """Return the parameters called `name`, a key of `PRESETS`, with single fields changed.

        Living plant cells have a uniform fluid unless `fluid` is "sph", which has its own sound
        speed for the same turgor.

        Raises:
            InputError: there is no such preset or field, or a value is out of bounds.
        """
        if not isinstance(name, str) or name not in PRESETS:
            raise InputError(
                "cell.preset", f"{quoted(name)}; it must be one of {', '.join(PRESETS)}"
            )
        known = {item.name for item in fields(cls)}
        for key in changes:
            if key not in known:
                raise InputError(f"cell.{key}", f"unknown; known are {', '.join(sorted(known))}")
        if name in LIVING:
            fluid = changes.get("fluid", "auto")
            tissue, _ = LIVING[name]
            usual = tissue.parameters() if fluid == "auto" else tissue.parameters(fluid)
            return replace(usual, **{**changes, "fluid": usual.fluid})
        # "auto" first, so that another arrangement among the changes brings its own fluid
        return replace(PRESETS[name], **{"fluid": "auto", **changes})

    @property
    def preset_name(self) -> str:
        """Name of the preset that these constants are, or "its own constants"; and fingerprint."""
        for name, preset in PRESETS.items():
            if preset == self:
                return f"{name} ({self.fingerprint})"
        return f"its own constants ({self.fingerprint})"

    @property
    def symmetry(self) -> str:
        """Point group of the RVE: "D4", "D6" or "none"."""
        return SYMMETRIES[self.arrangement]

    @property
    def is_one_square(self) -> bool:
        """True if the RVE is the paper's: one square plant cell."""
        return self.arrangement == "square" and self.cells == 1

    @property
    def has_uniform_fluid(self) -> bool:
        """True if the fluid of a plant cell is one pressure and not SPH particles."""
        return self.fluid == "uniform"

    @property
    def fluid_density(self) -> float:
        """Mass of fluid per area of plant cells as they are laid out, ng/µm²."""
        return self.fluid_particle_mass * self.fluid_particles_per_side**2 / self.cell_side**2

    @property
    def fluid_particles(self) -> int:
        """Number of SPH particles of a plant cell; 0 with a uniform fluid.

        Voronoi cells have this number on average. A hexagon has the nearest centred hexagonal
        number (19 for 16), for which there is a pattern with its symmetry D6.
        """
        if self.has_uniform_fluid:
            return 0
        wanted = self.fluid_particles_per_side**2
        if self.arrangement != "hexagon":
            return wanted
        centred_hexagonal = (3 * k * (k + 1) + 1 for k in range(wanted))
        return min(centred_hexagonal, key=lambda number: abs(number - wanted))

    @property
    def fluid_mass(self) -> float:
        """Mass of one SPH particle, ng: all arrangements hold the same fluid per area."""
        if self.arrangement != "hexagon" or self.has_uniform_fluid:
            return self.fluid_particle_mass
        return self.fluid_particle_mass * self.fluid_particles_per_side**2 / self.fluid_particles

    @property
    def spring_length(self) -> float:
        """Reference length of a wall spring on a square's side, µm."""
        return self.cell_side / self.wall_springs_per_side

    @property
    def shape(self) -> Shape:
        """Statistics that Voronoi cells are to have."""
        # without an elongation its direction makes no difference
        direction = self.elongation_direction if self.elongation > 1.0 else 0.0
        return Shape(self.area_variation, self.elongation, direction)

    @property
    def tessellation(self) -> Tessellation:
        """Polygons of the RVE's plant cells."""
        return make_tessellation(
            self.arrangement, self.cell_side, self.cells, self.arrangement_seed, self.shape
        )

    @property
    def mass(self) -> float:
        """Mean mass of a plant cell in a tissue, shared wall particles counted once, ng."""
        walls = self.tessellation.wall_particles(self.spring_length)
        fluid = self.fluid_density * self.cell_side**2
        if not self.has_uniform_fluid:
            fluid = self.fluid_particles * self.fluid_mass
        return walls * self.wall_particle_mass / self.cells + fluid

    @property
    def density(self) -> float:
        """Macroscopic density: mass per reference area, ng/µm² (section 6.2)."""
        return self.mass / self.cell_side**2

    @property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that two sets of parameters share if their RVEs are equal.

        Fields that came later are left out at the values that stand for the state before, so that
        files of that time still fit.
        """
        left_out = ["outer_wall"]  # no part of the RVE
        if self.is_one_square:
            left_out += _ARRANGEMENT
        if not self.has_uniform_fluid:
            left_out += _UNIFORM
        if self.shape == AS_THEY_COME:
            left_out += _SHAPE
        values = {}
        for name, value in sorted(asdict(self).items()):
            if name not in left_out:
                values[name] = repr(value)
        return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """Return all fields by name, for files."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LivingTissue:
    """Measurements of a parenchyma, in the units of experiments; docs/cells.md explains each.

    `parameters` translates them. The masses, stiffnesses and the viscosity that it returns are
    those of a layer as thick as `CellParameters.tissue_thickness`; a stress in MPa does not depend
    on that thickness.

    Examples:
        Small cells with thick walls, in the units of experiments:

        >>> from surrofe2 import LivingTissue
        >>> tissue = LivingTissue(
        ...     cell_size=60.0,  # µm
        ...     turgor=0.3,  # MPa
        ...     wall_modulus=200.0,  # MPa
        ...     wall_thickness=1.0,  # µm
        ...     sap_viscosity=2.0,  # mPa s
        ...     density=900.0,  # kg/m³
        ... )
        >>> cell = tissue.parameters()
        >>> print(f"{cell.wall_stiffness:.0f} µN/µm, {cell.density:.4f} ng/µm²")
        667 µN/µm, 0.0090 ng/µm²
    """

    cell_size: float = setting(
        unit=LENGTH, about="side of a square with a plant cell's area", above=0
    )
    turgor: float = setting(unit="MPa", about="pressure that the walls carry at rest", above=0)
    wall_modulus: float = setting(
        unit="MPa", about="modulus of a wall stretched by the turgor", above=0
    )
    wall_thickness: float = setting(
        unit=LENGTH, about="thickness of one plant cell's own wall", above=0
    )
    sap_viscosity: float = setting(
        unit="mPa s", about="viscosity of the fluid in a plant cell", above=0
    )
    density: float = setting(unit="kg/m³", about="density of the tissue", above=0)

    def __post_init__(self) -> None:
        check_settings(self, "tissue")

    def parameters(self, fluid: str = "uniform") -> CellParameters:
        """Return the constants of the square plant cell; see docs/cells.md, “Translation”.

        Args:
            fluid: "uniform" or "sph". The sound speed follows from the turgor, and is lower with
                SPH particles.

        Raises:
            InputError: the walls alone weigh more than the tissue.
        """
        usual = CellParameters()
        side = self.cell_size
        thickness = usual.tissue_thickness
        springs = usual.wall_springs_per_side
        spring = side / springs
        # a wall is that of two plant cells
        cross_section = 2.0 * self.wall_thickness * thickness
        wall_particle = WALL_DENSITY * cross_section * spring
        # two of the four walls of a square and one of its corners are its own; 1 kg/m³ is
        # 1e-6 ng/µm³
        fluid_mass = 1e-6 * self.density * side**2 * thickness - (2 * springs - 1) * wall_particle
        tension = self.turgor * thickness * side
        carried = _CARRIED if fluid == "sph" else 1.0
        # without fluid left, CellParameters rejects the mass; any sound speed does until then
        sound_speed = 1.0
        if fluid_mass > 0.0:
            sound_speed = sqrt(tension * side / (carried * fluid_mass))
        return replace(
            usual,
            cell_side=side,
            fluid_particle_mass=fluid_mass / usual.fluid_particles_per_side**2,
            wall_particle_mass=wall_particle,
            wall_stiffness=self.wall_modulus * cross_section / spring,
            repulsion_strength=_REPULSION * tension * spring**6,
            repulsion_cutoff=_CUTOFF * side,
            smoothing_length=_SMOOTHING * side,
            sound_speed=sound_speed,
            fluid=fluid,
            viscosity=1e-3 * self.sap_viscosity * thickness,
        )


WALL_DENSITY = 1.1e-3
"""Density of a wet wall, ng/µm³: two thirds water, one third polysaccharides of 1500 kg/m³."""
_REPULSION = 1.2
"""Contact force at the length of a spring, over the tension of the walls; it is not measured, but
plant cells are stable in the widest range of states with it (docs/cells.md)."""
_CUTOFF = 0.37
"""Reach of contacts, over the side of a plant cell."""
_SMOOTHING = 0.22
"""Smoothing length of SPH fluid, over the side of a plant cell."""
_CARRIED = 1.1484
"""Turgor that the walls carry over c_s² times the mass of SPH fluid per area, at these three."""


def _read_living_tissues() -> dict[str, tuple[LivingTissue, dict[str, str]]]:
    """Read the measurements of each living tissue, and the source of each value."""
    text = files(__package__).joinpath("living_tissues.json").read_text("utf-8")
    tissues = {}
    for name, entries in json.loads(text).items():
        values = {key: entry["value"] for key, entry in entries.items()}
        sources_of_values = {key: entry["source"] for key, entry in entries.items()}
        tissues[name] = LivingTissue(**values), sources_of_values
    return tissues


LIVING = _read_living_tissues()
"""Parenchymas by the name of their preset, and the source of each measured value."""

PRESETS = {
    "printed": CellParameters(),
    "water": CellParameters(fluid_particle_mass=0.27),
    **{name: tissue.parameters() for name, (tissue, _) in LIVING.items()},
}


def sources(preset: str) -> dict[str, str]:
    """Return the source of each constant of a preset, or of the measurements it is made of.

    Raises:
        InputError: there is no such preset.
    """
    CellParameters.preset(preset)  # refuses names that are unknown
    if preset in LIVING:
        _, sources_of_values = LIVING[preset]
        return sources_of_values
    return {item.name: str(item.metadata["source"]) for item in fields(CellParameters)}
