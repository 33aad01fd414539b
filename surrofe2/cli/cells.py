"""`surrofe2 moduli`, `cells` and `zoom`: what plant cells are like, and what they do in a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import unknown
from surrofe2.cli import console
from surrofe2.plant_cell.parameters import LIVING
from surrofe2.questions import cell_image as image_of
from surrofe2.questions import memory as memory_of
from surrofe2.questions import moduli as moduli_of
from surrofe2.questions import stability as stability_of
from surrofe2.questions import wilting as wilting_of
from surrofe2.report.study import NamedCell, Study, keep_study
from surrofe2.run.charts import encoded
from surrofe2.run.loop import Report
from surrofe2.rve import INITIALISATIONS
from surrofe2.store.labelled_image import LINE, Labels, read_labels
from surrofe2.store.labelled_surface import read_surface
from surrofe2.store.store import check_replaceable, keep, write_bytes, write_text
from surrofe2.workflow.laws import use_threads
from surrofe2.workflow.zoom import write_zoom, zoom_into


def moduli(
    cell: console.CellName = "printed",
    every: Annotated[
        bool,
        typer.Option(
            "--all", help="Also elastic and viscous matrices by each initialisation, N/m and MPa."
        ),
    ] = False,
    initialisation: Annotated[
        Literal["all", "cauchy-born", "elastic", "constrained-runs", "slow-manifold"] | None,
        typer.Option(metavar="NAME", help="As --all, by one: how RVEs begin."),
    ] = None,
    turgor: Annotated[
        float | None,
        typer.Option(metavar="MPa", help="Wanted turgor, at constant density."),
    ] = None,
    memory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also whether a cache on (F, Ḟ) is sound, by two histories that end in the same "
            "(F, Ḟ); figure, CSV and numbers in DIR.",
        ),
    ] = None,
    period: Annotated[
        float,
        typer.Option(metavar="µs", help="--memory: period of the fastest motion expected."),
    ] = memory_of.PERIOD,
    wilt: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also size and moduli against turgor as the tissue wilts in a bath; figure, CSV "
            "and numbers in DIR.",
        ),
    ] = None,
    stability: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also where the cell has a stable equilibrium; map, CSV and numbers in DIR.",
        ),
    ] = None,
    out: console.JsonFile = None,
    fresh: console.Fresh = False,
) -> None:
    """Compute what experiments on a tissue find: Young's modulus, shear modulus, Poisson's ratio.

    The moduli are those of a slow test of the tissue at rest, along the axes and at 45° to them,
    from the exact tangents of the stress at F = I, in MPa. Beside them stand the turgor, how far it
    stretches the walls, and the compression up to which the cells are stable. The turgor is the
    pressure that the tension of the walls carries; --turgor sets it at the density that the cell
    has.

    Example: surrofe2 moduli --cell apple --wilt out/wilting
    """
    of = NamedCell.of(cell)
    if turgor is not None:
        of = replace(of, cell=moduli_of.with_turgor(of.cell, turgor))

    names: tuple[str, ...] = ()
    if every or initialisation is not None:
        is_one = initialisation not in (None, "all")
        names = (str(initialisation),) if is_one else INITIALISATIONS
    make = partial(_moduli, of, names)
    identity = of.identity({"initialisations": list(names)})
    if out is not None and keep(out, identity, make, fresh=fresh)[1]:
        console.print_line(f"{out}: there already")
    else:
        if out is None:
            make()
        console.done(out, f"at rest, of {of}")
    ranges = {} if of.range is None else {of.name: of.range}
    stability_map = partial(stability_of.stability, of.cell, ranges=ranges)
    questions: tuple[tuple[str, Path | None, dict[str, Any], Callable[..., Study]], ...] = (
        ("memory", memory, {"period": period}, partial(memory_of.memory_study, of.cell, period)),
        ("wilting", wilt, {}, partial(wilting_of.wilting_study, of.cell)),
        ("stability", stability, {}, stability_map),
    )
    for name, folder, asked, ask in questions:
        if folder is None:
            continue
        with console.working(name, 1.0, "parts", "nothing was changed") as report:
            compute = partial(ask, progress=report)
            study, paths = keep_study(folder, name, of, asked, compute, fresh=fresh)
        files = f"{folder}: {', '.join(path.name for path in paths)}"
        if study is None:
            console.print_line(f"{files}, there already")
            continue
        console.show_table(f"{' '.join(study.title.split())}, {of}", study.table)
        for row in study.table.to_records():
            if "verdict" in row:
                console.print_line(row["verdict"])
        console.print_line(files)


def _moduli(of: NamedCell, names: tuple[str, ...]) -> dict[str, Any]:
    """Compute and show moduli, with matrices by these initialisations; return what a file keeps."""
    parts = 1 + len(names)
    matrices: dict[str, moduli_of.CellModuli] = {}
    with console.working("moduli", parts, "parts", "nothing was changed") as report:
        tests = moduli_of.experiment_table(of.cell)
        report(1, "")
        for name in names:
            matrices[name] = moduli_of.cell_moduli(of.cell, name)
            report(1 + len(matrices), "")
    sap = "undrained" if of.cell.sap_bulk_modulus > 0.0 else "drained"
    console.show_table(f"{of}, fluid {of.cell.fluid}, {sap}", tests)
    tables = moduli_of.moduli_tables(of.cell, matrices) if matrices else {}
    for title, table in tables.items():
        console.show_table(title, table)
    return {
        "fingerprint": of.cell.fingerprint,
        "experiment": tests.to_records(),
        "tables": {title: table.to_records() for title, table in tables.items()},
    }


def cells(
    image: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGE",
            help="TIFF, PNG or NPY whose pixels have the number of their cell, 0 between cells; or "
            "PLY of MorphoGraphX whose vertices have a label, in µm.",
        ),
    ],
    pixel: Annotated[
        float | None, typer.Option(metavar="µm", help="Side of a pixel; not of a PLY.")
    ] = None,
    line: Annotated[
        int, typer.Option(metavar="N", help="Most pixels across a line between cells.")
    ] = LINE,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="TISSUE.toml",
            help="Write the [cell] of a Voronoi RVE that is like the image, with a picture.",
        ),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Preset with the turgor and walls of the RVE: {', '.join(LIVING)}.",
        ),
    ] = "apple",
    number: Annotated[
        int, typer.Option("--cells", min=4, metavar="N", help="Plant cells in the RVE.")
    ] = 9,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Picture of the outlines; default: beside TISSUE.toml."),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Replace a recipe and a picture that are there.")
    ] = False,
) -> None:
    """Measure the cells of a labelled image, and write an RVE that is like them.

    Reports number, area, variation of areas, aspect ratio, direction and neighbours of the cells
    that lie whole within the image. Cells at its border, specks, pieces, holes and places where
    four cells meet are named. Lines of up to --line pixels between cells are divided among them;
    what is wider is a hole. A surface (PLY) is projected to a plane, and named or refused if it is
    curved; cells at its edge count as whole.
    --out corrects area_variation and elongation until the cells of the RVE at rest are like those
    of the image, and reports how near they come.

    Example: surrofe2 cells labels.tif --pixel 0.35 --out tissue.toml

    Next: surrofe2 moduli --cell tissue.toml
    """
    if out is not None:
        if out.suffix != ".toml":
            raise InputError(f"--out: {quoted(out.name)}; it must end in .toml")
        if preset not in LIVING:
            raise unknown(f"--preset: {quoted(preset)}", preset, "preset of living cells", LIVING)
        check_replaceable(out, "recipe that `cells` wrote", image_of.MARK)
        picture = picture or out.with_suffix(".png")
    if picture is not None:
        if picture.suffix.lower() != ".png":
            raise InputError(f"--picture: {quoted(picture.name)}; it must end in .png")
        if picture.exists() and image.exists() and picture.samefile(image):
            raise InputError(
                f"{picture}: the picture would replace the image; --picture names another file"
            )
    for path in (out, picture):
        if path is not None and path.exists() and not fresh:
            raise InputError(f"{path}: it is there; --fresh writes this one in its place")
    labels, pixel, remarks = _labels(image, pixel)
    of_image = image_of.measure_cells(labels, pixel, line)
    console.show_table(f"{image.name}, {pixel:.4g} µm per pixel", image_of.shapes_table(of_image))
    for remark in remarks:
        console.print_warning(remark)
    for remark in of_image.remarks():
        console.print_line(remark)
    what = f"{len(of_image.area)} cells measured"
    like = None
    if out is not None:
        with console.working("RVE", 1.0, "parts", "nothing was changed") as report:
            like = image_of.rve_like(of_image, preset, number, progress=lambda x: report(x, ""))
        console.show_table(f"RVE of {number} cells", like.table(of_image.shapes))
        for remark in like.remarks:
            console.print_warning(remark)
        what += f", an RVE of {number} like them"
    if picture is not None:
        write_bytes(picture, encoded(image_of.picture(of_image, like), "png"))
        what += f", picture {picture}"
    # the recipe comes last: where it is, the picture is
    if out is not None and like is not None:
        about = f"{len(of_image.area)} cells of {image.name}, {pixel:.4g} µm per pixel"
        write_text(out, image_of.section(like, about))
    console.done(out, what)


def _labels(path: Path, pixel: float | None) -> tuple[Labels, float, tuple[str, ...]]:
    """Return the labels of an image or a surface, the side of a pixel in µm, and remarks."""
    if path.suffix.lower() != ".ply":
        if pixel is None:
            raise InputError("--pixel: missing; an image needs the side of a pixel in µm")
        return read_labels(path), pixel, ()
    if pixel is not None:
        raise InputError(f"--pixel: {pixel:g}; a PLY is in µm: leave it out")
    surface = read_surface(path)
    return surface.labels, surface.pixel, surface.remarks


def zoom(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run or a rest.")],
    point: Annotated[
        list[str],
        typer.Option(
            metavar="X,Y", help="Position in the unloaded tissue, µm; may be given several times."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="The folder to write, of several points that of their folders zoom-X-Y; "
            "default: RUN/zoom-X-Y.",
        ),
    ] = None,
    form: console.PictureFormat = "png",
    threads: console.Threads = None,
) -> None:
    """Look into the plant cells of a run: the RVE at a point over time.

    RVEs, of cached runs too, are solved at the mean F and Ḟ of the element at the point, at the
    times of the run's fields. DIR receives zoom.png, zoom.csv (stretch and tension of walls,
    fluid pressure, area, contact pressure over time), fields.xdmf and, with a uniform fluid,
    plant-cells.xdmf for ParaView. Pressures are in MPa.

    Example: surrofe2 zoom out/cached --point 200,12.5 --point 400,12.5
    """
    use_threads(threads)
    points = [_point_of(text) for text in point]
    folders = [(run if out is None else out) / f"zoom-{x:g}-{y:g}" for x, y in points]
    if out is not None and len(points) == 1:
        folders = [out]
    into = folders[0] if len(folders) == 1 else folders[0].parent
    with console.working("zoom", float(len(points)), "parts", f"{into} may lack files") as report:
        report(0.0, "plant cells")
        looks = zoom_into(run, points)
        for k, (look, folder) in enumerate(zip(looks, folders, strict=True)):
            write_zoom(look, folder, _after(report, k), form=form)
    for look, folder in zip(looks, folders, strict=True):
        last = {name: values[-1] for name, values in look.extremes().items()}
        console.done(
            folder,
            f"element {look.element} at {len(look.t)} times; at the last wall stretch up "
            f"to {last['largest_wall_stretch']:.4g}, fluid pressure "
            f"{last['lowest_fluid_pressure_MPa']:.3g} to "
            f"{last['highest_fluid_pressure_MPa']:.3g} MPa",
        )


def _point_of(text: str) -> tuple[float, float]:
    """Read a position, X,Y in µm."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--point: {text!r}; it must be two numbers X,Y in µm") from None
    return x, y


def _after(report: Report, done: int) -> Report:
    """Return the report of one of several pieces of work, behind so many others."""
    return lambda share, note: report(done + share, note)
