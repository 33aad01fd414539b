"""Stress laws and surrogates in closed form: all that tests need without cells and training.

In this order: laws of the bar (viscoelastic solid, linear solid, fibres, dry friction); an
isotropic law that stands in for RVEs; a law with the square's symmetry; a lattice of
points with what plant cells have; true laws and surrogates of a cached law; a surface law.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import det, from_components, rotation, to_inputs, transpose
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import (
    Status,
    StressResponse,
    Tangents,
    check_deformation,
    require_tangents,
)
from surrofe2.law.surface_law import SurfaceResponse
from surrofe2.plant_cell.parameters import CellParameters
from tests.numerics import differences

IDENTITY = np.eye(2)
CELL = CellParameters.preset("printed")
ZERO = np.zeros((1, 2, 2))


def tangents_by_differences(stress, F, F_dot, step=1e-5):
    """Tangents of P = det F σ F⁻ᵀ of a Cauchy stress(F, F_dot), by central differences."""

    def first_piola(F, F_dot):
        return det(F)[:, None, None] * stress(F, F_dot) @ transpose(np.linalg.inv(F))

    return Tangents(
        differences(lambda at: first_piola(at, F_dot), F, step),
        differences(lambda at: first_piola(F, at), F_dot, step),
    )


@dataclass(frozen=True)
class PointStates:
    """A law's state that knows F of its points; they left a bifurcation where F₁₁ is above one."""

    F: np.ndarray
    leaves_above: float = np.inf

    def take(self, indices):
        return replace(self, F=self.F[indices])

    def put(self, indices, part):
        F = self.F.copy()
        F[indices] = part.F
        return replace(self, F=F)

    @property
    def left_points(self):
        return self.F[:, 0, 0] > self.leaves_above


class Memoryless:
    """A law whose stress depends on (F, Ḟ) alone; subclasses say how in `stress` and, by
    ∂P/∂F and ∂P/∂Ḟ, in `slopes`. It `fails` with its code where F₁₁ is above `fails_above`, and
    `refuses` nothing, unless `failing` says otherwise."""

    density, has_tangents, effort = 0.08, True, "evaluations"
    fails_above, code, calls = np.inf, Status.NOT_CONVERGED, 0

    def of(self, cell, settings=None):
        """Stand in for `RveLaw`."""
        self.cell, self.initialisation = cell, settings.initialisation
        return self

    def stress(self, F, F_dot):
        raise NotImplementedError

    def slopes(self, F, F_dot):
        found = tangents_by_differences(self.stress, F, F_dot)
        return found.P_by_F, found.P_by_F_dot

    def fails(self, F, F_dot):
        return F[:, 0, 0] > self.fails_above

    def refuses(self, F, F_dot):
        return np.zeros(len(F), dtype=bool)

    def respond(self, F, F_dot, state: Any = None, *, tangents=False) -> StressResponse:
        if tangents:
            require_tangents(self)
        F, F_dot = check_deformation(F, F_dot)
        self.calls += 1
        stress = self.stress(F, F_dot)
        status = np.where(self.fails(F, F_dot), self.code, Status.OK)
        stress[status != 0] = np.nan
        slopes = Tangents(*self.slopes(F, F_dot)) if tangents else None
        return StressResponse(stress, status.astype(np.int8), None, {self.effort: len(F)}, slopes)

    def accept(self, F, F_dot, response) -> StressResponse:
        status = np.where(self.refuses(F, F_dot), self.code, response.status)
        return replace(response, status=status.astype(np.int8))


def failing(law, **how):
    """The law with other `fails` or `refuses`, (F, F_dot) → (n,), or another `code`."""
    for name, value in how.items():
        setattr(law, name, value)
    return law


