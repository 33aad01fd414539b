"""The network: P̂ = RᵀP over the stretch U and the rate A = RᵀḞ, symmetric by construction.

    P̂ = ∂W/∂U-like part + Σ_t f_t(i(x)) m_t(x) + baseline

x: scaled inputs of `tensors`. The first part has the symmetric (Biot) components
∂W/∂(s, d, g) of an energy W(U), a function of C = U² as well, and the spin that makes the Cauchy
stress symmetric, so that P = ∂W/∂F. The second is what depends on rate: one tanh network gives
the factors f of all terms m from invariants i (see `features`). In forms with an energy every m
has a factor of A, so P̂(U, 0) = R ∂W/∂F exactly. The baseline is of the same make with
polynomials, fitted first by least squares; of degree 1 it is a linear Kelvin–Voigt law.
W for the square cell is a function of s, d², g², hence of tr C, (C₁₁ − C₂₂)² and C₁₂².

σ = P Fᵀ/det F. Every term is smooth, no sector is sorted into. An ensemble has several networks
over one baseline and answers with their mean.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import torch

from surrofe2.surrogate.features import STRETCH, Features, Product, make_features
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.tensors import INPUTS


class TanhNetwork(torch.nn.Module):
    """Fully connected layers with tanh between them; weights uniform within 1/√(inputs)."""

    def __init__(self, sizes: tuple[int, ...], generator: torch.Generator) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):  # torch fills layers first, by its global state
            layers = [torch.nn.Linear(*pair, dtype=torch.float64) for pair in pairwise(sizes)]
        self.layers = torch.nn.ModuleList(layers)
        with torch.no_grad():
            for layer in layers:
                bound = layer.in_features**-0.5
                for values in layer.parameters():
                    values.uniform_(-bound, bound, generator=generator)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """(n, outputs)."""
        for layer in self.layers[:-1]:
            values = torch.tanh(layer(values))
        return self.layers[-1](values)

    def gradient(self, values: torch.Tensor) -> torch.Tensor:
        """(n, inputs) gradient of the first output."""
        *inner, last = (layer for layer in self.layers if isinstance(layer, torch.nn.Linear))
        slopes = []
        for layer in inner:
            values = torch.tanh(layer(values))
            slopes.append(1.0 - values**2)
        back = last.weight[:1]
        for layer, slope in zip(reversed(inner), reversed(slopes), strict=True):
            back = (back * slope) @ layer.weight
        return back


class Member(torch.nn.Module):
    """One network of the ensemble: factors of the terms and, in forms with an energy, W."""

    factors: TanhNetwork
    energy: TanhNetwork | None

    def __init__(self, features: Features, settings: TrainingSettings, seed: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        sizes = (len(features.invariants), *settings.hidden, features.factors)
        self.factors = TanhNetwork(sizes, generator)
        self.energy = None
        if features.powers:
            self.energy = TanhNetwork((STRETCH, *settings.energy_hidden, 1), generator)


class Shapes(NamedTuple):
    """What the parts of a network are functions of; fixed in training.

    invariants (n, i); terms (n, t), their products; stretch (n, 3), scaled s, d, g.
    """

    invariants: torch.Tensor
    terms: torch.Tensor
    stretch: torch.Tensor


class StressNetwork(torch.nn.Module):
    """P̂(x) for inputs (n, 7) of `tensors.to_inputs`; output (n, 4) in µN/µm.

    Args:
        settings: form, degree of the baseline, sizes and number of networks, seed.
        symmetry: of the plant cell's arrangement, "D4" or "none".
    """

    input_scale: torch.Tensor
    output_scale: torch.Tensor
    energy_scale: torch.Tensor
    coefficients: torch.Tensor
    energy_coefficients: torch.Tensor
    resting: torch.Tensor
    factor_of: torch.Tensor
    owner: torch.Tensor

    def __init__(self, settings: TrainingSettings, symmetry: str = "D4") -> None:
        super().__init__()
        self.symmetry = symmetry
        self.features = make_features(settings.form, symmetry, settings.baseline_degree)
        self.members = torch.nn.ModuleList(
            Member(self.features, settings, settings.seed + k) for k in range(settings.members)
        )
        for name, size in (("input_scale", INPUTS), ("output_scale", 4), ("energy_scale", 1)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        for name, products_ in (
            ("coefficients", self.features.monomials),
            ("energy_coefficients", self.features.energy_monomials),
        ):
            self.register_buffer(name, torch.zeros(len(products_), dtype=torch.float64))
        for name, matrix in _incidence(self.features).items():
            self.register_buffer(name, matrix, persistent=False)

    @property
    def ensemble(self) -> list[Member]:
        """The members, as what they are."""
        return [member for member in self.members if isinstance(member, Member)]

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Components of P̂ (n, 4), µN/µm."""
        x = inputs / self.input_scale
        shapes = self.shapes(x)
        total = sum(self.correction(member, shapes) for member in self.ensemble)
        return self.baseline(x) + total / len(self.members)

    def shapes(self, x: torch.Tensor) -> Shapes:
        """All that `correction` needs of scaled inputs (n, 7)."""
        f = self.features
        terms = [term.product for term in f.terms]
        return Shapes(products(x, f.invariants), products(x, terms), x[:, :STRETCH])

    def correction(self, member: Member, shapes: Shapes) -> torch.Tensor:
        """What one network adds to the baseline (n, 4), µN/µm."""
        factors = member.factors(shapes.invariants)
        if self.resting.any():
            factors = factors - self.resting * member.factors(
                self.resting.new_zeros(1, len(self.features.invariants))
            )
        P = (factors @ self.factor_of) * shapes.terms @ self.owner * self.output_scale
        if member.energy is not None:
            slope = self._energy_slope(member.energy, shapes.stretch)
            P = P + self.elastic(self.energy_scale * slope, shapes.stretch)
        return P

    def elastic(self, slope: torch.Tensor, stretch: torch.Tensor) -> torch.Tensor:
        """P̂ (n, 4) from ∂W by the scaled s, d, g, (n, 3), at these."""
        widths = self.input_scale[:STRETCH]
        biot = 2.0 * slope / widths
        s, d, g = (stretch * widths).T
        spin = (biot[:, 1] * g - biot[:, 2] * d) / (2.0 + s)
        return torch.cat([biot, spin[:, None]], dim=1)

    def to_cauchy(self, x: torch.Tensor) -> torch.Tensor:
        """(n, 4, 4) that takes components of P̂ to those of S = P̂ U/det U, at scaled inputs."""
        s, d, g = (x[:, :STRETCH] * self.input_scale[:STRETCH]).T
        t, none = 2.0 + s, torch.zeros_like(s)
        rows = ((t, d, g, none), (d, t, none, -g), (g, none, t, d), (none, -g, d, t))
        matrix = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        return matrix * (2.0 / (t**2 - d**2 - g**2))[:, None, None]

    def baseline(self, x: torch.Tensor) -> torch.Tensor:
        """The polynomial part (n, 4), µN/µm, at scaled inputs."""
        values = x.new_zeros(len(x), 4)
        f = self.features
        if f.monomials:
            owner = torch.tensor([component for _, component in f.monomials])
            shapes = products(x, [product for product, _ in f.monomials])
            values = values.index_add(1, owner, shapes * self.coefficients)
        if f.energy_monomials:
            values = values + self.elastic(self._polynomial_slope(x), x[:, :STRETCH])
        return values

    def _energy_slope(self, energy: TanhNetwork, stretch: torch.Tensor) -> torch.Tensor:
        """∂W/∂(s, d, g) (n, 3) of the energy network, less what it is at rest."""
        squared = torch.tensor([power == 2 for power in self.features.powers])
        back = energy.gradient(torch.where(squared, stretch**2, stretch))
        back = back - ~squared * energy.gradient(stretch.new_zeros(1, STRETCH))
        return back * torch.where(squared, 2.0 * stretch, torch.ones_like(stretch))

    def _polynomial_slope(self, x: torch.Tensor) -> torch.Tensor:
        owner, coefficient, shapes = slope_table(self.features.energy_monomials)
        weights = self.energy_coefficients[[k for k, _ in coefficient]] * x.new_tensor(
            [number for _, number in coefficient]
        )
        return x.new_zeros(len(x), STRETCH).index_add(
            1, torch.tensor(owner), products(x, shapes) * weights
        )


