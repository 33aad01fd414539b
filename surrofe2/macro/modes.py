"""Small-amplitude motion about a state of rest: eigenfrequencies, damping, mode shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.sparse import block_diag, bmat, csc_matrix, identity
from scipy.sparse.linalg import eigs

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.macro.rest import Rest

Complex = NDArray[np.complex128]

# Number of unknowns up to which all eigenvalues are computed.
DENSE_LIMIT = 400
# A part of λ that is smaller relative to |λ| is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Modes:
    """The slowest oscillations u = Re φ exp(λ t), slowest first, with λ = −δ + i ω, ω > 0.

    Attributes:
        eigenvalues: (m,) λ, 1/µs.
        shapes: (k, n, 2) φ of all nodes and bodies, its largest entry 1.
        creeping: (k,) real eigenvalues found on the way: motion without oscillation, 1/µs.
    """

    eigenvalues: Complex
    shapes: Complex
    creeping: Array

    @property
    def frequencies(self) -> Array:
        """Frequencies ω/2π, (m,), 1/µs."""
        return self.eigenvalues.imag / (2.0 * np.pi)

    @property
    def periods(self) -> Array:
        """Periods 2π/ω, (m,), µs."""
        return 1.0 / self.frequencies

    @property
    def decrements(self) -> Array:
        """Logarithmic decrements per period, 2π δ/ω, (m,)."""
        return -self.eigenvalues.real * self.periods

    @property
    def damping_ratios(self) -> Array:
        """Damping over critical damping, δ/|λ|, (m,)."""
        return -self.eigenvalues.real / abs(self.eigenvalues)

    @property
    def stable(self) -> bool:
        """True if none of the motions that were computed grows."""
        grown = np.append(self.eigenvalues.real, self.creeping)
        return bool((grown <= _ROUNDING * abs(self.eigenvalues).max(initial=0.0)).all())


def find_modes(rest: Rest, count: int = 6) -> Modes:
    """Compute the `count` slowest oscillations of M ü + C u̇ + K u = 0 about `rest`.

    With z = [u, u̇] this is A z = λ B z, A = [[0, I], [−K, −C]], B = [[I, 0], [0, M]]: dense up
    to 400 unknowns, else by Arnoldi's method about λ = 0 with A factorised.

    Raises:
        InputError: `count` is below 1.
        SimulationError: the sparse solver found too few.
    """
    if count < 1:
        raise InputError(f"count: {count}; it must be at least 1")
    size = rest.stiffness.shape[0]
    unit = identity(size, format="csc")
    A = csc_matrix(bmat([[None, unit], [-rest.stiffness, -rest.damping]]))
    B = csc_matrix(block_diag([unit, rest.system.free_mass]))
    if size <= DENSE_LIMIT:
        values, vectors = eig(A.toarray(), B.toarray())
    else:
        # Eigenvalues come in pairs, and some are real, so more than twice as many are asked for.
        # The start vector is fixed, so that the answer is as well.
        start = np.ones(A.shape[0])
        values, vectors = eigs(A, k=2 * count + 4, M=B, sigma=0.0, v0=start)
    oscillating = np.flatnonzero(values.imag > _ROUNDING * abs(values))
    chosen = oscillating[np.argsort(values[oscillating].imag)][:count]
    if size > DENSE_LIMIT and chosen.size < count:
        raise SimulationError(
            f"modes: {chosen.size} oscillations among the slowest {2 * count + 4} motions, "
            f"{count} wanted; ask for more or damp less"
        )
    shapes = vectors[:size, chosen].T
    largest = shapes[np.arange(len(shapes)), abs(shapes).argmax(axis=1)]
    everywhere = np.zeros((len(shapes), 2 * rest.system.n_rows), dtype=complex)
    everywhere[:, rest.system.free] = shapes / largest[:, None]
    shapes = everywhere.reshape(len(shapes), rest.system.n_rows, 2)
    real = values[abs(values.imag) <= _ROUNDING * abs(values)].real
    return Modes(values[chosen], shapes, np.sort(real)[::-1])
