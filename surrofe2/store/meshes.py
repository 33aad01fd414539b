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

UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
"""µm in each unit of length that a file may have."""

FORMATS = {
    ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".xmf": "xdmf",
    ".inp": "abaqus", ".mesh": "medit", ".meshb": "medit",
}  # fmt: skip
"""Formats by the ends of names of files: our parsers' gmsh and abaqus, and modules of meshio."""

_XML = ("vtu", "xdmf")
"""Formats that say themselves how their letters are encoded."""
_MOST = 2**28
"""Bytes of a file."""
_ELEMENTS = {3: skfem.MeshTri1, 4: skfem.MeshQuad1, 6: skfem.MeshTri2}
"""By the number of an element's nodes."""
_PACKAGES = str(Path(__file__).parents[2])
"""Where the package is, which need not be installed."""

log = logging.getLogger(__name__)


def load_mesh(path: str | Path, length_unit: str = "µm") -> skfem.Mesh:
    """The mesh of a file whose lengths are in µm ("µm", "um"), mm or m.

    Groups, sets and labels of surfaces become subdomains; those of lines and sides, and node sets,
    become boundaries. What was changed in reading is logged.

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
    content = read_bytes(path, _MOST)  # of a file, and no more than that
    if kind not in _XML:
        check_not_wide(path, content)
    size = len(content)
    memory = _limit(resource.RLIMIT_AS, 2 * 10**9 + 20 * size)
    # A process is killed at the hard limit; a second before, it ends by a signal that says why.
    seconds = max(1, _limit(resource.RLIMIT_CPU, 21 + size // 10**6) - 1)
    reader = [sys.executable, "-P", "-m", "surrofe2.store.mesh_reader"]
    paths = [_PACKAGES, *filter(None, [os.environ.get("PYTHONPATH")])]
    alone = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
    with reported(path, "read"):
        try:
            done = subprocess.run(
                [*reader, kind, str(path.absolute()), str(memory), str(seconds)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=3 * seconds,
                env=os.environ | alone | {"PYTHONPATH": os.pathsep.join(paths)},
                check=False,
            )
            code = done.returncode
            message = done.stderr.decode("utf-8", "replace").strip()
        except subprocess.TimeoutExpired:
            code = -signal.SIGXCPU
    if code == 0:
        try:
            return mesh_of(path, done.stdout, UNITS[with_micro_sign(length_unit)])
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None
    if code == UNFIT:
        raise InputError(f"{path.name}: {message}")
    if code == -signal.SIGXCPU:
        reason = f"reading it takes more than {seconds} s"
    elif code < 0:
        reason = f"its reader ended by signal {-code}"
    elif code == UNREADABLE:
        reason = shortened(" ".join(message.split()), 150)
    else:
        last = message.splitlines()[-1] if message else f"exit code {code}"
        raise FileError(
            f"{path}: cannot be read: the program that reads meshes did not start "
            f"({shortened(last, 150)})"
        )
    raise FileError(f"{path}: not a mesh that can be read ({reason})")


def _limit(kind: int, wanted: int) -> int:
    """A limit of the reader, which must not be above the one that this process has."""
    limits = resource.getrlimit(kind)
    return min([wanted, *(limit for limit in limits if limit != resource.RLIM_INFINITY)])


def mesh_of(path: Path, content: bytes, unit: float = 1.0) -> skfem.Mesh:
    """The mesh that the reader has written, checked, in µm of a `unit` each."""
    with np.load(io.BytesIO(content)) as archive:
        names: dict[str, Any] = json.loads(archive["names"].tobytes())
        points, elements = archive["points"], archive["elements"]
        # As recipes have them, whichever mu a file has.
        boundaries, regions = (
            {with_micro_sign(name): archive[f"{group}.{k}"] for k, name in enumerate(names[group])}
            for group in ("boundaries", "regions")
        )
    for note in names["notes"]:
        _log_once(path.name, note)
    mesh = _ELEMENTS[elements.shape[1]](
        np.ascontiguousarray(unit * points.T), np.ascontiguousarray(elements.T)
    )
    sides = {name: _facets(mesh, ends) for name, ends in boundaries.items()}
    return check_mesh(type(mesh)(mesh.p, mesh.t, sides or None, regions or None))


@cache  # a command reads its mesh several times
def _log_once(name: str, note: str) -> None:
    log.info("%s: %s", name, note)


def _facets(mesh: skfem.Mesh, ends: Index) -> Index:
    """(s,) facets of sides by their ends (s, 2), the lower number first."""
    factor = mesh.p.shape[1]
    facets = np.sort(mesh.facets, axis=0).astype(np.int64)
    keys = facets[0] * factor + facets[1]
    order = np.argsort(keys)
    return order[np.searchsorted(keys[order], ends[:, 0] * factor + ends[:, 1])]
