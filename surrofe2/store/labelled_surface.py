"""Labelled surfaces of tissue: PLY as MorphoGraphX writes it, each vertex with its cell's number.

A triangle belongs to the cell that most of its labelled vertices have; vertices on walls have no
label, 0 or −1. The surface is projected to the plane that it is nearest to, and drawn as a labelled
image, so that it is measured like one. Lengths are in µm.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import FileError, InputError, shortened
from surrofe2.store.labelled_image import Labels, check_count
from surrofe2.store.store import read_bytes

# Pixels on the side of a square with a cell's mean area.
_ACROSS = 40
# Projected over true area below which a surface is noted as curved.
_FLAT = 0.98
# Projected over true area below which it is refused: cells seen from aside have wrong shapes.
_TOO_CURVED = 0.8
# Pixels above which a surface is refused: small cells that lie far apart ask for so many.
_MOST_PIXELS = 5e7
_END_OF_HEADER = re.compile(rb"^\s*end_header\s*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class LabelledSurface:
    """A surface as a labelled image.

    Attributes:
        labels: (rows, columns), the first row at the top, 0 beyond the surface.
        pixel: side of a pixel, µm.
        flatness: area of the projection over that of the surface.
    """

    labels: Labels
    pixel: float
    flatness: float

    @property
    def remarks(self) -> tuple[str, ...]:
        """A sentence where the surface is not flat."""
        if self.flatness > _FLAT:
            return ()
        return (
            f"the surface is curved: projected to a plane it has {100.0 * self.flatness:.3g} % of "
            "its area",
        )


def read_surface(path: Path) -> LabelledSurface:
    """Read a PLY file, in text or binary.

    Raises:
        FileError: the file is not there, or is no PLY.
        InputError: it has no triangles, no labels or too few, or it is far from flat.
    """
    points, triangles, label = _read(path)
    of_vertices = label[triangles]
    # the label of two of the three vertices, or the largest: walls have 0 or −1
    ordered = np.sort(of_vertices, axis=1)
    of_triangles = np.where(ordered[:, 0] == ordered[:, 1], ordered[:, 1], ordered[:, 2])
    of_triangles = np.where(of_triangles > 0, of_triangles, ordered[:, 2])
    is_cell = of_triangles > 0
    triangles = triangles[is_cell]
    of_triangles = of_triangles[is_cell]
    check_count(path, of_triangles)
    corners = points[triangles]
    normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(normals, axis=1).sum())
    if not area > 0.0:
        raise InputError(f"{path}: its triangles have no area; save points in µm")
    across = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    if across @ normals.sum(axis=0) < 0.0:  # seen from outside, not mirrored
        across = -across
    flatness = float(abs(normals @ across).sum()) / area
    if flatness < _TOO_CURVED:
        raise InputError(
            f"{path}: projected to a plane its cells have {100.0 * flatness:.3g} % of their area; "
            f"at least {100.0 * _TOO_CURVED:g} % are needed: cut out a flatter piece"
        )
    cells = len(np.unique(of_triangles))
    pixel = float(np.sqrt(area * flatness / cells)) / _ACROSS
    flat = corners @ _axes(across).T
    return LabelledSurface(_drawn(path, flat, of_triangles, pixel), pixel, flatness)


def _axes(across: Array) -> Array:
    """Return (2, 3) unit vectors x, y of the plane across a vector; x is as the file's x or y."""
    # the file's axis must not be nearly across the plane
    along = np.eye(3)[0 if abs(across[0]) < 0.9 else 1]
    x = along - (along @ across) * across
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(across, x)])


def _read(path: Path) -> tuple[Array, Index, Index]:
    """Read points (n, 3), triangles (k, 3) and labels (n,) of the points."""
    content = read_bytes(path)
    if content.startswith(b"ply") and not _END_OF_HEADER.search(content):
        # meshio would search for the end of the header without an end
        raise FileError(f"{path}: its header has no end_header; the file is cut off: save it again")
    import meshio

    try:
        mesh = meshio.ply.read(path)
    except IndexError:
        raise FileError(f"{path}: it ends before what its header states; save it again") from None
    except (Exception, SystemExit) as error:  # meshio raises errors of any kind, and may exit
        reason = shortened(" ".join(str(error).split()), 150)
        raise FileError(f"{path}: cannot be read as PLY: {reason}") from None
    triangles = mesh.get_cells_type("triangle")
    if not len(triangles):
        raise InputError(f"{path}: it has no triangles; save the surface with its faces")
    label = mesh.point_data.get("label")
    if label is None:
        known = ", ".join(["x, y, z", *mesh.point_data])
        raise InputError(
            f"{path}: its vertices have {known} and no property label; save it with labels"
        )
    label = np.asarray(label)
    if not np.isfinite(label).all() or (label != np.round(label)).any():
        raise InputError(f"{path}: label of its vertices: {label.dtype}; it must be whole numbers")
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    if not np.isfinite(points).all() or triangles.min() < 0 or triangles.max() >= len(points):
        raise FileError(f"{path}: points are not finite, or triangles have points that are not")
    return points, np.asarray(triangles, np.int64), label.astype(np.int64)


def _drawn(path: Path, corners: Array, labels: Index, pixel: float) -> Labels:
    """Draw an image of triangles (k, 3, 2), with a pixel of 0 around it."""
    low = corners.min(axis=(0, 1)) - pixel
    columns, rows = np.ceil((corners.max(axis=(0, 1)) - low) / pixel + 1.0).astype(int)
    if rows * columns > _MOST_PIXELS:
        raise InputError(f"{path}: the cells are scattered too widely; cut out a smaller piece")
    image: Labels = np.zeros((rows, columns), dtype=np.int64)
    for (a, b, c), label in zip((corners - low) / pixel, labels.tolist(), strict=True):
        first = np.floor(np.min([a, b, c], axis=0)).astype(int)
        last = np.ceil(np.max([a, b, c], axis=0)).astype(int)
        x = np.arange(first[0], last[0] + 1) + 0.5
        y = np.arange(first[1], last[1] + 1)[:, None] + 0.5
        # signs tell on which side of each side of the triangle the middle of a pixel is
        sides = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        inside = np.all(np.array(sides) >= 0.0, axis=0) | np.all(np.array(sides) <= 0.0, axis=0)
        j, i = np.nonzero(inside)
        image[j + first[1], i + first[0]] = label
    return image[::-1]
