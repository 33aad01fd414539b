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
"""What fluid = "auto" means."""
FEWEST_VORONOI = 4
_ARRANGEMENT = ("arrangement", "cells", "arrangement_seed")
_UNIFORM = ("fluid", "sap_bulk_modulus")
_SHAPE = ("area_variation", "elongation", "elongation_direction")
_AS_LAID_OUT = {"area_variation": 0.0, "elongation": 1.0, "elongation_direction": 0.0}
LEAST_VARIATION = 0.1


def _constant(default: Any, unit: str, about: str, section: str = "6", **bounds: Any) -> Any:
    """A field whose source is a section of the paper, and after a colon what stands there."""
    source = f"{_PAPER}, section {section}" if section else about
    return setting(default, about, unit, source=source, **(bounds or {"above": 0.0}))


@dataclass(frozen=True, slots=True, kw_only=True)
class CellParameters:
    """Plant cells of an RVE: walls of bonded particles around fluid.

    One square plant cell unless `arrangement` says otherwise. The wall rest length is not among
    them: it follows from zero stress at F = I. `dataclasses.replace` keeps the fluid; with
    `fluid="auto"` it takes that of the new arrangement.
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
        for name in _SHAPE:
            if getattr(self, name) != _AS_LAID_OUT[name] and self.arrangement != "voronoi":
                raise InputError(
                    f"cell.{name}",
                    f"{getattr(self, name)}; with arrangement {self.arrangement} it must be "
                    f"{_AS_LAID_OUT[name]}",
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
        """The parameters called `name`, a key of `PRESETS`, with single fields changed.

        Living plant cells have a uniform fluid unless `fluid` is "sph", which has its own sound
        speed for the same turgor.
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
            usual = LIVING[name][0].parameters(**({} if fluid == "auto" else {"fluid": fluid}))
            return replace(usual, **{**changes, "fluid": usual.fluid})
        return replace(PRESETS[name], **{"fluid": "auto", **changes})

    @property
    def preset_name(self) -> str:
        """Name of the preset that it is, or that it has constants of its own, and fingerprint."""
        name = next((name for name, known in PRESETS.items() if known == self), "its own constants")
        return f"{name} ({self.fingerprint})"

    @property
    def symmetry(self) -> str:
        """Point group of the RVE: "D4", "D6" or "none"."""
        return SYMMETRIES[self.arrangement]

    @property
    def is_one_square(self) -> bool:
        """Whether the RVE is the paper's: one square plant cell."""
        return self.arrangement == "square" and self.cells == 1

    @property
    def has_uniform_fluid(self) -> bool:
        """Whether the fluid of a plant cell is one pressure and not SPH particles."""
        return self.fluid == "uniform"

    @property
    def fluid_density(self) -> float:
        """Mass of fluid per area of plant cells as they are laid out, ng/µm²."""
        return self.fluid_particle_mass * self.fluid_particles_per_side**2 / self.cell_side**2

    @property
    def fluid_particles(self) -> int:
        """SPH particles of a plant cell, of which Voronoi cells have more or less by their area.

        A hexagon has the next centred hexagonal number (19 for 16), which its symmetry D6 bears. A
        uniform fluid has none.
        """
        if self.has_uniform_fluid:
            return 0
        wanted = self.fluid_particles_per_side**2
        if self.arrangement != "hexagon":
            return wanted
        centred = (3 * k * (k + 1) + 1 for k in range(wanted))
        return min(centred, key=lambda number: abs(number - wanted))

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
        """What Voronoi cells are to be like."""
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
        """Mass of one cell in a tissue (the mean), shared wall particles counted once, ng."""
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

        `outer_wall` is not of the RVE.
        """
        values = asdict(self)
        del values["outer_wall"]
        if self.is_one_square:  # as before there were arrangements
            values = {k: v for k, v in values.items() if k not in _ARRANGEMENT}
        if not self.has_uniform_fluid:  # as before there was another fluid
            values = {k: v for k, v in values.items() if k not in _UNIFORM}
        if self.shape == AS_THEY_COME:  # as before cells could be shaped
            values = {k: v for k, v in values.items() if k not in _SHAPE}
        text = json.dumps({k: repr(v) for k, v in sorted(values.items())})
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LivingTissue:
    """What experiments tell of a parenchyma, in their units; docs/cells.md says how to read each.

    `parameters` translates. Masses, stiffnesses and the viscosity are those of a layer as thick as
    `CellParameters.tissue_thickness`; a stress in MPa does not depend on that thickness.
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
        """Constants of the square plant cell: docs/cells.md, “Translation”.

        Args:
            fluid: the sound speed follows from the turgor, and is lower with SPH particles.

        Raises:
            InputError: the walls alone weigh more than the tissue.
        """
        usual = CellParameters()
        side = self.cell_size
        thickness = usual.tissue_thickness
        springs = usual.wall_springs_per_side
        spring = side / springs
        cross_section = 2.0 * self.wall_thickness * thickness
        wall_particle = _WALL_DENSITY * cross_section * spring
        weight = 1e-6 * self.density * side**2 * thickness - (2 * springs - 1) * wall_particle
        tension = self.turgor * thickness * side
        carried = _CARRIED if fluid == "sph" else 1.0
        return replace(
            usual,
            cell_side=side,
            fluid_particle_mass=weight / usual.fluid_particles_per_side**2,
            wall_particle_mass=wall_particle,
            wall_stiffness=self.wall_modulus * cross_section / spring,
            repulsion_strength=_REPULSION * tension * spring**6,
            repulsion_cutoff=_CUTOFF * side,
            smoothing_length=_SMOOTHING * side,
            sound_speed=sqrt(tension * side / (carried * weight)) if weight > 0.0 else 1.0,
            fluid=fluid,
            viscosity=1e-3 * self.sap_viscosity * thickness,
        )


_WALL_DENSITY = 1.1e-3
"""Of a wet wall, ng/µm³: two thirds water, one third polysaccharides of 1500 kg/m³."""
_REPULSION = 1.2
_CUTOFF = 0.37
_SMOOTHING = 0.22
"""Contact force a spring's length away over the walls' tension; lengths over the side."""
_CARRIED = 1.1484
"""Turgor that the walls carry over c_s² times the mass of SPH fluid per area, at these three."""

_STORED = json.loads(files(__package__).joinpath("living_tissues.json").read_text("utf-8"))
LIVING: dict[str, tuple[LivingTissue, dict[str, str]]] = {
    name: (
        LivingTissue(**{key: entry["value"] for key, entry in entries.items()}),
        {key: entry["source"] for key, entry in entries.items()},
    )
    for name, entries in _STORED.items()
}
"""Parenchymas by the name of their preset, and the source of each measured value."""

PRESETS = {
    "printed": CellParameters(),
    "water": CellParameters(fluid_particle_mass=0.27),
    **{name: tissue.parameters() for name, (tissue, _) in LIVING.items()},
}


def sources(preset: str) -> dict[str, str]:
    """Where the constants of a preset come from, or the measurements that they follow from."""
    CellParameters.preset(preset)
    if preset in LIVING:
        return LIVING[preset][1]
    return {item.name: str(item.metadata["source"]) for item in fields(CellParameters)}
