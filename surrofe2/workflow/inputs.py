"""The files that a run folder keeps so that the run can be repeated elsewhere.

They are the recipe as the run took it, its files of the mesh and of an image, and the surrogates
and tables that its law began with.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from surrofe2.recipe.recipe import CellName, Recipe
from surrofe2.store.run_folder import RECIPE, of_cell
from surrofe2.store.store import read_bytes

# The files of surrogates and tables among the inputs of a run; of several cells see `of_cell`.
SURROGATE = "surrogate.h5"
TABLES = "table-*.h5"
# Files of arrays beside a mesh in XDMF, which names them before a colon.
_ARRAYS = re.compile(rb"([^\s<>/:]+\.h5):")


def inputs_of(
    recipe: Recipe,
    kind: str,
    surrogates: Mapping[CellName, Path] = MappingProxyType({}),
    tables: Sequence[Path] = (),
) -> dict[str, bytes]:
    """Return the contents of the files from which a run can be repeated, by their names.

    Args:
        kind: name of the run's law.
        surrogates: files by name of the cell, instead of the recipe's.
        tables: files of tables that the run starts from.
    """
    files: dict[str, bytes] = {}
    mesh_file = None
    if recipe.mesh.file is not None:
        path = recipe.path.parent / recipe.mesh.file
        mesh_file = f"mesh{path.suffix}"
        files[mesh_file] = read_bytes(path)
        arrays = set(_ARRAYS.findall(files[mesh_file])) if path.suffix == ".xdmf" else ()
        for name in map(os.fsdecode, arrays):
            files[name] = read_bytes(path.parent / name)
    image_file = None
    if recipe.image is not None:
        path = recipe.path.parent / recipe.image.file
        image_file = f"image{path.suffix}"
        files[image_file] = read_bytes(path)
    learnt: dict[CellName, str] = {}
    if kind in ("cached", "surrogate"):
        for cell, study in recipe.studies().items():
            learnt[cell] = of_cell(SURROGATE, cell)
            files[learnt[cell]] = read_bytes(surrogates.get(cell) or study.training_path())
    for k, path in enumerate(tables):
        files[TABLES.replace("*", f"{k}")] = read_bytes(path)
    head = (
        "# The recipe of this run, defaults filled in: `surrofe2 run` with the folder repeats it.\n"
    )
    files[RECIPE] = f"{head}{recipe.to_toml(mesh_file, learnt, image_file)}".encode()
    return files
