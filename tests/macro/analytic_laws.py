"""Stress laws in closed form, so that the macro scale is tested without any RVE."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressResponse,
    Tangents,
    check_deformation,
)

IDENTITY = np.eye(2)


def determinant(F):
    return F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]


def velocity_gradient(F, F_dot):
    """L = Ḟ F⁻¹."""
    return F_dot @ np.linalg.inv(F)


class Memoryless:
    """A law whose stress depends on (F, Ḟ) alone; subclasses say how in `stress` and, by
    ∂P/∂F and ∂P/∂Ḟ, in `slopes`."""

    density, has_tangents = 0.08, True

    def stress(self, F, F_dot):
        raise NotImplementedError

    def slopes(self, F, F_dot):
        raise NotImplementedError

    def respond(self, F, F_dot, state: Any = None, *, tangents=False) -> StressResponse:
        F, F_dot = check_deformation(F, F_dot)
        return StressResponse(
            stress=self.stress(F, F_dot),
            status=np.zeros(len(F), np.int8),
            effort={"evaluations": len(F)},
            tangents=Tangents(*self.slopes(F, F_dot)) if tangents else None,
        )

    def accept(self, F, F_dot, response) -> Acceptance:
        return Acceptance(np.zeros(len(F), np.int8), response.state)


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
        J = determinant(F)[:, None, None]
        left = F @ F.transpose(0, 2, 1)
        elastic = (self.shear_modulus * (left - IDENTITY) + self.lame * np.log(J) * IDENTITY) / J
        L = velocity_gradient(F, F_dot)
        D = 0.5 * (L + L.transpose(0, 2, 1))
        trace = np.einsum("nii->n", D)[:, None, None]
        viscous = 2.0 * self.shear_viscosity * (D - 0.5 * trace * IDENTITY)
        return elastic + viscous + self.bulk_viscosity * trace * IDENTITY

    def slopes(self, F, F_dot):
        """P = µ F + (λ ln J − µ) G + J V G with G = F⁻ᵀ, V_im = 𝕍_imab L_ab the viscous stress;
        ∂G_ij/∂F_kl = −G_il G_kj, ∂L_ab/∂F_kl = −L_ak G_bl, ∂L_ab/∂Ḟ_kl = δ_ak G_bl."""
        J, G, L = determinant(F), np.linalg.inv(F).transpose(0, 2, 1), velocity_gradient(F, F_dot)
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
        return self.first_piola(F) @ F.transpose(0, 2, 1) / determinant(F)[:, None, None]

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
        return P @ F.transpose(0, 2, 1) / determinant(F)[:, None, None]

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
        stress = P @ F.transpose(0, 2, 1) / determinant(F)[:, None, None]
        return StressResponse(stress, np.zeros(len(F), np.int8), (F[:, 0, 0].copy(), friction))

    def accept(self, F, F_dot, response) -> Acceptance:
        self.committed.append(response.state)
        return Acceptance(np.zeros(len(F), np.int8), response.state)


@dataclass
class Failing:
    """Another law that fails where `fails(F, F_dot)` (n,) says so, or at `accept` likewise."""

    inner: Any
    fails: Any = None
    refuses: Any = None
    code: Status = Status.NOT_CONVERGED
    has_tangents = False

    @property
    def density(self):
        return self.inner.density

    def respond(self, F, F_dot, state=None, *, tangents=False) -> StressResponse:
        answer = self.inner.respond(F, F_dot, state)
        if self.fails is None:
            return answer
        bad = self.fails(F, F_dot)
        stress = np.where(bad[:, None, None], np.nan, answer.stress)
        return StressResponse(stress, np.where(bad, self.code, 0).astype(np.int8), answer.state)

    def accept(self, F, F_dot, response) -> Acceptance:
        answer = self.inner.accept(F, F_dot, response)
        if self.refuses is None:
            return answer
        bad = self.refuses(F, F_dot)
        return Acceptance(np.where(bad, self.code, 0).astype(np.int8), answer.state)