@dataclass
class KelvinVoigt(Memoryless):
    """Compressible neo-Hookean in parallel with a Newtonian fluid; objective.

    J σ = µ (F Fᵀ − I) + λ ln J I + J [2 η dev D + ζ tr D I], D = sym L.
    """

    shear_modulus: float = 60.0
    lame: float = 80.0
    shear_viscosity: float = 20.0
    bulk_viscosity: float = 30.0
    density: float = 0.08

    def stress(self, F, F_dot):
        J = det(F)[:, None, None]
        left = F @ F.transpose(0, 2, 1)
        elastic = (self.shear_modulus * (left - IDENTITY) + self.lame * np.log(J) * IDENTITY) / J
        L = F_dot @ np.linalg.inv(F)
        D = 0.5 * (L + L.transpose(0, 2, 1))
        trace = np.einsum("nii->n", D)[:, None, None]
        viscous = 2.0 * self.shear_viscosity * (D - 0.5 * trace * IDENTITY)
        return elastic + viscous + self.bulk_viscosity * trace * IDENTITY

    def slopes(self, F, F_dot):
        """P = µ F + (λ ln J − µ) G + J V G with G = F⁻ᵀ, V_im = 𝕍_imab L_ab the viscous stress;
        ∂G_ij/∂F_kl = −G_il G_kj, ∂L_ab/∂F_kl = −L_ak G_bl, ∂L_ab/∂Ḟ_kl = δ_ak G_bl."""
        J, G, L = det(F), np.linalg.inv(F).transpose(0, 2, 1), F_dot @ np.linalg.inv(F)
        I4 = np.einsum("ik,jl->ijkl", IDENTITY, IDENTITY)
        volume = np.einsum("ij,kl->ijkl", IDENTITY, IDENTITY)
        viscosity = self.shear_viscosity * (I4 + I4.transpose(0, 1, 3, 2) - volume)
        viscosity = viscosity + self.bulk_viscosity * volume
        V = np.einsum("imab,nab->nim", viscosity, L)
        GG = np.einsum("nil,nkj->nijkl", G, G)
        by_F = self.shear_modulus * I4 + self.lame * np.einsum("nij,nkl->nijkl", G, G)
        by_F = by_F + np.einsum("n,nijkl->nijkl", self.shear_modulus - self.lame * np.log(J), GG)
        by_F += np.einsum("n,nim,nmj,nkl->nijkl", J, V, G, G)
        by_F -= np.einsum("n,nim,nml,nkj->nijkl", J, V, G, G)
        by_F -= np.einsum("n,imab,nak,nbl,nmj->nijkl", J, viscosity, L, G, G)
        by_F_dot = np.einsum("n,imkb,nbl,nmj->nijkl", J, viscosity, G, G)
        return by_F, by_F_dot


@dataclass
class LinearFirstPiola(Memoryless):
    """P = λ tr(ε) I + 2 µ ε, ε = sym(F − I), pulled to σ = P Fᵀ / J: linear for small strain."""

    shear_modulus: float = 1.0
    lame: float = 1.0
    density: float = 1.0

    def first_piola(self, F):
        strain = 0.5 * (F + F.transpose(0, 2, 1)) - IDENTITY
        trace = np.einsum("nii->n", strain)[:, None, None]
        return self.lame * trace * IDENTITY + 2.0 * self.shear_modulus * strain

    def stress(self, F, F_dot):
        return self.first_piola(F) @ F.transpose(0, 2, 1) / det(F)[:, None, None]

    def slopes(self, F, F_dot):
        I4 = np.einsum("ik,jl->ijkl", IDENTITY, IDENTITY)
        by_F = self.lame * np.einsum("ij,kl->ijkl", IDENTITY, IDENTITY)
        by_F = by_F + self.shear_modulus * (I4 + I4.transpose(0, 1, 3, 2))
        return np.broadcast_to(by_F, (len(F), 2, 2, 2, 2)), np.zeros((len(F), 2, 2, 2, 2))


@dataclass
class Fibres(Memoryless):
    """Fibres along x that do not feel y: P₁₁ = E (F₁₁ − 1) + η Ḟ₁₁ and nothing else.

    A bar of them moves as the damped wave equation ρ ü = E u'' + η u̇'' + ρ g.
    """

    modulus: float = 100.0
    viscosity: float = 300.0
    density: float = 0.08

    def stress(self, F, F_dot):
        P = np.zeros_like(F)
        P[:, 0, 0] = self.modulus * (F[:, 0, 0] - 1.0) + self.viscosity * F_dot[:, 0, 0]
        return P @ F.transpose(0, 2, 1) / det(F)[:, None, None]

    def slopes(self, F, F_dot):
        by_F, by_F_dot = np.zeros((2, len(F), 2, 2, 2, 2))
        by_F[:, 0, 0, 0, 0], by_F_dot[:, 0, 0, 0, 0] = self.modulus, self.viscosity
        return by_F, by_F_dot


