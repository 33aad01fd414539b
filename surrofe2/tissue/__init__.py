"""The full microscopic tissue: every particle of every plant cell, nothing homogenised.

Reading order: settings, layout (which particles there are); pair_constants (who may interact, how
strongly), pair_lists (who does now); external_forces (prescribed motion, the outline, rigid
bodies), kernels, dynamics (particles in motion); conditions (a problem made particles), relaxation
(at rest without load, and the step that is stable there), history, simulation (a run).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.tissue.dynamics import TissueDynamics
    from surrofe2.tissue.history import ParticleFrames, TissueRun, TissueState
    from surrofe2.tissue.layout import Tissue, make_mixed_tissue, make_tissue
    from surrofe2.tissue.relaxation import relax
    from surrofe2.tissue.settings import TissueSettings
    from surrofe2.tissue.simulation import simulate_tissue

__getattr__, __dir__ = public_names(__name__)
