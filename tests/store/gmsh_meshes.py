"""Small meshes made by Gmsh, and what Gmsh's own interface says of their groups."""

from dataclasses import dataclass

import numpy as np

FORMATS = ((2.2, False), (2.2, True), (4.0, False), (4.1, False), (4.1, True))
"""Versions, each as text or as bytes; Gmsh 4.15 writes no bytes of 4.0."""


@dataclass
class Known:
    """What Gmsh says of a physical group.

    Attributes:
        nodes: (n, 2) positions of its nodes, in some order.
        size: length of curves, area of surfaces.
        elements: how many.
    """

    nodes: np.ndarray
    size: float
    elements: int


def strip(gmsh):
    """A strip with names of blanks, commas and Greek letters, and a physical point."""
    geo = gmsh.model.geo
    points = [geo.addPoint(x, y, 0.0, 60.0) for x, y in ((0, 0), (200, 0), (200, 100), (0, 100))]
    curves = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
    surface = geo.addPlaneSurface([geo.addCurveLoop(curves)])
    geo.synchronize()
    _group(gmsh, 2, [surface], "leaf blade (adaxial)")
    _group(gmsh, 1, [curves[3]], "left side, clamped")
    _group(gmsh, 1, [curves[1]], "tip µ/β")
    _group(gmsh, 0, [points[0]], "pin")


def reversed_side(gmsh):
    """A side of two curves, one against the way of the loop, which its group lists as such."""
    geo = gmsh.model.geo
    corners = ((0, 0), (200, 0), (200, 100), (0, 100), (0, 50))
    points = [geo.addPoint(x, y, 0.0, 60.0) for x, y in corners]
    curves = [geo.addLine(points[k], points[k + 1]) for k in range(3)]
    curves += [geo.addLine(points[4], points[3]), geo.addLine(points[4], points[0])]
    surface = geo.addPlaneSurface([geo.addCurveLoop([*curves[:3], -curves[3], curves[4]])])
    geo.synchronize()
    _group(gmsh, 2, [-surface], "tissue")
    _group(gmsh, 1, [-curves[3], curves[4]], "grip")
    _group(gmsh, 1, [curves[1]], "right")


def holed(gmsh):
    """A plate with a round hole."""
    occ = gmsh.model.occ
    plate = occ.addRectangle(0.0, 0.0, 0.0, 200.0, 100.0)
    hole = occ.addDisk(80.0, 50.0, 0.0, 30.0, 25.0)
    occ.cut([(2, plate)], [(2, hole)])
    occ.synchronize()
    curves = [tag for _, tag in gmsh.model.getEntities(1)]
    on_hole = [tag for tag in curves if gmsh.model.getType(1, tag) != "Line"]
    _group(gmsh, 2, [plate], "plate")
    _group(gmsh, 1, on_hole, "hole")
    _group(gmsh, 1, sorted({*curves} - {*on_hole}), "outside")


def layered(gmsh):
    """Two tissues with the curve between them, one of whose groups overlaps the other."""
    occ = gmsh.model.occ
    occ.addRectangle(0.0, 0.0, 0.0, 200.0, 40.0)
    occ.addRectangle(0.0, 40.0, 0.0, 200.0, 60.0)
    occ.fragment([(2, 1)], [(2, 2)])
    occ.synchronize()
    between = _shared(gmsh, 1, 2)
    _group(gmsh, 2, [1], "cortex")
    _group(gmsh, 2, [2], "skin")
    _group(gmsh, 2, [1, 2], "all")
    _group(gmsh, 1, between, "interface")
    _group(gmsh, 1, _sides(gmsh, 0.0), "left")


def numbered(gmsh):
    """Two tissues and two sides of which no group has a name; one number is of a side, too."""
    occ = gmsh.model.occ
    occ.addRectangle(0.0, 0.0, 0.0, 100.0, 100.0)
    occ.addRectangle(100.0, 0.0, 0.0, 100.0, 100.0)
    occ.fragment([(2, 1)], [(2, 2)])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], 11)
    gmsh.model.addPhysicalGroup(2, [2], 12)
    gmsh.model.addPhysicalGroup(1, _sides(gmsh, 0.0), 12)
    gmsh.model.addPhysicalGroup(1, _sides(gmsh, 200.0), 22)


def nameless(gmsh):
    """A plate without any group, in which Gmsh stores also points and curves."""
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 200.0, 100.0, roundedRadius=20.0)
    gmsh.model.occ.synchronize()


DRAWINGS = (strip, reversed_side, holed, layered, numbered, nameless)


def meshed(gmsh, draw, order, *, recombine, size=45.0):
    """Draw and mesh; recombined quadrilaterals may leave triangles, and may be incomplete."""
    gmsh.clear()
    gmsh.option.setNumber("Mesh.RecombineAll", float(recombine))
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.SaveAll", 0.0)
    draw(gmsh)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)


def written(gmsh, path, version, *, binary):
    """The path of the mesh that is there now, in a format."""
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", float(binary))
    gmsh.write(str(path))
    return path


def known_groups(gmsh):
    """By dimension and name, what Gmsh says; names as surrofe2 gives them to numbers."""
    groups = gmsh.model.getPhysicalGroups()
    known = {}
    for dimension, tag in groups:
        if dimension == 0:
            continue
        name = gmsh.model.getPhysicalName(dimension, tag)
        if not name:
            is_twice = (3 - dimension, tag) in groups
            name = f"{('', 'curve', 'surface')[dimension]} {tag}" if is_twice else str(tag)
        _, nodes = gmsh.model.mesh.getNodesForPhysicalGroup(dimension, tag)
        entities = abs(gmsh.model.getEntitiesForPhysicalGroup(dimension, tag))
        sizes = [_size(gmsh, dimension, int(entity)) for entity in entities]
        known[dimension, name] = Known(nodes.reshape(-1, 3)[:, :2], *np.sum(sizes, axis=0))
    return known


def whole_area(gmsh):
    """Area of all surfaces."""
    return sum(_size(gmsh, 2, tag)[0] for _, tag in gmsh.model.getEntities(2))


def _size(gmsh, dimension, entity):
    """Length or area of an entity's elements, by quadrature, and how many there are."""
    size, count = 0.0, 0
    for kind, tags in zip(*gmsh.model.mesh.getElements(dimension, entity)[:2], strict=True):
        local, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss6")
        _, jacobians, _ = gmsh.model.mesh.getJacobians(kind, local, entity)
        size += float(np.sum(abs(jacobians.reshape(len(tags), -1)) * weights))
        count += len(tags)
    return size, count


def _group(gmsh, dimension, entities, name):
    gmsh.model.addPhysicalGroup(dimension, entities, name=name)


def _shared(gmsh, first, second):
    """Curves of two surfaces."""
    curves = [
        {abs(tag) for _, tag in gmsh.model.getBoundary([(2, surface)], oriented=False)}
        for surface in (first, second)
    ]
    return sorted(curves[0] & curves[1])


def _sides(gmsh, x):
    """Curves at an x."""
    box = gmsh.model.getEntitiesInBoundingBox(x - 1.0, -1.0, -1.0, x + 1.0, 999.0, 1.0, 1)
    return [tag for _, tag in box]
