"""Free sides of elements, whose tension a surface law gives (docs/theory.md, free sides, (A22)).

T is the undeformed direction of a side, L its length, and F̄ the mean deformation gradient of the
outer plant cell there: F at the law's depth d below the side, in the mean over the width w of a
plant cell, whatever the mesh. With g = F̄ T = T + D u, λ = |g|, n = g/λ and λ̇ = n·ġ the force is
−Dᵀ (L P_s(λ, λ̇) n). The unknowns count from the rest under surface tension, F̄ from the undeformed
state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse  # scipy.spatial is loaded where sides are free
import skfem

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import InputError
from surrofe2.law.surface_law import SurfaceLaw, SurfaceResponse
from surrofe2.macro.elements import (
    Discretisation,
    Matrix,
    for_components,
    summed,
    with_transpose,
)
from surrofe2.macro.forces import Slopes
from surrofe2.problem.conditions import FREE, Surface
from surrofe2.problem.mesh import boundary, facet_nodes, region, region_numbers
from surrofe2.problem.problem import SURFACE, Problem

# Degrees off the rows of plant cells up to which a side runs along them.
_ALONG = 1.0
# Squared spread of depths over the area of a patch, below which they count as all the same.
_EVEN = 1e-12


@dataclass(frozen=True, slots=True)
class FreeSides:
    """Sides with a surface law.

    Attributes:
        facets: (m,) numbers of facets of the mesh.
        nodes: (m, 2) or (m, 3) nodes of each, as of `facet_nodes`.
        elements: (m,) the element beside each.
        names: names of the boundaries.
        boundary: (m,) number of the boundary of each side.
        laws: the surface laws.
        law: (m,) number of the law of each side.
        oblique: (m,) degrees off the nearer direction of the plant cells' rows, x or y; 0 along it.
    """

    facets: Index
    nodes: Index
    elements: Index
    names: tuple[str, ...]
    boundary: Index
    laws: tuple[SurfaceLaw, ...]
    law: Index
    oblique: Array


def free_sides(problem: Problem) -> FreeSides:
    """Return the sides that the surface of a problem names.

    Raises:
        InputError: a boundary or a region is not there, no side is free, or a side is beside an
            element of no law or of two.
    """
    mesh = problem.mesh
    surface = problem.surface
    assert surface is not None
    if surface.on == FREE:
        names: tuple[str, ...] = (FREE,)
        places = {*problem.places()}
        named = [facets for name, facets in (mesh.boundaries or {}).items() if name in places]
        outer = np.setdiff1d(mesh.boundary_facets(), np.concatenate([[], *named]))
        parts = [outer.astype(np.int64)]
        if not len(parts[0]):
            raise InputError("surface.on: free; every outer side has a condition: leave it out")
    else:
        names = tuple(surface.on)
        parts = [boundary(mesh, name, "surface.on") for name in names]
    all_facets = np.concatenate(parts)
    _, first = np.unique(all_facets, return_index=True)
    first = np.sort(first)  # a side of two boundaries counts once, with the first
    facets = all_facets[first]
    of_boundary = np.repeat(np.arange(len(parts)), [len(part) for part in parts])[first]
    nodes = facet_nodes(mesh, facets)
    elements = mesh.f2t[0, facets].astype(np.int64)
    laws, law = _laws(surface, mesh, elements)
    along = np.diff(mesh.p.T[nodes[:, :2]], axis=1)[:, 0]
    shorter, longer = np.sort(abs(along), axis=1).T
    angle = np.degrees(np.arctan2(shorter, longer))  # to the nearer axis
    oblique = np.where(angle > _ALONG, angle, 0.0)
    return FreeSides(facets, nodes, elements, names, of_boundary, laws, law, oblique)


def _laws(
    surface: Surface, mesh: skfem.Mesh, elements: Index
) -> tuple[tuple[SurfaceLaw, ...], Index]:
    """Return the laws, and (m,) which of them each side takes."""
    if not isinstance(surface.law, Mapping):
        return (surface.law,), np.zeros(len(elements), np.int64)
    known = surface.regions or {name: region(mesh, name, "surface.law") for name in surface.law}
    law = region_numbers(mesh, {name: known[name] for name in surface.law}, "surface.law", elements)
    return tuple(surface.law.values()), law


def stretched_nodes(sides: FreeSides, space: Discretisation, n: int) -> Matrix:
    """Make the matrix D (m, n) of F̄ T = T + D u for all sides, 1/µm.

    A side takes the mean gradient of the points in a box below it, as wide as a plant cell and down
    to twice the law's depth, weighted so that their mean depth is the law's.
    """
    n_q = space.points_per_element - space.pressure_apart  # Gauss points alone
    position = space.point_positions().reshape(len(space.elements), -1, 2)[:, :n_q]
    corners = space.nodes[sides.nodes[:, :2]]
    centres = scipy.spatial.KDTree(position.mean(axis=1))
    size = float(np.ptp(space.nodes[space.elements], axis=1).max())
    selected = []
    for p, element in enumerate(sides.elements):
        law = sides.laws[sides.law[p]]
        reach = np.hypot(0.5 * law.width, 2.0 * law.depth) + 2.0 * size
        middle = corners[p].mean(axis=0)
        along = corners[p, 1] - corners[p, 0]
        near = np.sort(centres.query_ball_point(middle, reach)).astype(np.int64)
        along = along / np.linalg.norm(along)
        inward = np.array([-along[1], along[0]])
        if inward @ (position[element].mean(axis=0) - middle) < 0.0:
            inward = -inward
        ahead = (position[near] - middle) @ along
        depth = (position[near] - middle) @ inward
        taken = (abs(ahead) <= 0.5 * law.width) & (depth >= 0.0) & (depth <= 2.0 * law.depth)
        taken[near == element] = True  # at least the element beside the side
        within, q = np.nonzero(taken)
        element_of_point = near[within]
        weights = _weights(space.weights[element_of_point, q], depth[taken], law.depth)
        slopes = weights[:, None] * (space.gradients[element_of_point, q] @ along)
        nodes = space.elements[element_of_point].ravel()
        selected.append((slopes.ravel(), np.full(nodes.size, p), nodes))
    values, rows, columns = (np.concatenate(parts) for parts in zip(*selected, strict=True))
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(len(selected), n))


def _weights(areas: Array, depths: Array, wanted: float) -> Array:
    """Return weights of points, with the sum 1, by which their mean depth is the wanted one.

    They are the areas, times a factor that is linear in the depth. Where all depths are the same,
    that cannot be, and the areas alone count.
    """
    shares = areas / areas.sum()
    apart = depths - shares @ depths
    variance = float(shares @ apart**2)
    if variance <= _EVEN * areas.sum():
        return shares
    return np.asarray(shares * (1.0 + (wanted - shares @ depths) / variance * apart))


@dataclass(frozen=True, slots=True)
class SurfaceForce:
    """The force of all free sides.

    Attributes:
        sides: the m sides.
        D: (m, n) sparse, from displacement to the change of g, 1/µm.
        D_T: (n, m) its transpose.
        lengths: (m,) L, µm.
        directions: (m, 2) g where the unknowns are zero.
        share: factor of the tension, below 1 on the way to rest.
    """

    sides: FreeSides
    D: Matrix
    D_T: Matrix
    lengths: Array
    directions: Array
    share: float = 1.0

    @property
    def name(self) -> str:
        """The name of the force in results."""
        return SURFACE

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """Compute the force as `Force.at`; NaN where a law has no answer."""
        g, stretch, rate = self._stretches(u, v)
        pull = self.lengths * self.share * self._ask(stretch, rate).tension / stretch
        return self.D_T @ (-pull[:, None] * g)

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes:
        """Compute −∂f/∂u and −∂f/∂v, see `Force.slopes`."""
        g, stretch, rate = self._stretches(u, v)
        answer = self._ask(stretch, rate, tangents=True)
        assert answer.tangent is not None
        assert answer.rate_tangent is not None
        n = g / stretch[:, None]
        along = np.einsum("pi,pj->pij", n, n)
        across = np.eye(2) - along
        turning = np.einsum("pi,pj->pij", n, (self.D @ v - rate[:, None] * n) / stretch[:, None])
        by_g = answer.tangent[:, None, None] * along + answer.rate_tangent[:, None, None] * turning
        by_g += (answer.tension / stretch)[:, None, None] * across
        by_g_dot = answer.rate_tangent[:, None, None] * along
        S = with_transpose(for_components(self.D))
        lengths = self.share * self.lengths[:, None, None]
        return summed(S, lengths * by_g), summed(S, lengths * by_g_dot)

    def dissipation_rates(self, u: Array, v: Array) -> Array:
        """Compute ∫ (P_s(λ, λ̇) − P_s(λ, 0)) λ̇ dS along each of `FreeSides.names`, (b,) pJ/µs."""
        _, stretch, rate = self._stretches(u, v)
        excess = self._ask(stretch, rate).tension - self._ask(stretch, 0.0 * rate).tension
        power = self.lengths * excess * rate
        return np.bincount(self.sides.boundary, power, len(self.sides.names)).astype(np.float64)

    def from_rest(self, u: Array) -> SurfaceForce:
        """Return the same force with unknowns that count from the displacement u (n, 2)."""
        return replace(self, directions=self.directions + self.D @ u)

    def mass(self, mesh: skfem.Mesh, inside: Array) -> Matrix:
        """Compute the mass (2 n_nodes, 2 n_nodes) of the sides beyond that of the bulk, ng.

        Args:
            inside: (n_el,) factor of the sides beside each element.
        """
        per_length = np.array([law.mass for law in self.sides.laws])[self.sides.law]
        basis = skfem.FacetBasis(mesh, mesh.elem(), facets=self.sides.facets)
        scale = per_length * inside[self.sides.elements] * self.lengths / basis.dx.sum(axis=1)
        form = skfem.BilinearForm(lambda u, v, w: w.scale * u * v)
        return for_components(form.assemble(basis, scale=scale[:, None] * np.ones(basis.dx.shape)))

    def refusal(self, nodes: Array, u: Array, v: Array) -> str:
        """Say where a law has no answer, and for which stretch."""
        _, stretch, rate = self._stretches(u, v)
        p = int(np.argmin(self._ask(stretch, rate).valid))
        x, y = nodes[self.sides.nodes[p, :2]].mean(axis=0)
        return (
            f"free side at ({x:.6g}, {y:.6g}) µm, stretch {stretch[p]:.6g}, rate {rate[p]:.6g} "
            "1/µs: its surface law has no answer there"
        )

    def _stretches(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return g (m, 2), and λ and λ̇ (m,) of all sides."""
        g = self.directions + self.D @ u
        stretch = np.hypot(g[:, 0], g[:, 1])
        return g, stretch, np.einsum("mi,mi->m", g, self.D @ v) / stretch

    def _ask(self, stretch: Array, rate: Array, *, tangents: bool = False) -> SurfaceResponse:
        """Return the answer of each side's law at (m,) stretches and rates."""
        laws = self.sides.laws
        if len(laws) == 1:
            return laws[0].respond(stretch, rate, tangents=tangents)
        values = np.empty((3 if tangents else 1, stretch.size))
        for k, law in enumerate(laws):
            points = np.flatnonzero(self.sides.law == k)
            answer = law.respond(stretch[points], rate[points], tangents=tangents)
            values[:, points] = answer[: len(values)]
        return SurfaceResponse(*values)


def make_surface(problem: Problem, space: Discretisation, n: int) -> SurfaceForce:
    """Make the force of the free sides of a problem that has a surface, on n rows."""
    sides = free_sides(problem)
    ends = space.nodes[sides.nodes[:, :2]]
    along = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    D = stretched_nodes(sides, space, n)
    return SurfaceForce(sides, D, D.T.tocsr(), lengths, along / lengths[:, None])
