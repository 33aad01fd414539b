// A strip of 2 mm × 0.5 mm with a rounded notch from above, in µm.
// gmsh -2 -order 2 -format msh41 notched-leaf.geo
size = 200;
Point(1) = {0, 0, 0, size};
Point(2) = {2000, 0, 0, size};
Point(3) = {2000, 500, 0, size};
Point(4) = {1150, 500, 0, size / 2};
Point(5) = {1000, 350, 0, size / 2};
Point(6) = {850, 500, 0, size / 2};
Point(7) = {0, 500, 0, size};
Point(8) = {1000, 500, 0, size};     // centre of the notch
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Circle(4) = {4, 8, 5};
Circle(5) = {5, 8, 6};
Line(6) = {6, 7};
Line(7) = {7, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6, 7};
Plane Surface(1) = {1};
Physical Curve("base") = {7};
Physical Curve("tip") = {2};
Physical Curve("notch") = {4, 5};
Physical Surface("leaf") = {1};
