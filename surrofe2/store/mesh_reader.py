"""Reads a mesh by meshio in a process of its own, which may take so much memory and time.

    python -P mesh_reader.py FORMAT FILE MEMORY SECONDS

writes points, cells, groups and tags to standard output as NumPy archive; one line to standard
error where it cannot. It imports nothing of the package, so that it starts soon.
"""

import io
import json
import os
import resource
import sys
from typing import Any

import meshio
import numpy as np


def read(kind: str, path: str) -> bytes:
    """The content of a mesh file; `names` is JSON: kinds of cells, sets, and tags by name."""
    mesh = getattr(meshio, kind).read(path)
    sets = {k: v for k, v in mesh.cell_sets.items() if not k.startswith("gmsh:")}
    tags = mesh.cell_data.get("gmsh:physical", [])
    arrays: dict[str, Any] = {"points": np.asarray(mesh.points, np.float64)}
    for k, block in enumerate(mesh.cells):
        arrays[f"cells.{k}"] = np.asarray(block.data, np.int64)
    for k, values in enumerate(tags):
        arrays[f"tags.{k}"] = np.asarray(values, np.int64)
    for k, parts in enumerate(sets.values()):
        for j, part in enumerate(parts):
            arrays[f"sets.{k}.{j}"] = np.asarray([] if part is None else part, np.int64)
    groups = {name: [int(tag), int(dim)] for name, (tag, dim) in mesh.field_data.items()}
    names = [[block.type for block in mesh.cells], list(sets), bool(len(tags)), groups]
    arrays["names"] = np.frombuffer(json.dumps(names).encode(), np.uint8)
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    return archive.getvalue()


def main() -> None:
    """Read what the command line names."""
    kind, path, memory, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 1))
    out, told = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(2), "w", errors="replace")
    for stream in (1, 2):  # meshio, and HDF5, print what they think of a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    try:
        content = read(kind, path)
    except MemoryError:
        reason = f"reading it takes more than {int(memory) / 1e9:.3g} GB"
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
    except SystemExit:
        reason = "meshio ended"
    else:
        out.write(content)
        out.close()
        return
    told.write(reason[:500])
    told.close()
    os._exit(1)


if __name__ == "__main__":
    main()
