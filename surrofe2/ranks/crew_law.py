"""What the laws of a crew have in common: every rank has the law that they stand for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.ranks.crew import Crew
from surrofe2.rve.rve_law import RveLaw
from surrofe2.surrogate.surrogate_law import SurrogateLaw

Law = TypeVar("Law", RveLaw, SurrogateLaw)


class CrewLaw(Generic[Law]):
    """A law that every rank of a crew has.

    Attributes:
        law: that of rank 0.
        crew: of this very process.
    """

    def __init__(self, law: Law, crew: Crew) -> None:
        self.law: Law = law
        self.crew = crew
        self._number = crew.adopt(law)

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""
        return self.law.cell

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""
        return self.law.initialisation

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.law.density

    def everywhere(self, call: Callable[[Any], Any]) -> None:
        """Call a function of the law on every rank."""
        self.crew.everywhere(self._number, call)
