"""Small bars: a run, a mesh of elements that are no rectangles, states at random."""

from __future__ import annotations

import skfem

from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings
from surrofe2.macro.discretisation import make_discretisation_on, make_mesh

LOAD_CASE = LoadCase(
    width=60.0, height=40.0, watched=(60.0, 20.0), duration=6.0, output_interval=0.25
)
SETTINGS = MacroSettings(elements=(2, 3), frames=13)
PLATE = LoadCase(width=30.0, height=20.0, watched=(30.0, 10.0), body_force=(0.3, -0.2))


def distorted_bar(rng, elements=(5, 4), density=0.08):
    """Inner nodes moved at random: elements that are no rectangles."""
    mesh = make_mesh(PLATE, elements)
    nodes = mesh.p.copy()
    inner = mesh.interior_nodes()
    nodes[:, inner] += rng.uniform(-0.8, 0.8, (2, inner.size))
    return make_discretisation_on(skfem.MeshQuad(nodes, mesh.t), PLATE, density)


def random_state(bar, rng, size=0.5):
    u, v = rng.uniform(-size, size, (2, len(bar.free), 2))
    return u, v
