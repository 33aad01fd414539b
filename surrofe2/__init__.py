"""surrofe2: how soft, wet tissue deforms, from its cells upward.

In reading order, which is the order of the data:

    plant_cell   the particles of one plant cell: walls, contacts, fluid
    rve          (F, Ḟ) in, stress out, by a periodic sample of cells put into its state
    sampling     which (F, Ḟ) to ask; StressSamples, the answers
    surrogate    a small network trained on them
    cache        the surrogate where it may be trusted, the RVE elsewhere
    macro        finite elements of any problem, which ask a stress law at their points
    stress_law   the hinge between them: respond(F, F_dot) -> StressResponse

Units are µm, µs, ng throughout, see `surrofe2.units`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.cache.cached_law import CachedLaw
    from surrofe2.displacement_curve import DisplacementCurve
    from surrofe2.errors import Surrofe2Error
    from surrofe2.io.surrogates import read_surrogate, write_surrogate
    from surrofe2.load_case import LoadCase
    from surrofe2.macro.mesh import Mesh
    from surrofe2.macro.problem import Problem
    from surrofe2.macro.settings import MacroSettings
    from surrofe2.macro.simulation import MacroRun, simulate
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.regional_law import RegionalLaw
    from surrofe2.rve.rve_law import RveLaw
    from surrofe2.sampling import SamplingRange, sample
    from surrofe2.stress_law import Status, StressLaw, StressResponse
    from surrofe2.stress_paths import StressPath, follow_path, oscillation, ramp_and_hold
    from surrofe2.stress_samples import StressSamples
    from surrofe2.surrogate.settings import TrainingSettings
    from surrofe2.surrogate.surrogate_law import SurrogateLaw
    from surrofe2.surrogate.training import train

__getattr__, __dir__ = public_names(__name__)
