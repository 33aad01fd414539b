"""The full microscopic tissue: every particle of every plant cell, nothing homogenised.

Reading order: settings, layout (which particles there are), pair_lists (who may interact, how
strongly, and who does now); external_forces (prescribed motion, loads along the outline, rigid
bodies), kernels, dynamics (particles in motion); outline (of the mesh, and the tissue's own along
it), conditions (a problem made particles), relaxation (at rest without load, and the step that is
stable there), simulation (a run and its history).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.tissue.dynamics import TissueDynamics
    from surrofe2.tissue.layout import Tissue, make_tissue
    from surrofe2.tissue.relaxation import relax
    from surrofe2.tissue.settings import TissueSettings
    from surrofe2.tissue.simulation import ParticleFrames, TissueRun, TissueState, simulate_tissue

__getattr__, __dir__ = public_names(__name__)
