"""The rounds of a refinement: what each found, and the file that keeps them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from surrofe2.io.files import check_same, read_json, remove, remove_tree, write_json
from surrofe2.recipe import Recipe
from surrofe2.report.tables import NONE, Quantity, percent
from surrofe2.workflow.run_lifecycle import time_text

ROUNDS, SURROGATE = "refine.json", "surrogate.safetensors"


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """A row of the table of rounds, of one cell.

    Attributes:
        cell: its name, "" of the only one.
        hits: share of the answers at kept steps that came from the surrogate.
        unknown: states at accepted steps that the surrogate could not answer, and audited ones
            over the tolerance.
        samples: valid ones that the surrogate was trained on.
        held_out: largest held-out RMS error of a stress component, relative to its spread.
        audit: 99 % quantile of the audited errors as a share of the spread of stress; None where
            nothing was audited.
        range: of the surrogate.
        added: samples taken in after the run.
        seconds: since the round began, with run, sampling and training.
    """

    round: int
    cell: str = ""
    hits: float
    unknown: int
    samples: int
    held_out: float
    audit: float | None
    tolerance: float
    range: dict[str, Any]
    added: int
    seconds: float

    @property
    def settled(self) -> bool:
        """Whether no state was unknown and the audit holds."""
        return self.unknown == 0 and (self.audit is None or self.audit <= self.tolerance)

    @property
    def sentence(self) -> str:
        """What became of the round."""
        of = self.cell and f"{self.cell}: "
        return (
            f"round {self.round}: {of}{100 * self.hits:.4g} % hits, {self.unknown} unknown states, "
            f"{self.added} samples added"
        )


QUANTITIES: tuple[Quantity[Round], ...] = (
    Quantity("round", "", "", lambda row: row.round),
    Quantity("cell", "", "", lambda row: row.cell or None),
    Quantity("hits", "", percent(".4g"), lambda row: row.hits),
    Quantity("unknown", "", "", lambda row: row.unknown),
    Quantity("samples", "", "", lambda row: row.samples),
    Quantity("held-out RMS", "", percent(".2g"), lambda row: row.held_out),
    Quantity(
        "audit 99 %",
        "",
        "",  # a column even where no round was audited
        lambda row: NONE if row.audit is None else percent(".2g")(row.audit),
    ),
    Quantity("time", "", time_text, lambda row: row.seconds),
)


def open_rounds(recipe: Recipe, parts: Iterable[str], out: Path, fresh: bool) -> list[Round]:
    """The finished rounds to go on from."""
    begun = out / ROUNDS
    if begun.exists() and not fresh:
        stored = read_json(begun)
        here, there = ({"--cell": names} for names in ([*parts], stored.get("cells", [""])))
        check_same(out, recipe.to_dict() | here, stored["recipe"] | there)
        return [Round(**row) for row in stored["rounds"]]
    remove(begun)  # first: its rounds are those that are there
    for folder in out.glob("round-*"):
        remove_tree(folder)
    for path in out.glob("surrogate*.safetensors"):
        remove(path)
    write_rounds(recipe, parts, out, [])
    return []


def write_rounds(recipe: Recipe, parts: Iterable[str], out: Path, done: list[Round]) -> None:
    """Write the rounds that are finished."""
    rounds = [asdict(row) for row in done]
    write_json(out / ROUNDS, {"recipe": recipe.to_dict(), "cells": [*parts], "rounds": rounds})
