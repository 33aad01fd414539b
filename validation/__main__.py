"""`python -m validation NAME`: a study of the package against itself or the full tissue."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path

from surrofe2.base.errors import Surrofe2Error
from surrofe2.report.study import NamedCell, Study, keep_study
from validation.case import Setting

STUDIES: Mapping[str, tuple[str, str, str]] = {
    "fig5": ("rve", "figure_5", "stress of one RVE over shear steps, by each initialisation"),
    "fig6": ("rve", "figure_6", "mean force and error of the state over iterations"),
    "fig8": ("bars", "figure_8", "the bending bar by each initialisation against the full tissue"),
    "rates": ("rve", "rates", "error of each initialisation as the rate goes down"),
    "scales": ("bars", "scales", "slow manifold against full tissues of more and more plant cells"),
    "problems": ("tissues", "problems", "strip, block between plates and skin against tissues"),
    "irregular-tissue": (
        "irregular_tissue",
        "irregular_tissue",
        "Voronoi cells and squares with a uniform fluid",
    ),
    "thin": ("tissues", "thin", "thin tissue with and without the surface law of its free sides"),
    "arrangements": ("arrangements", "arrangements", "irregular cells: equilibria, Cauchy–Born"),
    "irregular": ("irregular", "irregular", "moduli over the plant cells of an RVE, both fluids"),
    "wilting": ("wilting", "wilting", "moduli of wilting tissue against published tests"),
    "locking": ("locking", "locking", "elements of nearly incompressible tissue"),
    "branches": ("branches", "branches", "irregular cells: states that leave their branch"),
    "ablation": ("ablation", "ablation", "what each part of the surrogate is worth"),
    "worst-answer": ("worst_answer", "worst_answer", "the worst states that the cache accepts"),
}
"""By name: module, function, and what it shows. `make paper` has the first four."""


def numbers(text: str) -> tuple[int, ...]:
    """Positive integers between commas."""
    found = tuple(int(part) for part in text.split(","))
    if min(found) < 1:
        raise ValueError(text)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """0, or 1 where the study cannot be made."""
    listed = "\n".join(f"  {name:13} {line}" for name, (_, _, line) in STUDIES.items())
    parser = argparse.ArgumentParser(
        prog="python -m validation",
        description=f"{__doc__}\n\nStudies:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", nargs="?", choices=STUDIES)
    parser.add_argument("--cell", default="printed", help="preset or recipe; default: printed")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("out/validation"))
    parser.add_argument("--sizes", type=numbers, metavar="N,…", help="plant cells across")
    parser.add_argument(
        "--meshes", type=numbers, metavar="N,…", help="elements per side; of thin: bars of N × N"
    )
    parser.add_argument("--quick", action="store_true", help="less of ablation and worst-answer")
    parser.add_argument("--fresh", action="store_true", help="replace what is there")
    given = parser.parse_args(arguments)
    if given.name is None:
        print(f"python -m validation NAME, one of\n\n{listed}")
        return 0
    try:
        setting = Setting(
            of=NamedCell.of(given.cell),
            out=given.out,
            sizes=given.sizes,
            meshes=given.meshes,
            quick=given.quick,
        )
        module, function, _ = STUDIES[given.name]
        make: Callable[[Setting], Study] = getattr(import_module(f"validation.{module}"), function)
        study, paths = keep_study(
            given.out, given.name, setting.of, setting.asked, lambda: make(setting),
            fresh=given.fresh,
        )  # fmt: skip
    except Surrofe2Error as error:
        print(f"error: {error}")
        return 1
    if study is not None:
        print(study.table.to_markdown())
    print(", ".join(str(path) for path in paths), "" if study is not None else "there already")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
