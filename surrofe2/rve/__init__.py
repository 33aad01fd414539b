"""Representative volume elements: (F, Ḟ) in, stress out."""

from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import RveState
from surrofe2.rve.settings import INITIALISATIONS, SOLVERS, RveSettings

__all__ = ["INITIALISATIONS", "SOLVERS", "ReferenceState", "RveLaw", "RveSettings", "RveState"]
