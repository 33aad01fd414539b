"""`surrofe2 ablation`: what each part of the surrogate buys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from surrofe2.cli.console import keeping, progress, say
from surrofe2.cli.options import RecipeFile, ReplaceFiles, Threads, integers

if TYPE_CHECKING:
    from surrofe2.recipe import Recipe
    from surrofe2.rve import RveLaw
    from surrofe2.stress_samples import StressSamples
    from surrofe2.studies.ablation import Row

_TEST_SEED = 987_654


def ablation(
    recipe: RecipeFile,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for figure and table.")],
    counts: Annotated[
        str, typer.Option(metavar="N,…", help="Numbers of RVE samples.")
    ] = "256,1024",
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep what an interrupted call has found.")
    ] = False,
    force: ReplaceFiles = False,
    threads: Threads = None,
) -> None:
    """The surrogate part by part, beside nearest neighbours, a Gaussian process and a table.

    Error against the number of RVE samples and against the cost of a query, for the recipe's plant
    cell, initialisation and range; all networks with the sizes and iterations of its
    [bold]\\[training][/bold].

    Example: [bold]surrofe2 ablation data/bending-bar.toml --out out/ablation[/bold]
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.io.files import write_json
    from surrofe2.recipe import load_recipe
    from surrofe2.report.study_files import check_free, write_study
    from surrofe2.rve import RveLaw
    from surrofe2.studies.ablation import compete, contenders
    from surrofe2.studies.ablation_table import describe

    study = load_recipe(recipe)
    numbers = tuple(sorted(set(integers("--counts", counts, least=64))))
    name = f"ablation-{study.preset}-{study.rve.initialisation}"
    if not (force or resume):
        check_free(out, name)
    use_threads(threads)
    kept = out / f"{name}.unfinished.json"
    identity = _identity(study, numbers)
    rows = _known(kept, identity) if resume else []
    law = RveLaw.from_settings(study.cell, study.rve)
    samples, test = _ask(law, study, max(numbers))
    steps = compete(
        law, samples, test, study.training, numbers,
        known={(row.contender, row.samples): row for row in rows},
    )  # fmt: skip
    found: list[Row] = []
    total = len(numbers) * len(contenders())
    again = f"surrofe2 ablation {recipe} --out {out} --counts {counts} --resume"
    with (
        keeping(f"the fits so far are kept; continue with: {again}"),
        progress("ablation", total, "fits") as report,
    ):
        for row in steps:
            found.append(row)
            record = {"identity": identity, "rows": [asdict(r) for r in found]}
            write_json(kept, record)
            report(len(found), f"{row.contender}, {row.samples} samples")
        report(total, "")
    described = describe(found, study.training, study.preset, name, identity)
    for path in write_study(out, described, study.cell, study.preset):
        say(str(path))
    kept.unlink(missing_ok=True)


def _ask(law: RveLaw, study: Recipe, most: int) -> tuple[StressSamples, StressSamples]:
    """Samples with tangents to learn from, and others to measure on."""
    from surrofe2.sampling import sample
    from surrofe2.stress_samples import StressSamples
    from surrofe2.studies.ablation import TEST_POINTS, ask_rve

    F, F_dot = sample(study.range, 0, 0)
    start = StressSamples(
        F=F, F_dot=F_dot, stress=F, status=F[:, 0, 0].astype("int8"), cell=study.cell,
        initialisation=study.rve.initialisation, range=study.range, seed=0,
        rest_length=law.rest_length,
    )  # fmt: skip
    samples = ask_rve(law, start, most, study.samples.seed)
    return samples, ask_rve(law, start, TEST_POINTS, _TEST_SEED)


def _identity(study: Recipe, numbers: tuple[int, ...]) -> dict[str, Any]:
    from surrofe2.io.files import plain

    named: dict[str, Any] = plain(
        {
            "fingerprint": study.cell.fingerprint,
            "rve": asdict(study.rve),
            "range": study.range.to_dict(),
            "training": study.training.to_dict(),
            "seed": study.samples.seed,
            "counts": numbers,
        }
    )
    return named


def _known(path: Path, identity: Mapping[str, Any]) -> list[Row]:
    from surrofe2.errors import FileError, MismatchError
    from surrofe2.io.files import read_json
    from surrofe2.studies.ablation import Row

    if not path.exists():
        return []
    stored = read_json(path)
    if stored.get("identity") != identity:
        raise MismatchError(f"{path}: of another recipe or other counts; leave out --resume")
    try:
        return [Row(**row) for row in stored["rows"]]
    except (KeyError, TypeError):
        raise FileError(f"{path}: not the rows of an ablation; delete it") from None
