"""Three pictures from the fields of a run, read as any program reads XDMF.

    python docs/draw_fields.py out/cached pictures

stress.png   the deformed tissue where it has moved farthest, by von Mises stress
points.png   the points of the stress law about then, by the largest stretch of each
course.png   von Mises stress over time, of the three elements that bear most
"""

import sys
from pathlib import Path

import meshio
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection

STRESS, U, F = "von_mises_in_plane_uN_per_um", "displacement_um", "deformation_gradient"


def read_series(path):
    """Points (n, 3), cells, times, and what points and cells have at each time, by name."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        steps = [reader.read_data(k) for k in range(reader.num_steps)]
    times = np.array([t for t, _, _ in steps])
    at_points = {name: np.stack([each[1][name] for each in steps]) for name in steps[0][1]}
    in_cells = {name: np.stack([each[2][name][0] for each in steps]) for name in steps[0][2]}
    return points, cells[0].data, times, at_points, in_cells


def save(figure, place, path):
    """Equal scales, names of axes, and the file."""
    place.autoscale()
    place.set(aspect="equal", xlabel="x (µm)", ylabel="y (µm)")
    figure.savefig(path, dpi=300)


run, out = map(Path, sys.argv[1:3])
out.mkdir(parents=True, exist_ok=True)
nodes, elements, t, at_nodes, in_elements = read_series(run / "fields.xdmf")
u, stress = at_nodes[U], in_elements[STRESS]
far = int(np.linalg.norm(u, axis=2).max(axis=1).argmax())
outlines = elements[:, [0, 3, 1, 4, 2, 5]] if elements.shape[1] == 6 else elements

figure, place = plt.subplots(layout="constrained")
tissue = PolyCollection((nodes + u[far])[outlines][:, :, :2], array=stress[far], edgecolors="grey")
place.add_collection(tissue)
place.set_title(f"t = {t[far]:.4g} µs")
figure.colorbar(tissue, label="von Mises stress (µN/µm)")
save(figure, place, out / "stress.png")

at, _, t_points, at_points, _ = read_series(run / "points.xdmf")
k = int(abs(t_points - t[far]).argmin())
stretch = np.linalg.svd(at_points[F][k][:, :2, :2], compute_uv=False)[:, 0]
figure, place = plt.subplots(layout="constrained")
moved = at + at_points[U][k]
cloud = place.scatter(moved[:, 0], moved[:, 1], c=stretch, s=15.0)
place.set_title(f"t = {t_points[k]:.4g} µs")
figure.colorbar(cloud, label="largest stretch (1)")
save(figure, place, out / "points.png")

figure, place = plt.subplots(layout="constrained")
for e in np.argsort(-stress.max(axis=0))[:3]:
    x, y = nodes[elements[e], :2].mean(axis=0)
    place.plot(t, stress[:, e], label=f"about ({x:.4g}, {y:.4g}) µm")
place.set(xlabel="time (µs)", ylabel="von Mises stress (µN/µm)")
place.legend()
figure.savefig(out / "course.png", dpi=300)
