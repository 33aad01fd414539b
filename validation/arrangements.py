"""`python -m validation.arrangements`: what docs/validation/arrangements.md states.

Writes `arrangements.json` and `arrangements.png`.
"""

from __future__ import annotations

import argparse
import json
from functools import cache, partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from benchmarks.timing import side_by_side, threads
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.arrangement import make_arrangement, start_positions
from surrofe2.plant_cell.block_pattern import Pattern, factorisation_work, make_pattern
from surrofe2.plant_cell.pair_lists import interacting_groups, make_patches
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.rve.block_lu import factorise, solve
from surrofe2.rve.unit_cell import SAME_ENERGY, Equilibria, equilibria_in

SHOWN = (("square", 1), ("square", 9), ("hexagon", 9), ("voronoi", 9))
LADDER = (
    ("square", 1), ("hexagon", 1), ("square", 4), ("voronoi", 4), ("hexagon", 4), ("voronoi", 6),
    ("square", 9), ("voronoi", 9), ("hexagon", 9),
)  # fmt: skip
POINTS, SIZE, RATE = 16, 0.02, 0.005


@cache
def law(preset: str, arrangement: str, cells: int, initialisation: str) -> RveLaw:
    """An RVE, its reference found once."""
    cell = CellParameters.preset(preset, arrangement=arrangement, cells=cells)
    return RveLaw(cell, initialisation=initialisation)


def deformations() -> tuple[np.ndarray, np.ndarray]:
    """F with entries within SIZE of I, and Ḟ within RATE."""
    rng = np.random.default_rng(0)
    F = np.eye(2) + SIZE * rng.uniform(-1.0, 1.0, (POINTS, 2, 2))
    return F, RATE * rng.uniform(-1.0, 1.0, (POINTS, 2, 2))


def squares(preset: str) -> dict[str, float]:
    """Largest difference of stress from one square, µN/µm, by the number of squares."""
    F, F_dot = deformations()
    one = law(preset, "square", 1, "constrained-runs").respond(F, F_dot).stress
    return {
        str(n): float(
            np.abs(
                law(preset, "square", n, "constrained-runs").respond(F, F_dot).stress - one
            ).max()
        )
        for n in (4, 9)
    }


def equilibria(preset: str, arrangement: str, cells: int) -> dict[str, Any]:
    """Distinct stable equilibria at the reference's l₀ and box, from fluid put at random."""
    this = law(preset, arrangement, cells, "constrained-runs")
    box = this.reference.lattice
    starts = [start_positions(this.cell, k, at_random=True) for k in range(2 * TILE)]
    found = equilibria_in(this.cell, box, this.rest_length, np.array(starts))
    chosen = distinct(found)
    stress = found.stress[chosen]
    apart = np.abs(stress[:, None] - stress).max(initial=0.0)
    return {
        "starts": len(starts),
        "stable": int(found.stable.sum()),
        "distinct": len(chosen),
        "largest_stress": float(np.abs(stress).max(initial=0.0)),
        "stresses_apart": float(apart),
        "energies": [float(e) for e in found.energy[chosen]],
    }


def distinct(equilibria: Equilibria) -> list[int]:
    """One of each group of stable equilibria of one energy, by rising energy."""
    chosen: list[int] = []
    for k in np.argsort(np.where(equilibria.stable, equilibria.energy, np.inf), kind="stable"):
        if not equilibria.stable[k]:
            break
        energy = equilibria.energy[k]
        if not chosen or energy - equilibria.energy[chosen[-1]] > SAME_ENERGY * abs(energy):
            chosen.append(int(k))
    return chosen


def cauchy_born(preset: str, arrangement: str, cells: int) -> dict[str, float]:
    """Errors of Cauchy–Born, relative to the elastic stress; at Ḟ = 0."""
    F, _ = deformations()
    still = np.zeros_like(F)
    affine, elastic = (
        law(preset, arrangement, cells, name).respond(F, still)
        for name in ("cauchy-born", "elastic")
    )
    both = (affine.status == 0) & (elastic.status == 0)
    error = np.linalg.norm((affine.stress - elastic.stress)[both], axis=(1, 2))
    size = np.linalg.norm(elastic.stress[both], axis=(1, 2))
    return {
        "rms": float(np.sqrt((error**2).mean() / (size**2).mean())),
        "worst": float(error.max() / size.max()),
        "rms_stress": float(np.sqrt((size**2).mean())),
        "points": int(both.sum()),
    }


