"""Meshes from files: read in a process of its own, since libraries trust what they read."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import skfem

from surrofe2.base.errors import FileError, InputError, shortened
from surrofe2.problem.mesh import check_mesh
from surrofe2.store.store import read_bytes, reported

UNITS = {"µm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
"""µm in each unit of length that a file may have."""

FORMATS = {
    ".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".xmf": "xdmf",
    ".inp": "abaqus", ".mesh": "medit", ".meshb": "medit",
}  # fmt: skip
"""meshio's modules by the ends of names of files."""

_MOST = 2**28
"""Bytes of a file."""


def load_mesh(path: str | Path, length_unit: str = "µm") -> skfem.Mesh:
    """The mesh of a file whose lengths are in µm ("µm", "um"), mm or m.

    Raises:
        FileError: it is not there, or meshio cannot read it.
        InputError: it is no mesh of quadrilaterals or triangles in a plane, or has no such unit.
    """
    path = Path(path)
    if length_unit not in UNITS:
        raise InputError(f"length_unit: {length_unit!r}; it must be one of {', '.join(UNITS)}")
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise FileError(f"{path}: not a mesh file: its name must end in {', '.join(FORMATS)}")
    size = len(read_bytes(path, _MOST))  # a file, and no more than that
    memory, seconds = 2 * 10**9 + 20 * size, 20 + size // 10**6
    reader = [sys.executable, "-P", str(Path(__file__).with_name("mesh_reader.py"))]
    alone = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
    with reported(path, "read"):
        try:
            done = subprocess.run(
                [*reader, kind, str(path.absolute()), str(memory), str(seconds)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=3 * seconds,
                env=os.environ | alone,
                check=False,
            )
            reason = shortened(" ".join(done.stderr.decode("utf-8", "replace").split()), 150)
            is_late = done.returncode == -signal.SIGXCPU
        except subprocess.TimeoutExpired:
            is_late = True
    if is_late:
        reason = f"reading it takes more than {seconds} s"
    elif done.returncode < 0:
        reason = f"its reader ended by signal {-done.returncode}"
    elif done.returncode == 2:
        raise InputError(f"{path.name}: {reason}")
    elif done.returncode == 0:
        try:
            return check_mesh(_mesh(done.stdout, UNITS[length_unit]))
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from None
    if "gmsh:physical" in reason:
        reason = (
            "some elements have physical groups and others none: export from Gmsh with "
            "Mesh.SaveAll = 0"
        )
    raise FileError(f"{path}: not a mesh that meshio reads ({reason})")


def _mesh(content: bytes, unit: float) -> skfem.Mesh:
    with np.load(io.BytesIO(content)) as archive:
        named = [
            {name: archive[f"{group}.{k}"] for k, name in enumerate(archive[group].tolist())}
            for group in ("boundaries", "subdomains")
        ]
        kind = getattr(skfem, str(archive["kind"]))
        return kind(unit * archive["p"], archive["t"], *(each or None for each in named))
