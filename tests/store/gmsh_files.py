"""Gmsh files (ASCII 4.1) written by hand: a rectangle of quadrilaterals, a notched square."""

QUADS = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
5
0 5 "corner"
1 1 "left"
1 2 "right"
2 3 "skin"
2 4 "flesh"
$EndPhysicalNames
$Entities
1 2 2 0
9 1 3 0 1 5
1 0 0 0 0 1 0 1 1 0
2 2 0 0 2 1 0 1 2 0
1 0 0 0 1 1 0 1 3 0
2 1 0 0 2 1 0 1 4 0
$EndEntities
$Nodes
1 7 1 12
2 1 0 7
1
2
3
4
5
6
12
0 0 0
1 0 0
2 0 0
0 1 0
1 1 0
2 1 0
1 3 0
$EndNodes
$Elements
5 5 1 5
1 1 1 1
1 4 1
1 2 1 1
2 3 6
2 1 3 1
3 1 2 5 4
2 2 3 1
4 2 5 6 3
0 9 15 1
5 12
$EndElements
"""
"""Two quadrilaterals of which the second goes round clockwise, and a point that is only drawn."""

TRIANGLES = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 1 "base"
1 2 "tip"
2 3 "leaf"
$EndPhysicalNames
$Entities
0 2 1 0
1 0 0 0 2 0 0 1 1 0
2 0 2 0 2 2 0 1 2 0
1 0 0 0 2 2 0 1 3 0
$EndEntities
$Nodes
1 5 1 5
2 1 0 5
1
2
3
4
5
0 0 5
2 0 5
2 2 5
0 2 5
1 1 5
$EndNodes
$Elements
3 6 1 6
1 1 1 1
1 1 2
1 2 1 1
2 3 4
2 1 2 4
3 1 2 5
4 5 3 2
5 3 4 5
6 1 5 4
$EndElements
"""
"""Four triangles about a point, at z = 5, one of them clockwise."""