def factorisations(repeats: int) -> list[dict[str, Any]]:
    """Seconds of one factorisation and one solution of a tile, in one group and in several."""
    rows = []
    for arrangement, cells in LADDER:
        cell = CellParameters(arrangement=arrangement, cells=cells)
        made = make_arrangement(cell)
        patches = make_patches(cell, start_positions(cell), made.tessellation.lattice)
        topology = patches[-1].topology
        owner = np.append(np.arange(made.particles, dtype=np.int32), topology.owner)
        sparse = make_pattern(*interacting_groups(made, owner[topology.contacts]))
        dense = make_pattern(np.zeros(made.particles, dtype=np.int32), [])
        unknowns = 2 * made.particles - 2
        rng = np.random.default_rng(1)
        patterns = (dense, sparse)
        sources = [_dominant(pattern, rng, 50.0 * np.sqrt(unknowns)) for pattern in patterns]
        lu = [source.copy() for source in sources]

        def renew(lu: np.ndarray, pattern: Pattern, source: np.ndarray) -> None:
            lu[:] = source
            factorise(lu, pattern, False)

        renewed = side_by_side(
            [partial(renew, *k) for k in zip(lu, patterns, sources, strict=True)], repeats
        )
        right = rng.normal(size=(unknowns, TILE))

        def solved_by(kept: np.ndarray, pattern: Pattern, right: np.ndarray) -> None:
            solve(kept, right.copy(), pattern)

        solved = side_by_side(
            [
                partial(solved_by, m.astype(np.float32), p, right)
                for m, p in zip(lu, patterns, strict=True)
            ],
            3 * repeats,
        )
        rows.append(
            {
                "arrangement": arrangement,
                "cells": cells,
                "particles": made.particles,
                "work": factorisation_work(sparse) / (unknowns**3 / 3.0),
                "memory": sparse.size / unknowns**2,
                "factorise": [min(t.samples) for t in renewed],
                "solve": [min(t.samples) for t in solved],
            }
        )
        print(rows[-1], flush=True)
    return rows


def _dominant(pattern: Pattern, rng: np.random.Generator, least: float) -> np.ndarray:
    """Random values (size, TILE) with a large diagonal."""
    values = rng.normal(size=(pattern.size, TILE))
    for i in range(1, len(pattern.group)):
        g = pattern.group[i]
        column, width = pattern.column[i], pattern.width[g]
        at = pattern.start[g] + column * width + pattern.offset[g, g] + column
        values[at] -= least
        values[at + width + 1] -= least
    return values


def picture(preset: str, path: Path) -> None:
    """The relaxed references with the copies around them, and the periodic boxes."""
    mpl.use("Agg")
    figure = Figure(figsize=(9.0, 2.7), layout="constrained")
    for axes, (arrangement, cells) in zip(figure.subplots(1, len(SHOWN)), SHOWN, strict=True):
        unit = law(preset, arrangement, cells, "constrained-runs").unit_cell
        patch = unit.patches[0]
        images = unit.position[patch.topology.owner] + patch.shift @ patch.lattice.T
        local = np.concatenate([unit.position, images])
        bonds, fluid = local[patch.topology.bonds], unit.position[patch.topology.walls :]
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ patch.lattice.T
        for a in range(-3, 4):
            for b in range(-3, 4):
                shift = patch.lattice @ (a, b)
                axes.add_collection(LineCollection(list(bonds + shift), colors="C2", lw=1.0))
                axes.plot(*(fluid + shift).T, ".", color="C0", ms=1.5)
        axes.plot(*corners.T, "--", color="C3", lw=0.9)
        axes.set_title(
            f"{cells} {arrangement}, {len(unit.position)} particles\n"
            f"l₀ = {unit.rest_length:.3f} µm",
            fontsize=8,
        )
        middle, half = corners[:4].mean(axis=0), 20.0 * np.sqrt(cells) + 5.0
        axes.set_xlim(middle[0] - half, middle[0] + half)
        axes.set_ylim(middle[1] - half, middle[1] + half)
        axes.set_aspect("equal")
        axes.tick_params(labelsize=6)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m validation.arrangements", description=__doc__)
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/arrangements"))
    parser.add_argument("--preset", choices=("printed", "water"), default="printed")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    preset = given.preset
    report: dict[str, Any] = {"preset": preset, "squares": squares(preset)}
    print(report, flush=True)
    with threads(1):
        report["factorisations"] = factorisations(5)
    many = (("square", 1), ("hexagon", 1), ("hexagon", 4), ("voronoi", 9))
    report["cauchy_born"] = {f"{n} {a}": cauchy_born(preset, a, n) for a, n in many}
    print(report["cauchy_born"], flush=True)
    picture(preset, given.out / "arrangements.png")
    report["equilibria"] = {f"{n} {a}": equilibria(preset, a, n) for a, n in many}
    print(report["equilibria"], flush=True)
    path = given.out / "arrangements.json"
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(f"{path}, {given.out / 'arrangements.png'}")


if __name__ == "__main__":
    main()