@dataclass
class DryFriction:
    """`Fibres` beside a Jenkin element: a spring in series with dry friction, with memory.

    τ = clip(τ_n + k (F₁₁ − F₁₁ₙ), ±limit), P₁₁ = E (F₁₁ − 1) + τ. The history (F₁₁ₙ, τ_n) is
    that of the last accepted step: it rides in `state` and moves on in `accept` alone.
    """

    modulus: float = 100.0
    spring: float = 200.0
    limit: float = 0.1
    density: float = 0.08
    committed: list = field(default_factory=list)
    has_tangents = False

    def respond(self, F, F_dot, state=None, *, tangents=False) -> StressResponse:
        F, F_dot = check_deformation(F, F_dot)
        stretch, friction = state if state is not None else (np.ones(len(F)), np.zeros(len(F)))
        friction = np.clip(friction + self.spring * (F[:, 0, 0] - stretch), -self.limit, self.limit)
        P = np.zeros_like(F)
        P[:, 0, 0] = self.modulus * (F[:, 0, 0] - 1.0) + friction
        stress = P @ F.transpose(0, 2, 1) / det(F)[:, None, None]
        return StressResponse(stress, np.zeros(len(F), np.int8), (F[:, 0, 0].copy(), friction))

    def accept(self, F, F_dot, response) -> StressResponse:
        self.committed.append(response.state)
        return response


class SoftLaw(Memoryless):
    """Isotropic σ = R (2 a (U − I) + b (A + Aᵀ)) Rᵀ with F = R U, A = RᵀḞ."""

    density, has_tangents, effort, rest_length = 0.084, False, "rve_solves", 1.5

    def __init__(self, a=50.0, b=100.0, fails_above=np.inf):
        self.a, self.b, self.fails_above = a, b, fails_above

    def stress(self, F, F_dot):
        R = rotation(F)
        U, A = transpose(R) @ F, transpose(R) @ F_dot
        S = 2.0 * self.a * (U - np.eye(2)) + self.b * (A + transpose(A))
        return R @ S @ transpose(R)


class SoftCell(SoftLaw):
    """As stiff and as heavy as its plant cell says."""

    def of(self, cell, settings=None):
        self.a, self.density = cell.wall_stiffness / 80.0, cell.density
        return super().of(cell, settings)


class StoppingLaw(SoftLaw):
    """Raises after so many calls, as Ctrl-C or a kill would."""

    def __init__(self, calls, error=KeyboardInterrupt, **settings):
        super().__init__(**settings)
        self.left, self.error = calls, error

    def respond(self, F, F_dot, state=None, *, tangents=False):
        if self.left == 0:
            raise self.error
        self.left -= 1
        return super().respond(F, F_dot, state)


def square_stress(F, F_dot):
    """R S Rᵀ; sum, difference, shear, spin of S have the parities of D4."""
    x, R = to_inputs(F, F_dot)
    e, d, g, a, b, c, w = x.T
    s = np.stack(
        [
            40.0 * e + 90.0 * e**2 + 60.0 * d**2 + 30.0 * g**2 + 25.0 * a,
            30.0 * d + 80.0 * e * d + 20.0 * b + 15.0 * g * w,
            20.0 * g - 50.0 * e * g + 15.0 * c * (1.0 + e),
            35.0 * d * g + 2.0 * w * e,
        ],
        axis=1,
    )
    return R @ from_components(s) @ transpose(R)


class Remembering(Memoryless):
    """Its state knows F of its points; it notes what it was asked: (F, state) of each call."""

    effort = "rve_solves"

    def __init__(self, cell=CELL, initialisation="constrained-runs", fails_above=np.inf):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density
        self.fails_above, self.asked = fails_above, []

    def respond(self, F, F_dot, state=None, *, tangents=False):
        self.asked.append((F.copy(), state))
        answer = super().respond(F, F_dot, tangents=tangents)
        return replace(answer, state=PointStates(F.copy()))

    def state_to_arrays(self, state):
        return {"F": state.F}

    def state_from_arrays(self, arrays):
        return PointStates(arrays["F"])