def slope_table(
    monomials: Iterable[Product],
) -> tuple[list[int], list[tuple[int, float]], list[Product]]:
    """Derivatives of monomials of s, d, g: (by which, (monomial, factor), product) of each."""
    owner, coefficient, shapes = [], [], []
    for k, product in enumerate(monomials):
        for variable in sorted(set(product)):
            left = list(product)
            left.remove(variable)
            owner.append(variable)
            coefficient.append((k, float(product.count(variable))))
            shapes.append(tuple(left))
    return owner, coefficient, shapes


def products(x: torch.Tensor, factors: Iterable[Product]) -> torch.Tensor:
    """(n, m) products of the columns of x (n, 7) that `factors` names; an empty one is 1."""
    columns: dict[Product, torch.Tensor] = {(): torch.ones_like(x[:, 0])}

    def column(product: Product) -> torch.Tensor:
        if product not in columns:
            columns[product] = column(product[:-1]) * x[:, product[-1]]
        return columns[product]

    return torch.stack([column(product) for product in factors], dim=1)


def _incidence(features: Features) -> dict[str, torch.Tensor]:
    """As matrices of 0 and 1: whether a factor is subtracted at rest, which term has which factor
    and belongs to which component."""
    count = len(features.terms)
    resting = torch.zeros(features.factors, dtype=torch.float64)
    factor_of = torch.zeros(features.factors, count, dtype=torch.float64)
    owner = torch.zeros(count, 4, dtype=torch.float64)
    for k, term in enumerate(features.terms):
        factor_of[term.factor, k] = owner[k, term.component] = 1.0
        resting[term.factor] = float(not term.product)
    return {"resting": resting, "factor_of": factor_of, "owner": owner}
