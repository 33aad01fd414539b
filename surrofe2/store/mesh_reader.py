"""Reads a mesh file in a process of its own, whose memory and time are limited.

    python -P -m surrofe2.store.mesh_reader FORMAT FILE MEMORY SECONDS

writes the mesh to standard output as NumPy archive, or one line to standard error. Its exit code
is then UNREADABLE where the file is not read and UNFIT where it is no mesh for us; any other code
means that it ended before it could read the file. It imports only those parts of the package that
parse files.
"""

from __future__ import annotations

import io
import json
import os
import resource
import sys
from typing import Any

import numpy as np

from surrofe2.store.abaqus_file import read_abaqus
from surrofe2.store.gmsh_file import read_gmsh
from surrofe2.store.plane_mesh import (
    LINES,
    SURFACES,
    Label,
    MeshError,
    StoredMesh,
    numbered_groups,
    plane_mesh,
)

# Exit codes; Python itself ends with 1 or 2.
UNREADABLE = 3
UNFIT = 4
# Different numbers in an array of cells that are labels; an array of more numbers the cells.
_MOST_LABELS = 1000


def read_by_meshio(kind: str, path: str) -> StoredMesh:
    """Read a file of another format; whole numbers of its cells are labels of regions."""
    import meshio

    try:
        mesh = getattr(meshio, kind).read(path)
    except Exception:
        if kind != "xdmf":
            raise
        mesh = _first_of_series(path)
    blocks: dict[str, list[Any]] = {}
    offset: list[int] = []
    for block in mesh.cells:
        before = blocks.setdefault(block.type, [])
        offset.append(sum(map(len, before)))
        before.append(np.asarray(block.data, np.int64))
    stored = StoredMesh(
        np.asarray(mesh.points, np.float64),
        {kind: np.concatenate(parts) for kind, parts in blocks.items()},
    )
    if "pixel" in stored.cells:  # VTK's, whose third and fourth corners are exchanged
        pixels = stored.cells.pop("pixel")
        if "quad" not in stored.cells:
            stored.cells["quad"] = pixels[:, [0, 1, 3, 2]]
    arrays = {}
    for name, parts in mesh.cell_data.items():
        whole = [np.asarray(part) for part in parts]
        if name.startswith("vtk"):  # such as vtkOriginalCellIds
            continue
        if not all(part.ndim == 1 and part.dtype.kind in "iu" for part in whole):
            continue
        if len(np.unique(np.concatenate(whole))) <= _MOST_LABELS:
            arrays[name] = whole
    labels = []
    for name, parts in arrays.items():
        prefix = f"{name} " if len(arrays) > 1 else ""
        for block, begin, numbers in zip(mesh.cells, offset, parts, strict=True):
            dimension = 1 if block.type in LINES else 2
            kind = "quad" if block.type == "pixel" else block.type
            if kind in LINES or kind in SURFACES:
                for number in np.unique(numbers).tolist():
                    cells = begin + np.flatnonzero(numbers == number)
                    labels.append(Label(prefix, dimension, number, kind, cells))
    stored.groups = numbered_groups(labels)
    return stored


def _first_of_series(path: str) -> Any:
    """Read mesh and labels of an XDMF file of several times, such as the fields of a run."""
    import meshio

    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        _, _, data = reader.read_data(0)
    return meshio.Mesh(points, cells, cell_data=data)


def read(kind: str, path: str) -> bytes:
    """Return the mesh in a file as an archive.

    It has `points`, `elements`, the arrays of boundaries and regions by number, and their names and
    the notes as JSON.
    """
    if kind == "gmsh":
        stored = read_gmsh(path)
    elif kind == "abaqus":
        stored = read_abaqus(path)
    else:
        stored = read_by_meshio(kind, path)
    mesh = plane_mesh(stored)
    names = {"boundaries": [*mesh.boundaries], "regions": [*mesh.regions], "notes": mesh.notes}
    arrays: dict[str, Any] = {"points": mesh.points, "elements": mesh.elements}
    # by number: a name may have characters that an archive cannot have
    for k, ends in enumerate(mesh.boundaries.values()):
        arrays[f"boundaries.{k}"] = ends
    for k, members in enumerate(mesh.regions.values()):
        arrays[f"regions.{k}"] = members
    arrays["names"] = np.frombuffer(json.dumps(names).encode(), np.uint8)
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    return archive.getvalue()


def main() -> None:
    """Read the file that the command line names."""
    kind, path, memory, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if hard == resource.RLIM_INFINITY:
        hard = int(seconds) + 1  # between the two its parent sees why it ended
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), hard))
    # meshio, and HDF5, print what they think of a file: their output goes nowhere
    out = os.fdopen(os.dup(1), "wb")
    messages = os.fdopen(os.dup(2), "w", errors="replace")
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    code = UNREADABLE
    try:
        content = read(kind, path)
    except MeshError as error:
        code = UNFIT
        reason = str(error)
    except ImportError as error:  # meshio is not installed as it should be
        code = 1
        reason = str(error)
    except MemoryError:
        reason = f"reading it takes more than {int(memory) / 1e9:.3g} GB"
    except Exception as error:
        # meshio's errors are often without a word, such as those of second order in Medit files.
        reason = " ".join(str(error).split()) or "meshio cannot; try another format, such as .msh"
    except SystemExit:
        reason = "meshio ended"
    else:
        out.write(content)
        out.close()
        return
    messages.write(reason[:500])
    messages.close()
    os._exit(code)


if __name__ == "__main__":
    main()
