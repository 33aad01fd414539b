"""surrofe2: how soft, wet tissue deforms, from its cells upward.

In reading order, which is the order of the data:

    plant_cell   the particles of one plant cell: walls, contacts, fluid
    rve          (F, Ḟ) in, stress out, by a periodic sample of cells put into its state
    sampling     which (F, Ḟ) to ask; StressSamples, the answers
    surrogate    a small network trained on them
    cache        the surrogate where it may be trusted, the RVE elsewhere
    macro        finite elements of any problem, which ask a stress law at their points
    stress_law   the hinge between them: respond(F, F_dot) -> StressResponse

Every name that docs/usage.md uses from Python is here, `dir(surrofe2)` lists them. Units are µm,
µs, ng throughout, see `surrofe2.units`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.amplitude import Constant, Pulse, Ramp, Sine, Table
    from surrofe2.cache.cached_law import CachedLaw
    from surrofe2.cache.settings import CacheSettings
    from surrofe2.displacement_curve import DisplacementCurve, difference
    from surrofe2.errors import Surrofe2Error
    from surrofe2.io.data_sets import read_data_set
    from surrofe2.io.run_folder import read_run
    from surrofe2.io.surrogates import read_surrogate, write_surrogate
    from surrofe2.load_case import LoadCase
    from surrofe2.macro.conditions import (
        BodyForce,
        Fixed,
        Foundation,
        InitialVelocity,
        PrescribedMotion,
        Pressure,
        Surface,
        Symmetry,
        Traction,
    )
    from surrofe2.macro.discretisation import points_by_region
    from surrofe2.macro.mesh import Box, Disc, HalfPlane, Mesh
    from surrofe2.macro.problem import Problem
    from surrofe2.macro.quasi_static import find_rest
    from surrofe2.macro.settings import MacroSettings
    from surrofe2.macro.simulation import MacroRun, simulate
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.problem_sections import load_mesh
    from surrofe2.recipe import load_recipe
    from surrofe2.regional_law import RegionalLaw
    from surrofe2.rigid_bodies import Circle, Corner, Plane, RigidBody
    from surrofe2.rve.parameter_gradients import parameter_gradients, path_gradients
    from surrofe2.rve.rve_law import RveLaw
    from surrofe2.rve.settings import RveSettings
    from surrofe2.sampling import SamplingRange, sample
    from surrofe2.stress_law import Acceptance, Status, StressLaw, StressResponse, Tangents
    from surrofe2.stress_paths import StressPath, follow_path, oscillation, ramp_and_hold
    from surrofe2.stress_samples import StressSamples
    from surrofe2.surface.slab_law import SlabLaw
    from surrofe2.surface.tabulated import TabulatedSurface, tabulate_surface
    from surrofe2.surface_law import SurfaceLaw, SurfaceResponse
    from surrofe2.surrogate.settings import CalibrationSettings, TrainingSettings
    from surrofe2.surrogate.surrogate_law import SurrogateLaw
    from surrofe2.surrogate.training import train
    from surrofe2.workflow.calibrate import calibrate
    from surrofe2.workflow.comparison import compare_runs
    from surrofe2.workflow.generate import sample_stress
    from surrofe2.workflow.grid import run_grid
    from surrofe2.workflow.range import proposed_range
    from surrofe2.workflow.saved_run import save_run
    from surrofe2.workflow.zoom import write_zoom, zoom_into

__getattr__, __dir__ = public_names(__name__)
