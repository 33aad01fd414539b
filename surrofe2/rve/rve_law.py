"""The stress law of a tissue of plant cells: an RVE behind every point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, pack, unpack
from surrofe2.law.stress_law import Status, StressResponse, check_deformation, describe
from surrofe2.plant_cell.arrangement import ReferenceState, make_arrangement, rim_areas
from surrofe2.plant_cell.measurements import cell_called
from surrofe2.plant_cell.neighbours import Topology
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import mean_aspect
from surrofe2.run.views import Facts, Viewed
from surrofe2.rve.newton import renew
from surrofe2.rve.particles import Particles, look_into
from surrofe2.rve.rve_state import Drive, RveState
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.slow_manifold import renew_slow
from surrofe2.rve.solve import dashpot_rate, solve_rves
from surrofe2.rve.unit_cell import make_unit_cell

_RENEW_AFTER = 4
"""Force evaluations of a warm solve above which `accept` makes new factors: fresh ones take 4."""
_RENEW_SLOW_AFTER = 9
"""The same for the slow manifold, which solves for velocities first: fresh factors take 8."""
_SAME = 1e-4
"""Material distance of particles, µm, below which two solutions are the same."""


class RveLaw(Viewed):
    """Stress law σ(F, Ḟ): at each point an RVE, put into the state it would have in a tissue.

    See section 5 of the paper for the states, `RveSettings.initialisation`.

    Args:
        cell: parameters of the plant cell, or the name of a preset.
        settings: initialisation, solver and tolerances.
        initialisation, solver: instead of those of the settings; see `RveSettings`.
        reference: the cell's settled reference state, as another law's `reference`; None: it is
            settled here, which takes some seconds for irregular cells.

    Attributes:
        rest_length: wall rest length l₀ that frees the undeformed cell of stress, µm.

    Raises:
        InputError: unknown names, or parameters without a stress-free stable reference.
        MismatchError: `reference` is of another cell.

    Examples:
        The Cauchy stress of apple flesh that is stretched by 2 % and does not move, in MPa:

        >>> import numpy as np
        >>> from surrofe2 import RveLaw
        >>> law = RveLaw("apple")
        >>> F = np.array([[[1.02, 0.0], [0.0, 1.0]]])  # (points, 2, 2), one point
        >>> answer = law.respond(F, np.zeros_like(F), tangents=True)
        >>> stress = answer.stress[0] / law.cell.tissue_thickness
        >>> print(f"{stress[0, 0]:.4f} along x, {stress[1, 1]:.4f} along y")
        0.0747 along x, 0.0011 along y
        >>> answer.tangents.P_by_F.shape  # ∂P/∂F
        (1, 2, 2, 2, 2)
    """

    def __init__(
        self,
        cell: CellParameters | str,
        settings: RveSettings | None = None,
        *,
        initialisation: str | None = None,
        solver: str | None = None,
        reference: ReferenceState | None = None,
    ) -> None:
        cell = cell_called(cell)
        if not isinstance(settings, RveSettings | None):
            raise InputError(
                f"rve: {settings!r}; settings must be an RveSettings, "
                "an initialisation or a solver are keywords"
            )
        settings = settings or RveSettings()
        self.settings = replace(
            settings,
            initialisation=initialisation or settings.initialisation,
            solver=solver or settings.solver,
        )
        self.cell = cell
        self.unit_cell = make_unit_cell(cell, reference)
        # states carry this name, so that one of another law is refused
        self._name = f"{cell.fingerprint} {self.settings.initialisation} {self.settings.solver}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes this law, without settling the reference again."""
        return partial(RveLaw, reference=self.reference), (self.cell, self.settings)

    def facts(self) -> Facts:
        """Return what a notebook shows of the law, by name."""
        return {
            "plant cell": self.cell.preset_name,
            "arrangement": f"{self.cell.cells} × {self.cell.arrangement}",
            **self._shape(),
            "initialisation": self.initialisation,
            "solver": self.settings.solver,
            "wall rest length": f"{self.rest_length:.4g} µm",
            "density": f"{self.density:.4g} ng/µm²",
        }

    def _shape(self) -> Facts:
        """Return statistics of Voronoi cells at rest, by the wall particles around each."""
        if self.cell.arrangement != "voronoi":
            return {}
        position = self.reference.position
        lattice = self.reference.lattice
        rims = make_arrangement(self.cell).rims
        areas = rim_areas(rims, position, lattice)
        # a row of a rim is a particle and the lattice shift of its image
        polygons = [position[rim[:, 0]] + rim[:, 1:] @ lattice.T for rim in rims]
        return {
            "variation of areas": f"{areas.std() / areas.mean():.3g}",
            "mean aspect ratio": f"{mean_aspect(polygons):.3g}",
        }

    @property
    def reference(self) -> ReferenceState:
        """The settled reference state, which another law of this cell can take over."""
        return self.unit_cell.reference

    @property
    def rest_length(self) -> float:
        """Wall rest length l₀, µm."""
        return self.unit_cell.rest_length

    @property
    def density(self) -> float:
        """Macroscopic density, ng/µm²."""
        return self.cell.density

    @property
    def initialisation(self) -> str:
        """Name of the state that the RVE is put into."""
        return self.settings.initialisation

    @property
    def has_tangents(self) -> bool:
        """True if the solver is direct; tangents would hide how loosely the iteration stops."""
        return self.settings.solver == "direct"

    def rest_state(self, points: int) -> RveState:
        """Return the state of n RVEs at F = I, to start from."""
        return self.unit_cell.rest_state(points, self._name)

    def particles(self, F: Any, F_dot: Any, state: RveState | None = None) -> Particles:
        """Return the particles behind the stress at n points: positions, forces, pressures, walls.

        Args:
            F, F_dot, state: as for `respond`.

        Raises:
            InputError: for what `respond` refuses, or where a point has no stress.
        """
        answer = self.respond(F, F_dot, state)
        failed = np.flatnonzero(answer.status)
        if failed.size:
            raise InputError(f"point {failed[0]}: {describe(answer.status[failed[0]])}")
        solved: RveState = answer.state
        F, F_dot = check_deformation(F, F_dot)
        z = unpack(solved.z, solved.points).transpose(0, 2, 1)
        fluctuation = unpack(solved.beyond_affine, solved.points).transpose(0, 2, 1)
        return look_into(self.unit_cell, F, F_dot, z, fluctuation)

    def beyond_bifurcation(self, state: RveState) -> Flags:
        """Return (n,) whether the RVE of a point left its branch at a bifurcation on its way."""
        return state.left_points

    def state_to_arrays(self, state: RveState) -> dict[str, NDArray[Any]]:
        """Return a state as arrays (n, …) by name, for files; see `RveState.to_arrays`."""
        return state.to_arrays(self.unit_cell.neighbours)

    def state_from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> RveState:
        """Return the state that `state_to_arrays` had; it leads to the same stress, to the bit.

        Its factors are made again at the positions at which they were made. They depend neither on
        the lane of a point nor on its neighbours in a tile, nor on listed contacts beyond the
        cut-off.
        """
        state = RveState.from_arrays(arrays, self._name, self.unit_cell.neighbours)
        factors = state.factors
        near = self.unit_cell.neighbours.near(factors.drive.F, factors.z)
        every = np.ones(len(state.z), dtype=np.bool_)
        self._make(factors.drive, factors.z, factors.address, every, near.topology)
        return state

    def respond(
        self, F: Any, F_dot: Any, state: RveState | None = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the Cauchy stress at n points by one RVE each; see `StressLaw.respond`.

        With `tangents` it computes ∂P/∂F and ∂P/∂Ḟ, too; the solver must be direct then. They are
        one-sided where a pair is at the cut-off.
        """
        F, F_dot = check_deformation(F, F_dot)
        points = len(F)
        if points == 0:
            return StressResponse(np.empty((0, 2, 2)), np.empty(0, np.int8), state, {})
        # from F = I, with new factors
        cold = state is None
        if cold:
            state = self.rest_state(points)
        elif not isinstance(state, RveState) or state.points != points or state.of != self._name:
            raise InputError(
                f"state: not a state of this RveLaw for {points} points; pass what an earlier "
                "answer for the same points carried, or None"
            )
        if tangents and not self.has_tangents:
            raise InputError(
                "tangents: not with solver iterated, whose loose stop they would hide; "
                "use solver direct"
            )
        drive = Drive(pack(F), pack(F_dot))
        solved = solve_rves(self.unit_cell, self.settings, drive, state, cold=cold)
        status = unpack(solved.status, points)
        stress = unpack(solved.answer.stress, points)
        slopes = solved.tangents() if tangents else None
        if slopes is not None:
            # where tangents were asked for, a stress without them is no answer
            lacks_tangents = ~np.isfinite(slopes.P_by_F).all(axis=(1, 2, 3, 4))
            status[lacks_tangents & (status == Status.OK)] = Status.NOT_CONVERGED
        if status.any():
            stress[status != Status.OK] = np.nan
        left_points = solved.state.left_points
        return StressResponse(
            stress,
            status,
            solved.state,
            solved.effort(),
            slopes,
            left_bifurcation=left_points if left_points.any() else None,
        )

    def accept(self, F: Any, F_dot: Any, response: StressResponse) -> StressResponse:
        """Check stability (elastic Hessian, dashpots off) and renew factors that have become stale.

        Points that lost stability go to a stable state, from which the next step begins; where
        there is none, their status becomes UNSTABLE or NOT_CONVERGED. The state of the response is
        not changed; the new one shares with it what was not renewed.
        """
        state = response.state
        # `respond` has reported these already
        response = replace(response, left_bifurcation=None)
        # an RVE by Cauchy–Born is in no equilibrium, and an iterated one only roughly
        has_equilibrium = self.initialisation != "cauchy-born" and self.has_tangents
        if not has_equilibrium or state.is_checked:
            return response
        limit = _RENEW_SLOW_AFTER if self.initialisation == "slow-manifold" else _RENEW_AFTER
        is_stale = (state.iterations > limit).any(axis=1)
        state, stable = self._renewed(state, is_stale)
        response = replace(response, state=state)
        lost = ~unpack(stable, state.points) & (response.status == Status.OK)
        if lost.any():
            response = self._leave(response, np.flatnonzero(lost))
        return response

    def _renewed(self, state: RveState, tiles: Flags) -> tuple[RveState, Flags]:
        """Return the state with new factors of these tiles, and whether RVEs are stable.

        tiles: (tiles,). The second result is (tiles, TILE), of all tiles.
        """
        near = state.near
        if near is None:
            near = self.unit_cell.neighbours.near(state.F, state.z)
        drive = Drive(state.F, dashpot_rate(self.initialisation, state.F_dot))
        factors = state.factors.renewed(tiles)
        stable = self._make(drive, state.relaxed, factors.address, tiles, near.topology)
        factors = factors.made_at(tiles, drive, state.relaxed)
        return replace(state, factors=factors, near=near), stable

    def _make(
        self, drive: Drive, z: Array, address: Index, tiles: Flags, topology: Topology
    ) -> Flags:
        """Write the factors of these tiles (tiles,) at z (tiles, 2, n, TILE).

        address: (tiles,) addresses of the blocks that they are written to.

        Returns:
            (tiles, TILE) whether RVEs are stable at z, of all tiles.
        """
        constants = self.unit_cell.constants
        if self.initialisation != "slow-manifold":
            return renew(drive, z, address, tiles, topology, constants)
        stable = np.empty((len(tiles), TILE), dtype=np.bool_)
        renew_slow(drive.F, z, address, tiles, topology, constants, stable)
        return stable

    def _leave(self, response: StressResponse, index: Index) -> StressResponse:
        """Return the response with the points `index` in stable states, where there are any.

        Points stay where they are if a solve with new factors finds that state stable.
        """
        part = response.state.take(index)
        drive = Drive(part.F, part.F_dot)
        solved = solve_rves(self.unit_cell, self.settings, drive, part, cold=True)
        count = len(index)
        moves = np.abs(unpack(solved.state.z, count) - unpack(part.z, count)).max(axis=(1, 2))
        status = response.status.copy()
        status[index] = unpack(solved.status, count)
        has_left = np.zeros(len(status), dtype=np.bool_)
        has_left[index] = (status[index] == Status.OK) & (moves > _SAME)
        state = response.state.put(index, solved.state)
        if not has_left.any():
            # the stress stays, to the bit, though it was solved again
            return replace(response, status=status, state=state)
        stress = response.stress.copy()
        stress[index] = unpack(solved.answer.stress, count)
        return replace(
            response, status=status, state=state, stress=stress, left_bifurcation=has_left
        )
