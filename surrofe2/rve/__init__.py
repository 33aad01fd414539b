"""Representative volume elements: (F, Ḟ) in, stress out.

In reading order: `settings`, `rve_law` (the law), `solve` (one call of it), `unit_cell` (what an
RVE is at rest), `rve_state` (the warm start, and what particles feel), `newton` (equilibria),
`constrained_runs` (the paper's iteration), `slow_manifold`, `continuation` (far loads, stability),
`tangents`, `parameter_gradients` (identification), `particles` (a look into RVEs),
`micro_integration` (the reference of all initialisations).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.plant_cell.arrangement import ReferenceState
    from surrofe2.rve.rve_law import RveLaw
    from surrofe2.rve.rve_state import RveState
    from surrofe2.rve.settings import INITIALISATIONS, SOLVERS, RveSettings

__getattr__, __dir__ = public_names(__name__)
