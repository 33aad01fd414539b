"""Meshes from files: read in a process of its own, since libraries trust what they read."""

from __future__ import annotations

import io
import json
import logging
import os
import resource
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import skfem

from surrofe2.base.arrays import Index
from surrofe2.base.errors import FileError, InputError, shortened
from surrofe2.base.units import with_micro_sign
from surrofe2.problem.mesh import check_mesh
from surrofe2.store.mesh_reader import UNFIT, UNREADABLE
from surrofe2.store.store import check_not_wide, read_bytes, reported

# Length in µm of each unit that a file may have.
UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}

# Formats by the end of a file's name: gmsh and abaqus have our own parsers, others meshio's.
FORMATS = {
    ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".xmf": "xdmf",
    ".inp": "abaqus", ".mesh": "medit", ".meshb": "medit",
}  # fmt: skip

# Formats that say themselves how their letters are encoded.
_XML = ("vtu", "xdmf")
# Bytes of a mesh file; its reader may take twenty times as much memory.
_MOST_BYTES = 2**28
# Classes of scikit-fem by the number of an element's nodes.
_ELEMENTS = {3: skfem.MeshTri1, 4: skfem.MeshQuad1, 6: skfem.MeshTri2}
# The folder of the package, which need not be installed for the reader to import it.
_PACKAGES = str(Path(__file__).parents[2])

log = logging.getLogger(__name__)


def load_mesh(path: str | Path, length_unit: str = "µm") -> skfem.Mesh:
    """Read the mesh of a file whose lengths are in µm ("µm", "um"), mm or m.

    Groups, sets and labels of surfaces become subdomains; those of lines and sides, and node sets,
    become boundaries. Changes that reading makes are logged.

    Raises:
        FileError: it is not there, or cannot be read.
        InputError: it is no mesh of quadrilaterals or triangles in a plane, or has no such unit.
    """
    path = Path(path)
    if not isinstance(length_unit, str) or with_micro_sign(length_unit) not in UNITS:
        raise InputError(f"length_unit: {length_unit!r}; it must be one of {', '.join(UNITS)}")
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise FileError(f"{path}: not a mesh file: its name must end in {', '.join(FORMATS)}")
    content = read_bytes(path, _MOST_BYTES)
    if kind not in _XML:
        check_not_wide(path, content)
    archive = _archive_of(path, kind, len(content))
    try:
        return mesh_of(path, archive, UNITS[with_micro_sign(length_unit)])
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _archive_of(path: Path, kind: str, size: int) -> bytes:
    """Let a reader's process read a mesh file of `size` bytes, and return the archive it writes.

    Raises:
        FileError: the file cannot be read within the limits, or the reader does not start.
        InputError: the file is no mesh for us.
    """
    # the first part is for Python and its libraries, the second for the mesh
    memory = _limit(resource.RLIMIT_AS, 2 * 10**9 + 20 * size)
    # A process is killed at the hard limit; a second before, it ends by a signal that says why.
    seconds = max(1, _limit(resource.RLIMIT_CPU, 21 + size // 10**6) - 1)
    reader = [sys.executable, "-P", "-m", "surrofe2.store.mesh_reader"]
    paths = [_PACKAGES]
    if os.environ.get("PYTHONPATH"):
        paths.append(os.environ["PYTHONPATH"])
    # threads of these libraries take address space, which is limited
    one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
    message = ""
    with reported(path, "read"):
        try:
            ended = subprocess.run(
                [*reader, kind, str(path.absolute()), str(memory), str(seconds)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=3 * seconds,  # of the clock, for a reader that waits
                env=os.environ | one_thread | {"PYTHONPATH": os.pathsep.join(paths)},
                check=False,
            )
            code = ended.returncode
            message = ended.stderr.decode("utf-8", "replace").strip()
        except subprocess.TimeoutExpired:
            code = -signal.SIGXCPU
    if code == 0:
        return ended.stdout
    if code == UNFIT:
        raise InputError(f"{path.name}: {message}")
    if code == -signal.SIGXCPU:
        reason = f"reading it takes more than {seconds} s"
    elif code < 0:
        reason = f"its reader ended by signal {-code}"
    elif code == UNREADABLE:
        reason = shortened(" ".join(message.split()), 150)
    else:
        last_line = message.splitlines()[-1] if message else f"exit code {code}"
        raise FileError(
            f"{path}: cannot be read: the program that reads meshes did not start "
            f"({shortened(last_line, 150)})"
        )
    raise FileError(f"{path}: not a mesh that can be read ({reason})")


def _limit(kind: int, wanted: int) -> int:
    """Return a limit for the reader, which must not be above those of this process."""
    limits = [limit for limit in resource.getrlimit(kind) if limit != resource.RLIM_INFINITY]
    return min([wanted, *limits])


def mesh_of(path: Path, content: bytes, unit: float = 1.0) -> skfem.Mesh:
    """Make the mesh of an archive that the reader has written, and check it.

    Args:
        path: the mesh file, which notes name.
        content: the archive.
        unit: length unit of the file, µm.
    """
    with np.load(io.BytesIO(content)) as archive:
        names: dict[str, Any] = json.loads(archive["names"].tobytes())
        points = archive["points"]
        elements = archive["elements"]
        boundaries = _by_name(archive, names, "boundaries")
        regions = _by_name(archive, names, "regions")
    for note in names["notes"]:
        _log_once(path.name, note)
    mesh = _ELEMENTS[elements.shape[1]](
        np.ascontiguousarray(unit * points.T), np.ascontiguousarray(elements.T)
    )
    sides = {name: _facets(mesh, ends) for name, ends in boundaries.items()}
    return check_mesh(type(mesh)(mesh.p, mesh.t, sides or None, regions or None))


def _by_name(archive: Any, names: dict[str, Any], group: str) -> dict[str, Index]:
    """Return the arrays of a group by name, spelt as recipes spell names, with the micro sign."""
    return {with_micro_sign(name): archive[f"{group}.{k}"] for k, name in enumerate(names[group])}


@cache  # a command reads its mesh several times
def _log_once(name: str, note: str) -> None:
    """Log a note on a mesh file, once in a process."""
    log.info("%s: %s", name, note)


def _facets(mesh: skfem.Mesh, ends: Index) -> Index:
    """Return the facets (s,) of sides by their ends (s, 2), the lower number first."""
    # one number for each pair of ends, so that sides are looked up by a search
    factor = mesh.p.shape[1]
    facets = np.sort(mesh.facets, axis=0).astype(np.int64)
    keys = facets[0] * factor + facets[1]
    order = np.argsort(keys)
    return order[np.searchsorted(keys[order], ends[:, 0] * factor + ends[:, 1])]
