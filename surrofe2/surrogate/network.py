"""The network in torch: P̂ = RᵀP over the stretch U and the rate A = RᵀḞ, symmetric by
construction.

    P̂ = Σ_t f_t(i(x)) m_t(x) + baseline,    σ = P Fᵀ/det F

x: scaled inputs of `tensors`. One tanh network gives the factors f of all terms m from invariants i
(see `features`). The baseline is a polynomial, fitted first by least squares. This module is needed
for training alone: a trained network leaves it as `NetworkParameters`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch

from surrofe2.base.arrays import Array
from surrofe2.base.tensors import INPUTS
from surrofe2.surrogate.features import BEND, COMPONENTS, NetworkParameters, make_features
from surrofe2.surrogate.products import STRETCH, Product, columns
from surrofe2.surrogate.settings import TrainingSettings

Pair = tuple[torch.Tensor, Any]
"""Values, and their slopes along a direction; None in place of the slopes where none are wanted."""


class Shapes(NamedTuple):
    """The arguments of a network's parts at n samples, which stay fixed in training.

    Attributes:
        x: (n, 7) scaled inputs.
        invariants: (n, i) products that the network reads.
        terms: (n, t) products that its outputs multiply.
    """

    x: torch.Tensor
    invariants: torch.Tensor
    terms: torch.Tensor


class StressNetwork(torch.nn.Module):
    """P̂(x) for inputs (n, 7) of `tensors.to_inputs`; output (n, 4) in µN/µm.

    Attributes:
        second_order: whether the baseline subtracts the network's slopes at rest, so that the
            slopes of the whole are those of the baseline alone and the network is of second order.
            In stored parameters they are already subtracted.
        input_scale: (7,) by which inputs are divided.
        output_scale: (4,) by which terms of a component are multiplied, µN/µm.
        coefficients: (m,) of the baseline's monomials, µN/µm.
        at_rest: (t,) 1 for a term whose factor at rest is subtracted, else 0.
        component_of: (t, 4) 1 where a term belongs to a component, else 0.
        owner: (m, 4) 1 where a monomial belongs to a component, else 0.
        factors: linear layers, with tanh between them.
    """

    input_scale: torch.Tensor
    output_scale: torch.Tensor
    coefficients: torch.Tensor
    at_rest: torch.Tensor
    component_of: torch.Tensor
    owner: torch.Tensor
    factors: Any

    def __init__(self, settings: TrainingSettings, symmetry: str = "D4") -> None:
        super().__init__()
        self.settings = settings
        self.symmetry = symmetry
        self.second_order = False
        self.features = make_features(symmetry, settings.baseline_degree)
        terms = self.features.terms
        generator = torch.Generator().manual_seed(settings.seed)
        sizes = (len(self.features.invariants), *settings.hidden, len(terms))
        # Layers are drawn by a generator of their own, so the seed alone decides the weights;
        # `skip_init` keeps torch's global generator out.
        self.factors = torch.nn.ModuleList(
            torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs, dtype=torch.float64)
            for inputs, outputs in pairwise(sizes)
        )
        for layer, inputs in zip(self.factors, sizes, strict=False):
            bound = inputs**-0.5  # torch's own choice for linear layers
            for values in layer.parameters():
                torch.nn.init.uniform_(values, -bound, bound, generator)
        monomials = self.features.monomials
        self.register_buffer("input_scale", torch.ones(INPUTS, dtype=torch.float64))
        self.register_buffer("output_scale", torch.ones(COMPONENTS, dtype=torch.float64))
        self.register_buffer("coefficients", torch.zeros(len(monomials), dtype=torch.float64))
        # What follows is derived from the features, so it is not stored.
        is_subtracted = [float(not product) for product, _ in terms]
        at_rest = torch.tensor(is_subtracted, dtype=torch.float64)
        self.register_buffer("at_rest", at_rest, persistent=False)
        self.register_buffer("component_of", _membership(terms), persistent=False)
        self.register_buffer("owner", _membership(monomials), persistent=False)

    def to_parameters(self) -> NetworkParameters:
        """Return all that the network is, as arrays; the baseline subtracts `rest_slopes`."""
        arrays = {name: values.numpy().copy() for name, values in self.state_dict().items()}
        with torch.no_grad():
            subtracted = self.rest_coefficients(self.rest_slopes().T)
            # monomials of higher order (NaN) have no slope at rest and stay as they are
            arrays["coefficients"] -= np.nan_to_num(subtracted)
        return NetworkParameters(self.symmetry, self.settings.baseline_degree, arrays)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Compute the components of P̂ (n, 4), µN/µm."""
        x = inputs / self.input_scale
        correction, _ = self.correction(self.shapes(x))
        return self.baseline(x) + correction

    def shapes(self, x: torch.Tensor) -> Shapes:
        """Compute all that `correction` needs of scaled inputs (n, 7)."""
        terms = [product for product, _ in self.features.terms]
        return Shapes(x, products(x, self.features.invariants), products(x, terms))

    def correction(self, shapes: Shapes, moving: Shapes | None = None) -> Pair:
        """Compute what the network adds to the baseline (n, 4), µN/µm.

        With it come the slopes (n, 4) along a direction, of which `moving` are the slopes of the
        shapes; None where `moving` is None.
        """
        P, slope = self._from_network(shapes, moving)
        rest_slopes = self.rest_slopes()
        P = P - shapes.x @ rest_slopes
        if moving is None:
            return P, None
        return P, slope - moving.x @ rest_slopes

    def rest_slopes(self) -> torch.Tensor:
        """Compute the network's slopes at rest (7, 4) that the baseline subtracts.

        They are 0 where it subtracts none, and where there is no baseline that could.
        """
        if not (self.second_order and self.features.monomials):
            return self.input_scale.new_zeros(INPUTS, COMPONENTS)
        shapes, moving = self._near_rest
        _, slopes = self._from_network(shapes, moving)
        return slopes

    @cached_property
    def _near_rest(self) -> tuple[Shapes, Shapes]:
        """The shapes at rest, one row for each input, and their slopes along that input."""
        rest = self.input_scale.new_zeros(INPUTS, INPUTS)
        return along(self.shapes, (rest,), (torch.eye(INPUTS, dtype=rest.dtype),))

    def _from_network(self, shapes: Shapes, moving: Shapes | None) -> Pair:
        """Compute Σ factor × term (n, 4), µN/µm, and its slopes along `moving`."""
        direction = None if moving is None else moving.invariants
        factors, factor_slopes = self._factors(shapes.invariants, direction)
        if self.at_rest.any():  # some terms are bare factors, which must vanish at rest
            rest = self.at_rest.new_zeros(1, len(self.features.invariants))
            factors_at_rest, _ = self._factors(rest)
            factors = factors - self.at_rest * factors_at_rest
        P = factors * shapes.terms @ self.component_of * self.output_scale
        if moving is None:
            return P, None
        slope = factor_slopes * shapes.terms + factors * moving.terms
        return P, slope @ self.component_of * self.output_scale

    def _factors(self, values: torch.Tensor, moving: torch.Tensor | None = None) -> Pair:
        """Compute the factors (n, t) of the terms from invariants `values` (n, i).

        With them come their slopes along a direction `moving` (n, i) of the invariants. These are
        written out, for torch's forward differentiation takes four times as long.
        """
        *inner, last = self.factors
        for layer in inner:
            values = torch.tanh(layer(values))
            if moving is not None:
                moving = (1.0 - values**2) * (moving @ layer.weight.T)
        factors = last(values)
        if moving is None:
            return factors, None
        return factors, moving @ last.weight.T

    def to_cauchy(self, x: torch.Tensor) -> torch.Tensor:
        """Return the matrices (n, 4, 4) that take components of P̂ to those of S = P̂ U/det U.

        They depend on the scaled inputs x (n, 7) by U alone.
        """
        s, d, g = (x[:, :STRETCH] * self.input_scale[:STRETCH]).T
        t = 2.0 + s  # tr U
        zero = torch.zeros_like(s)
        rows = ((t, d, g, zero), (d, t, zero, -g), (g, zero, t, d), (zero, -g, d, t))
        matrix = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        return matrix * (2.0 / (t**2 - d**2 - g**2))[:, None, None]

    def baseline(self, x: torch.Tensor) -> torch.Tensor:
        """Compute the polynomial part (n, 4), µN/µm, at scaled inputs x (n, 7)."""
        return self.monomials(x) @ (self.coefficients[:, None] * self.owner)

    def monomials(self, x: torch.Tensor) -> torch.Tensor:
        """Compute the monomials (n, m) of the baseline at scaled inputs x (n, 7)."""
        return products(x, [product for product, _ in self.features.monomials])

    def rest_coefficients(self, slopes: torch.Tensor) -> Array:
        """Return the coefficients (m,) by which the baseline has these slopes (4, 7) at rest.

        They are NaN for monomials of higher order, which have no slope at rest.
        """
        values = slopes.numpy()
        coefficients = np.full(len(self.features.monomials), np.nan)
        for m, (product, component) in enumerate(self.features.monomials):
            is_linear = len(product) == 1
            if is_linear:
                coefficients[m] = values[component, product[0]]
        return coefficients


def _membership(entries: Iterable[tuple[Product, int]]) -> torch.Tensor:
    """Return (k, 4) of (product, component): 1 at the component of each entry, 0 elsewhere."""
    components = [component for _, component in entries]
    return torch.eye(COMPONENTS, dtype=torch.float64)[components]


def products(x: torch.Tensor, factors: Iterable[Product]) -> torch.Tensor:
    """Compute products (n, m) of the inputs of `features`, by scaled inputs x (n, 7)."""
    stretch = x[:, :STRETCH]
    bent = stretch / (BEND**2 + stretch**2).sqrt()
    inputs = torch.cat([x, torch.ones_like(x[:, :1]), bent], dim=1)
    values = columns(inputs, factors)
    if not values:  # torch stacks no empty list
        return x[:, :0]
    return torch.stack(values, dim=1)


def along(function: Callable[..., Any], at: tuple[Any, ...], direction: tuple[Any, ...]) -> Any:
    """Return (function(*at), its derivative along a direction), by forward differentiation."""
    with warnings.catch_warnings():
        # torch's own first call of jvp goes through what torch has since deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.func.jvp(function, at, direction)
