"""The network in torch: P̂ = RᵀP over the stretch U and the rate A = RᵀḞ, symmetric by construction.

    P̂ = ∂W/∂U-like part + Σ_t f_t(i(x)) m_t(x) + baseline

x: scaled inputs of `tensors`. The first part has the symmetric (Biot) components
∂W/∂(s, d, g) of an energy W(U), a function of C = U² as well, and the spin that makes the Cauchy
stress symmetric, so that P = ∂W/∂F. The second is what depends on rate: one tanh network gives
the factors f of all terms m from invariants i (see `features`). In the form with an energy every m
has a factor of A, so P̂(U, 0) = R ∂W/∂F exactly. The baseline is of the same make with
polynomials, fitted first by least squares; of degree 1 it is a linear Kelvin–Voigt law.
W for the square cell is a function of s, d², g², hence of tr C, (C₁₁ − C₂₂)² and C₁₂².

σ = P Fᵀ/det F. Every term is smooth, no sector is sorted into. Needed for training alone: a trained
network leaves as `NetworkParameters`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.surrogate.features import BEND, STRETCH, Product, differentiated, make_features
from surrofe2.surrogate.network_arrays import NetworkParameters
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.tensors import INPUTS

Pair = tuple[torch.Tensor, torch.Tensor]


class TanhNetwork(torch.nn.ModuleList):
    """Fully connected layers with tanh between them; weights uniform within 1/√(inputs)."""

    def __init__(self, sizes: tuple[int, ...], generator: torch.Generator) -> None:
        with torch.random.fork_rng(devices=[]):  # torch fills layers first, by its global state
            layers = [torch.nn.Linear(*pair, dtype=torch.float64) for pair in pairwise(sizes)]
        super().__init__(layers)
        with torch.no_grad():
            for layer in layers:
                bound = layer.in_features**-0.5
                for values in layer.parameters():
                    values.uniform_(-bound, bound, generator=generator)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """(n, outputs)."""
        *inner, last = self.linear
        for layer in inner:
            values = torch.tanh(layer(values))
        return last(values)

    def along(self, values: torch.Tensor, moving: torch.Tensor) -> Pair:
        """(n, outputs), and their slopes along a direction `moving` of the inputs (n, inputs)."""
        *inner, last = self.linear
        for layer in inner:
            values = torch.tanh(layer(values))
            moving = (1.0 - values**2) * (moving @ layer.weight.T)
        return last(values), moving @ last.weight.T

    def gradient(self, values: torch.Tensor) -> torch.Tensor:
        """(n, inputs) gradient of the first output."""
        *inner, last = self.linear
        slopes = []
        for layer in inner:
            values = torch.tanh(layer(values))
            slopes.append(1.0 - values**2)
        back = last.weight[:1]
        for layer, slope in zip(reversed(inner), reversed(slopes), strict=True):
            back = (back * slope) @ layer.weight
        return back

    @property
    def linear(self) -> list[torch.nn.Linear]:
        """Its layers."""
        return [layer for layer in self if isinstance(layer, torch.nn.Linear)]


class Shapes(NamedTuple):
    """What the parts of a network are functions of; fixed in training.

    x (n, 7), scaled inputs; invariants (n, i) that the network reads; terms (n, t), products.
    """

    x: torch.Tensor
    invariants: torch.Tensor
    terms: torch.Tensor


class StressNetwork(torch.nn.Module):
    """P̂(x) for inputs (n, 7) of `tensors.to_inputs`; output (n, 4) in µN/µm.

    Args:
        settings: form, degree of the baseline, sizes of the networks, seed.
        symmetry: of the plant cell's arrangement, "D4" or "none".

    Attributes:
        second_order: whether the baseline takes away the slopes at rest of what the networks give,
            so that its own are those of all. A network of stored parameters has had them taken.
    """

    input_scale: torch.Tensor
    output_scale: torch.Tensor
    energy_scale: torch.Tensor
    coefficients: torch.Tensor
    energy_coefficients: torch.Tensor
    at_rest: torch.Tensor
    component_of: torch.Tensor

    def __init__(self, settings: TrainingSettings, symmetry: str = "D4") -> None:
        super().__init__()
        self.settings, self.symmetry = settings, symmetry
        self.second_order = False
        self.features = make_features(settings.form, symmetry, settings.baseline_degree)
        terms = self.features.terms
        generator = torch.Generator().manual_seed(settings.seed)
        sizes = (self.features.read, *settings.hidden, len(terms))
        self.factors = TanhNetwork(sizes, generator)
        self.energy: TanhNetwork | None = None
        if self.features.elastic:
            self.energy = TanhNetwork((STRETCH, *settings.energy_hidden, 1), generator)
        for name, size in (("input_scale", INPUTS), ("output_scale", 4), ("energy_scale", 1)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        for name, size in (
            ("coefficients", len(self.features.monomials)),
            ("energy_coefficients", len(self.features.energy_monomials)),
        ):
            self.register_buffer(name, torch.zeros(size, dtype=torch.float64))
        # of each term: whether its factor at rest is subtracted, and its component, as 0 and 1
        at_rest = torch.tensor([float(not product) for product, _ in terms], dtype=torch.float64)
        self.register_buffer("at_rest", at_rest, persistent=False)
        component_of = torch.nn.functional.one_hot(torch.tensor([k for _, k in terms]), 4)
        self.register_buffer("component_of", component_of.double(), persistent=False)

    @classmethod
    def of(cls, parameters: NetworkParameters, settings: TrainingSettings) -> StressNetwork:
        """The network that left as these parameters."""
        network = cls(settings, parameters.symmetry)
        tensors = parameters.tensors.items()
        network.load_state_dict({name: torch.from_numpy(values) for name, values in tensors})
        return network

    def to_parameters(self) -> NetworkParameters:
        """All that the network is, as arrays; the baseline takes away `rest_slopes`."""
        arrays = {name: values.numpy().copy() for name, values in self.state_dict().items()}
        with torch.no_grad():
            linear = np.nan_to_num(self.rest_coefficients(self.rest_slopes().T))
        cut = len(self.energy_coefficients)
        arrays["energy_coefficients"] -= linear[:cut]
        arrays["coefficients"] -= linear[cut:]
        settings = self.settings
        return NetworkParameters(settings.form, self.symmetry, settings.baseline_degree, arrays)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Components of P̂ (n, 4), µN/µm."""
        x = inputs / self.input_scale
        return self.baseline(x) + self.correction(self.shapes(x))

    def shapes(self, x: torch.Tensor) -> Shapes:
        """All that `correction` needs of scaled inputs (n, 7)."""
        f = self.features
        terms = [product for product, _ in f.terms]
        invariants = torch.cat([products(x, f.invariants), self._near_invariants(x)], dim=1)
        return Shapes(x, invariants, products(x, terms))

    def correction(self, shapes: Shapes) -> torch.Tensor:
        """What the networks add to the baseline (n, 4), µN/µm."""
        return self._from_networks(shapes) - self._by_moduli(shapes.x, self.rest_slopes())

    def correction_along(self, shapes: Shapes, moving: Shapes) -> Pair:
        """`correction`, and its slopes (n, 4) along a direction, that of `moving` of the shapes.

        It is written out, for torch's forward differentiation takes four times as long.
        """
        (P, slope), rest = self._from_networks_along(shapes, moving), self.rest_slopes()
        if self.energy is None:  # linear
            return P - self._by_moduli(shapes.x, rest), slope - self._by_moduli(moving.x, rest)
        taken, sloped = along(lambda x: self._by_moduli(x, rest), (shapes.x,), (moving.x,))
        return P - taken, slope - sloped

    def _by_moduli(self, x: torch.Tensor, slopes: torch.Tensor) -> torch.Tensor:
        """(n, 4) at scaled inputs: what has these slopes (7, 4) at rest, as the baseline has it."""
        if self.energy is None:
            return x @ slopes
        stretch, widths = x[:, :STRETCH], self.input_scale[:STRETCH]
        elastic = self.elastic(stretch @ (0.5 * slopes[:STRETCH, :STRETCH] * widths), stretch)
        return elastic + x[:, STRETCH:] @ slopes[STRETCH:]

    def rest_slopes(self) -> torch.Tensor:
        """(7, 4) slopes at rest of what the networks give, if the baseline takes them; else 0."""
        if not (self.second_order and self.features.monomials):
            return self.input_scale.new_zeros(INPUTS, 4)
        return self._from_networks_along(*self._near_rest)[1]

    @cached_property
    def _near_rest(self) -> tuple[Shapes, Shapes]:
        """The shapes at rest, a row for each input, and their slopes by it."""
        rest = self.input_scale.new_zeros(INPUTS, INPUTS)
        return along(self.shapes, (rest,), (torch.eye(INPUTS, dtype=rest.dtype),))

    def _from_networks(self, shapes: Shapes) -> torch.Tensor:
        stretch = shapes.x[:, :STRETCH]
        factors = self.factors(shapes.invariants) - self._factors_at_rest()
        P = factors * shapes.terms @ self.component_of * self.output_scale
        if self.energy is not None:
            slope = self._energy_slope(self.energy, stretch)
            P = P + self.elastic(self.energy_scale * slope, stretch)
        return P

    def _from_networks_along(self, shapes: Shapes, moving: Shapes) -> Pair:
        factors, steeper = self.factors.along(shapes.invariants, moving.invariants)
        factors = factors - self._factors_at_rest()
        P = factors * shapes.terms @ self.component_of * self.output_scale
        sloped = steeper * shapes.terms + factors * moving.terms
        slope = sloped @ self.component_of * self.output_scale
        if self.energy is not None:
            energy = self.energy
            elastic, bent = along(
                lambda x: self.elastic(self.energy_scale * self._energy_slope(energy, x), x),
                (shapes.x[:, :STRETCH],),
                (moving.x[:, :STRETCH],),
            )
            P, slope = P + elastic, slope + bent
        return P, slope

    def _factors_at_rest(self) -> torch.Tensor:
        """(1, t), of the terms that are no products; 0 of the others."""
        if not self.at_rest.any():
            return self.at_rest
        rest = self.at_rest.new_zeros(1, self.features.read)
        taken: torch.Tensor = self.at_rest * self.factors(rest)
        return taken

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
            monomial, variable, shapes = self._energy_derivatives(x)
            weighted = shapes * self.energy_coefficients[monomial]
            slope = x.new_zeros(len(x), STRETCH).index_add(1, variable, weighted)
            values = values + self.elastic(slope, x[:, :STRETCH])
        return values

    def baseline_columns(self, x: torch.Tensor) -> torch.Tensor:
        """(n, 4, m): what a unit of each coefficient, those of the energy first, adds to P̂."""
        f = self.features
        count = len(f.energy_monomials)
        slopes = x.new_zeros(len(x), STRETCH * count)
        if f.energy_monomials:
            monomial, variable, shapes = self._energy_derivatives(x)
            slopes = slopes.index_add(1, STRETCH * monomial + variable, shapes)
        repeated = x[:, :STRETCH].repeat_interleave(count, dim=0)
        elastic = self.elastic(slopes.reshape(-1, STRETCH), repeated).reshape(len(x), count, 4)
        rest = x.new_zeros(len(x), len(f.monomials), 4)
        if f.monomials:
            component = torch.nn.functional.one_hot(torch.tensor([k for _, k in f.monomials]), 4)
            rest = component * products(x, [product for product, _ in f.monomials])[:, :, None]
        return torch.cat([elastic, rest], dim=1).transpose(1, 2)

    def rest_coefficients(self, slopes: torch.Tensor) -> NDArray[np.float64]:
        """Coefficients that give the baseline these slopes (4, 7) at rest; NaN: of higher order.

        Those of the energy come first, as in `baseline_columns`.
        """
        f, P = self.features, slopes.numpy()
        by_x = 0.5 * self.input_scale[:STRETCH, None].numpy() * P[:STRETCH, :STRETCH]
        hessian = 0.5 * (by_x + by_x.T)  # of the energy
        elastic = [
            hessian[product] / (1 + (product[0] == product[1])) if len(product) == 2 else np.nan
            for product in f.energy_monomials
        ]
        linear = [
            P[component, product[0]] if len(product) == 1 else np.nan
            for product, component in f.monomials
        ]
        return np.array(elastic + linear)

    def _energy_derivatives(
        self, x: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Which energy monomial (m,), by which of s, d, g (m,), and the derivatives (n, m)."""
        parts = [
            (k, variable, number, left)
            for k, product in enumerate(self.features.energy_monomials)
            for variable, number, left in differentiated(product)
        ]
        monomial, variable, numbers, left_over = zip(*parts, strict=True)
        values = products(x, left_over) * x.new_tensor(numbers)
        return torch.tensor(monomial), torch.tensor(variable), values

    def _near_invariants(self, x: torch.Tensor) -> torch.Tensor:
        """(n, 3) that tell states near rest apart, see `features`."""
        stretch = x[:, :STRETCH]
        return torch.where(self._squared, stretch**2, stretch) / (BEND**2 + stretch**2).sqrt()

    @cached_property
    def _squared(self) -> torch.Tensor:
        """(3,) whether s, d and g are squared where they must not have a sign."""
        return torch.tensor([power == 2 for power in self.features.powers])

    def _energy_slope(self, energy: TanhNetwork, stretch: torch.Tensor) -> torch.Tensor:
        """∂W/∂(s, d, g) (n, 3) of the energy network, less what it is at rest."""
        back = energy.gradient(torch.where(self._squared, stretch**2, stretch))
        back = back - ~self._squared * energy.gradient(stretch.new_zeros(1, STRETCH))
        return back * torch.where(self._squared, 2.0 * stretch, torch.ones_like(stretch))


def products(x: torch.Tensor, factors: Iterable[Product]) -> torch.Tensor:
    """(n, m) products of the columns of x (n, 7) that `factors` names; an empty one is 1."""
    columns: dict[Product, torch.Tensor] = {(): torch.ones_like(x[:, 0])}

    def column(product: Product) -> torch.Tensor:
        if product not in columns:
            columns[product] = column(product[:-1]) * x[:, product[-1]]
        return columns[product]

    return torch.stack([column(product) for product in factors], dim=1)


def along(function: Callable[..., Any], at: tuple[Any, ...], direction: tuple[Any, ...]) -> Any:
    """(function(*at), its derivative along a direction), by forward differentiation."""
    with warnings.catch_warnings():
        # torch's own first call of jvp goes through what torch has since deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.func.jvp(function, at, direction)