class SquareLaw(Remembering):
    """`square_stress`."""

    rest_length = 1.5

    def stress(self, F, F_dot):
        return square_stress(F, F_dot)


SPACING = 4.0
RANGE = SamplingRange(stretch=(0.92, 1.08), shear=0.08, rate=0.01)
WELL_INSIDE = SamplingRange(stretch=(0.945, 1.055), shear=0.055, rate=0.006)
"""Within the domain of any few hundred samples of `RANGE`."""


def lattice_stress(F, F_dot):
    """(n, 2, 2) Cauchy stress with what the plant cell's has: stiff, viscous, objective, D4.

    Points of a square lattice follow F without fluctuation; each pair repels by r⁻⁶, is damped
    along its line and, not centrally, against its relative velocity, so the stress is not
    symmetric. Bonds to the nearest neighbours pull with a rest length that makes σ(I, 0) = 0.
    """
    unloaded, bonded = (_lattice_stress(IDENTITY[None], ZERO, rest) for rest in (0.0, 1.0))
    rest_length = unloaded[0, 0, 0] / (unloaded - bonded)[0, 0, 0]
    return _lattice_stress(F, F_dot, rest_length)


def lattice_samples(count, seed=1, cell=CELL):
    """Samples of the lattice's stress over `RANGE`."""
    F, F_dot = sample(RANGE, count, seed)
    return StressSamples(
        F=F,
        F_dot=F_dot,
        stress=lattice_stress(F, F_dot),
        status=np.zeros(count, dtype=np.int8),
        cell=cell,
        initialisation="constrained-runs",
        range=RANGE,
        seed=seed,
        rest_length=1.375,
    )


def _lattice_stress(F, F_dot, rest_length):
    steps = np.arange(-2, 3)
    X = SPACING * np.array([(i, j) for i in steps for j in steps if (i, j) != (0, 0)], dtype=float)
    x, w = (np.einsum("nij,pj->npi", tensor, X) for tensor in (F, F_dot))
    r = np.linalg.norm(x, axis=2)
    along = x / r[..., None]
    closing = (along * w).sum(axis=2)
    bond = np.isclose(np.linalg.norm(X, axis=1), SPACING)
    force = -6e5 * r**-6.0 + 4e4 * r**-3.5 * closing
    force = force + bond * (300.0 * (r - rest_length) + 80.0 * closing)
    friction = 60.0 * np.exp(-((r / 5.0) ** 2))
    total = force[..., None] * along + friction[..., None] * w
    area = SPACING**2 * np.linalg.det(F)
    return 0.5 * np.einsum("npi,npj->nij", total, x) / area[:, None, None]


class TrueLattice(Memoryless):
    """The lattice's stress as the law a surrogate learnt; tangents by central differences."""

    cell, initialisation, density = CELL, "constrained-runs", CELL.density
    effort = "rve_solves"

    def stress(self, F, F_dot):
        return lattice_stress(F, F_dot)


def exact(F, F_dot):
    return F - np.swapaxes(np.linalg.inv(F), 1, 2) + 3.0 * F_dot


class TrueLaw(Remembering):
    """Exact, fails where F₁₁ > 2 and refuses where F₁₁ > 1.8; an accepted state adds 100 to F."""

    has_tangents, code = False, Status.UNSTABLE

    def __init__(self, cell=CELL, initialisation="elastic"):
        super().__init__(cell, initialisation, fails_above=2.0)
        self.accepted = []

    def stress(self, F, F_dot):
        return exact(F, F_dot)

    def refuses(self, F, F_dot):
        return F[:, 0, 0] > 1.8

    def accept(self, F, F_dot, response):
        self.accepted.append((F.copy(), response))
        accepted = super().accept(F, F_dot, response)
        return replace(accepted, state=PointStates(response.state.F + 100.0))


