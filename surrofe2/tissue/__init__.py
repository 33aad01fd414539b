"""The full microscopic tissue: every particle of every plant cell, nothing homogenised.

`make_tissue` repeats one plant cell; `simulate_tissue` relaxes it and moves it under a load case.
"""

from surrofe2.tissue.layout import Tissue, make_tissue
from surrofe2.tissue.motion import Motion
from surrofe2.tissue.relaxation import relax
from surrofe2.tissue.results import ParticleFrames, TissueRun, TissueState
from surrofe2.tissue.settings import TissueSettings
from surrofe2.tissue.simulation import simulate_tissue

__all__ = [
    "Motion",
    "ParticleFrames",
    "Tissue",
    "TissueRun",
    "TissueSettings",
    "TissueState",
    "make_tissue",
    "relax",
    "simulate_tissue",
]
