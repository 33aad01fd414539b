"""Reads a mesh file in a process of its own, which may take so much memory and time.

    python -P -m surrofe2.store.mesh_reader FORMAT FILE MEMORY SECONDS

writes the mesh to standard output as NumPy archive, or one line to standard error. Its exit code
is then UNREADABLE where the file is not read and UNFIT where it is no mesh for us; any other means
that it did not come so far as to read the file. It imports of the package only what parses files.
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

UNREADABLE, UNFIT = 3, 4
_MOST_LABELS = 1000
"""Different numbers in an array of cells; one of more counts the cells."""


def read_by_meshio(kind: str, path: str) -> StoredMesh:
    """The mesh in a file of another format; whole numbers of its cells are labels of regions."""
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
    """The mesh of an XDMF file of several times, such as the fields of a run, and its labels."""
    import meshio

    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        _, _, data = reader.read_data(0)
    return meshio.Mesh(points, cells, cell_data=data)


def read(kind: str, path: str) -> bytes:
    """The mesh in a file: points, elements, notes, and what its names number."""
    if kind == "gmsh":
        stored = read_gmsh(path)
    elif kind == "abaqus":
        stored = read_abaqus(path)
    else:
        stored = read_by_meshio(kind, path)
    mesh = plane_mesh(stored)
    names = {"boundaries": [*mesh.boundaries], "regions": [*mesh.regions], "notes": mesh.notes}
    arrays: dict[str, Any] = {"points": mesh.points, "elements": mesh.elements}
    for group, named in (("boundaries", mesh.boundaries), ("regions", mesh.regions)):
        arrays |= {f"{group}.{k}": each for k, each in enumerate(named.values())}
    arrays["names"] = np.frombuffer(json.dumps(names).encode(), np.uint8)
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    return archive.getvalue()


def main() -> None:
    """Read what the command line names."""
    kind, path, memory, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    if hard == resource.RLIM_INFINITY:
        hard = int(seconds) + 1  # between the two its parent sees why it ended
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), hard))
    out, messages = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(2), "w", errors="replace")
    for stream in (1, 2):  # meshio, and HDF5, print what they think of a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    code = UNREADABLE
    try:
        content = read(kind, path)
    except MeshError as error:
        code, reason = UNFIT, str(error)
    except ImportError as error:
        code, reason = 1, str(error)
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
