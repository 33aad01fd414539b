"""The full microscopic tissue: every particle of every plant cell, nothing homogenised.

settings       time step, accuracy, what is kept
layout         which particles there are, in tiles
pair_kinds     which of them interact
pair_lists     which of these are near each other now
kernels        forces, energy and one time step
dynamics       particles in motion
relaxation     the tissue at rest without load
history        what a run records, and what carries it on
simulation     a tissue under a load case
"""

from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.history import ParticleFrames, TissueRun, TissueState
from surrofe2.tissue.layout import Tissue, make_tissue
from surrofe2.tissue.relaxation import relax
from surrofe2.tissue.settings import TissueSettings
from surrofe2.tissue.simulation import simulate_tissue

__all__ = [
    "ParticleFrames",
    "Tissue",
    "TissueDynamics",
    "TissueRun",
    "TissueSettings",
    "TissueState",
    "make_tissue",
    "relax",
    "simulate_tissue",
]
