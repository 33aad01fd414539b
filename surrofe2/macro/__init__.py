"""The bar on finite elements: any `StressLaw` below, Dormand–Prince 5(4) in time.

Reading order: mesh, selective_quadrature, internal_force (space); right_hand_side,
time_integration (time); recording, results, simulation (a run).
"""

from surrofe2.macro.results import Frames, MacroRun, MetRange
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.simulation import simulate
from surrofe2.macro.state import MacroState

__all__ = ["Frames", "MacroRun", "MacroSettings", "MacroState", "MetRange", "simulate"]