class WithoutTangents:
    """What a surrogate has without tangents."""

    has_tangents, stress_spread, range = False, 1.0, None
    is_calibrated, allowed = True, 1.0

    def with_tolerance(self, tolerance, relative):
        self.allowed = tolerance * self.stress_spread
        return self

    def local_tolerance(self, F, F_dot):
        return np.ones(len(F))

    def status_and_risk(self, F, F_dot, limit=np.inf):
        return self.lookup(F, F_dot, limit)[1:]

    def tangents(self, F, F_dot):
        raise InputError("tangents: none")


class Surrogate(WithoutTangents):
    """Off by one, which its spread allows; out of range from F₁₁ = 1.5, NaN below 0.5."""

    stress_spread = 1e4

    def __init__(self, cell=CELL, initialisation="elastic"):
        self.cell, self.initialisation, self.density = cell, initialisation, cell.density

    def lookup(self, F, F_dot, limit=np.inf):
        with np.errstate(invalid="ignore"):
            stress = exact(F, F_dot) + 1.0
        status = np.zeros(len(F), dtype=np.int8)
        status[F[:, 0, 0] >= 1.5] = Status.OUT_OF_RANGE
        status[F[:, 0, 0] < 0.5] = Status.NOT_FINITE
        status[~(det(F) > 0.0)] = Status.OUT_OF_RANGE
        stress[status != 0] = np.nan
        return stress, status, np.zeros(len(F))


def stretched(*stretches):
    F = np.eye(2) * np.ones((len(stretches), 1, 1))
    F[:, 0, 0] = stretches
    return F, np.full_like(F, 0.01)


class Truth(KelvinVoigt):
    """A viscoelastic solid in closed form as the true law of a cell."""

    cell, initialisation = CELL, "elastic"


class Learnt(WithoutTangents):
    """`Truth` with an error of 1 in direction and size `error(F, F_dot)` (n,), and a bound.

    Its risk is `bound(F, F_dot)` (n,) over the tolerance; out of range where `outside`.
    """

    cell, initialisation, density = CELL, "elastic", Truth().density
    stress_spread, has_tangents = 10.0, True

    def __init__(self, error, bound, outside=lambda F: np.zeros(len(F), dtype=bool)):
        self.truth, self.error, self.bound, self.outside = Truth(), error, bound, outside
        self.looked_up = 0

    def lookup(self, F, F_dot, limit=np.inf):
        self.looked_up += len(F)
        direction = np.array([[0.8, 0.0], [0.0, -0.6]])
        stress = self.truth.stress(F, F_dot) + self.error(F, F_dot)[:, None, None] * direction
        risk = self.bound(F, F_dot) / self.allowed
        status = np.where(risk <= limit, 0, Status.NOT_TRUSTED).astype(np.int8)
        status[self.outside(F)] = Status.OUT_OF_RANGE
        stress[status != 0] = np.nan
        return stress, status, risk

    def tangents(self, F, F_dot):
        """Of its own stress, error and all."""
        return tangents_by_differences(lambda *at: Learnt.lookup(self, *at)[0], F, F_dot, 1e-6)


def shear_error(size):
    """An error that changes its sign with position, up to `size`, µN/µm."""
    return lambda F, F_dot: size * np.sin(60.0 * F[:, 0, 1] + 40.0 * F[:, 1, 1])


@dataclass(frozen=True)
class Skin:
    """A surface law: P_s = a + b (λ − 1) + c (λ − 1)² + η (1 + d (λ − 1)) λ̇ up to a stretch."""

    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    eta: float = 0.0
    d: float = 0.0
    mass: float = 0.0
    depth: float = 0.0
    width: float = 0.0
    largest: float = np.inf

    def respond(self, stretch, stretch_rate, *, tangents=False):
        e = stretch - 1.0
        tension = self.a + self.b * e + self.c * e**2 + self.eta * (1.0 + self.d * e) * stretch_rate
        return SurfaceResponse(
            np.where(stretch <= self.largest, tension, np.nan),
            self.b + 2.0 * self.c * e + self.eta * self.d * stretch_rate if tangents else None,
            self.eta * (1.0 + self.d * e) if tangents else None,
        )

    def energy(self, stretch):
        """µN."""
        e = stretch - 1.0
        return self.a * e + 0.5 * self.b * e**2 + self.c * e**3 / 3.0
