"""What a study is given: the plant cell, sizes and meshes, and the folder that keeps its runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from surrofe2.base.errors import InputError
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.report.study import NamedCell
from validation.case import Case, Run

ROOT = Path(__file__).parents[1]
RECIPES = {"printed": "bending-bar.toml", "water": "bending-bar-water.toml"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a study is given.

    Attributes:
        of: the plant cell.
        out: folder of the study's files; `out`/curves keeps the curves of finished runs.
        sizes: plant cells across; None: as the study has it.
        meshes: elements a side; None: as the study has it.
        quick: less of ablation and worst-answer.
    """

    of: NamedCell
    out: Path
    sizes: tuple[int, ...] | None = None
    meshes: tuple[int, ...] | None = None
    quick: bool = False

    @property
    def asked(self) -> dict[str, Any]:
        """What the study's numbers depend on besides the cell."""
        return {"sizes": self.sizes, "meshes": self.meshes, "quick": self.quick}

    def recipe(self) -> Recipe:
        """The shipped recipe of the bar of this preset, its data set and surrogate in `out`.

        Raises:
            InputError: the plant cell has no shipped recipe.
        """
        if self.of.name not in RECIPES:
            raise InputError(f"--cell: {self.of.name}; it must be one of {', '.join(RECIPES)}")
        name = RECIPES[self.of.name]
        shipped = load_recipe(ROOT / "data" / name)
        samples, training, stem = shipped.samples, shipped.training, Path(name).stem
        if self.quick:
            samples, training = replace(samples, count=2048), replace(training, iterations=60)
            stem += "-quick"
        return replace(shipped, path=self.out / name).with_cell(
            samples=replace(samples, file=f"{stem}.h5"),
            training=training,
            training_file=f"{stem}-surrogate.h5",
        )

    def runs(self, cases: Iterable[Case]) -> list[Run]:
        """The runs of all cases; those whose curves are kept are not computed again."""
        cases, runs = list(cases), []
        for k, case in enumerate(cases):
            print(f"{k + 1} of {len(cases)}: {case.name}", flush=True)
            runs.append(case.compute_or_read(self.out / "curves"))
        return runs
