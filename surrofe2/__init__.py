"""surrofe2: how soft, wet plant tissue deforms, from its cells upward.

Rooms in the order of the data; docs/architecture.md has all of them, with their files:

    plant_cell      the particles of one plant cell: walls, contacts, fluid
    rve             (F, Ḟ) in, stress out: a periodic patch of plant cells, brought to equilibrium
    surface         free sides of a tissue
    law             the hinge between the scales, respond(F, F_dot) -> StressResponse; its samples
    surrogate       a small network trained on samples, with a bound of its error
    cache           the surrogate, or a table, where its bound allows; RVEs elsewhere; audits
    problem         mesh, supports, loads and rigid bodies, at both scales
    macro           finite elements, whose stress at every quadrature point a law computes
    tissue          every particle of a whole tissue: the reference without homogenisation
    ranks, run      RVEs over MPI ranks; what all runs over time share
    store, recipe   files of results; a study in one TOML file
    workflow, cli   generate, train, run, compare: from Python and from the command line
    questions       moduli, memory and stability of a plant cell
    report          pictures, tables and the page of runs
    adapters        laws in FElupe and in preCICE's Micro Manager
    base            units, errors, settings, kernels, tensors, sampling of a range

`dir(surrofe2)` lists the public names; docs/howto/python.md shows them at work. Units are µm, µs
and ng throughout, see `surrofe2.base.units`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.problem.amplitude import (
        Constant as Constant,
        Pulse as Pulse,
        Ramp as Ramp,
        Sine as Sine,
        Table as Table,
    )
    from surrofe2.cache.cached_law import CachedLaw as CachedLaw
    from surrofe2.cache.settings import CacheSettings as CacheSettings
    from surrofe2.run.displacement_curve import (
        DisplacementCurve as DisplacementCurve,
        difference as difference,
    )
    from surrofe2.base.errors import (
        FileError as FileError,
        InputError as InputError,
        MismatchError as MismatchError,
        SimulationError as SimulationError,
        Surrofe2Error as Surrofe2Error,
    )
    from surrofe2.base.versions import report_versions as report_versions
    from surrofe2.store.samples import read_data_set as read_data_set
    from surrofe2.store.meshes import load_mesh as load_mesh
    from surrofe2.store.run_folder import read_run as read_run
    from surrofe2.store.surrogates import (
        read_surrogate as read_surrogate,
        write_surrogate as write_surrogate,
    )
    from surrofe2.problem.bar import LoadCase as LoadCase
    from surrofe2.problem.conditions import (
        BodyForce as BodyForce,
        Fixed as Fixed,
        Foundation as Foundation,
        InitialVelocity as InitialVelocity,
        PointForce as PointForce,
        PrescribedMotion as PrescribedMotion,
        Pressure as Pressure,
        Surface as Surface,
        Symmetry as Symmetry,
        Traction as Traction,
    )
    from surrofe2.macro.elements import points_by_region as points_by_region
    from surrofe2.problem.mesh import (
        Box as Box,
        Disc as Disc,
        HalfPlane as HalfPlane,
        NodeAt as NodeAt,
        rectangle as rectangle,
        with_boundaries as with_boundaries,
        with_regions as with_regions,
    )
    from surrofe2.problem.problem import Problem as Problem
    from surrofe2.macro.answer_error import answer_error as answer_error
    from surrofe2.macro.rest import Rest as Rest, find_rest as find_rest
    from surrofe2.macro.settings import MacroSettings as MacroSettings
    from surrofe2.macro.simulation import MacroRun as MacroRun, simulate as simulate
    from surrofe2.plant_cell.measurements import living_cell as living_cell
    from surrofe2.plant_cell.parameters import (
        CellParameters as CellParameters,
        LivingTissue as LivingTissue,
        sources as sources,
    )
    from surrofe2.recipe.recipe import load_recipe as load_recipe
    from surrofe2.law.regional_law import RegionalLaw as RegionalLaw
    from surrofe2.problem.rigid_bodies import (
        Circle as Circle,
        Corner as Corner,
        Plane as Plane,
        RigidBody as RigidBody,
    )
    from surrofe2.rve.parameter_gradients import (
        parameter_gradients as parameter_gradients,
        path_gradients as path_gradients,
    )
    from surrofe2.rve.rve_law import RveLaw as RveLaw
    from surrofe2.rve.settings import RveSettings as RveSettings
    from surrofe2.base.sampling import SamplingRange as SamplingRange, sample as sample
    from surrofe2.law.stress_law import (
        Status as Status,
        StressLaw as StressLaw,
        StressResponse as StressResponse,
        Tangents as Tangents,
        describe as describe,
    )
    from surrofe2.law.paths import (
        StressPath as StressPath,
        follow_path as follow_path,
        oscillation as oscillation,
        ramp_and_hold as ramp_and_hold,
    )
    from surrofe2.law.samples import StressSamples as StressSamples
    from surrofe2.surface.slab_law import SlabLaw as SlabLaw
    from surrofe2.surface.tabulated import (
        TabulatedSurface as TabulatedSurface,
        tabulate_surface as tabulate_surface,
    )
    from surrofe2.law.surface_law import (
        SurfaceLaw as SurfaceLaw,
        SurfaceResponse as SurfaceResponse,
    )
    from surrofe2.surrogate.settings import (
        CalibrationSettings as CalibrationSettings,
        TrainingSettings as TrainingSettings,
    )
    from surrofe2.surrogate.surrogate_law import SurrogateLaw as SurrogateLaw
    from surrofe2.surrogate.training import train as train
    from surrofe2.workflow.train import calibrate as calibrate
    from surrofe2.report.comparison import compare_runs as compare_runs
    from surrofe2.workflow.check import proposed_range as proposed_range
    from surrofe2.workflow.generate import sample_stress as sample_stress
    from surrofe2.workflow.grid import run_grid as run_grid
    from surrofe2.report.figures import (
        Colours as Colours,
        draw_cells as draw_cells,
        draw_scale_bar as draw_scale_bar,
        draw_tissue as draw_tissue,
        drawn_bodies as drawn_bodies,
        drawn_loads as drawn_loads,
        fields_at_rest as fields_at_rest,
    )
    from surrofe2.report.page import write_report as write_report
    from surrofe2.tissue.simulation import simulate_tissue as simulate_tissue
    from surrofe2.workflow.run import save_run as save_run
    from surrofe2.workflow.zoom import write_zoom as write_zoom, zoom_into as zoom_into

__getattr__, __dir__ = public_names(__name__)
