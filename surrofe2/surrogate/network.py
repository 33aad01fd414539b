"""The network in torch: P̂ = RᵀP over the stretch U and the rate A = RᵀḞ, symmetric by
construction.

    P̂ = Σ_t f_t(i(x)) m_t(x) + baseline,    σ = P Fᵀ/det F

x: scaled inputs of `tensors`. One tanh network gives the factors f of all terms m from invariants i
(see `features`). The baseline is a polynomial, fitted first by least squares. Needed for training
alone: a trained network leaves as `NetworkParameters`.
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


class Shapes(NamedTuple):
    """What the parts of a network are functions of, fixed in training: scaled inputs x (n, 7),
    invariants (n, i) that the network reads, and terms (n, t), products."""

    x: torch.Tensor
    invariants: torch.Tensor
    terms: torch.Tensor


class StressNetwork(torch.nn.Module):
    """P̂(x) for inputs (n, 7) of `tensors.to_inputs`; output (n, 4) in µN/µm.

    Attributes:
        second_order: whether the baseline takes away the slopes at rest of what the network gives,
            so that its own are those of all. A network of stored parameters has had them taken.
    """

    input_scale: torch.Tensor
    output_scale: torch.Tensor
    coefficients: torch.Tensor
    at_rest: torch.Tensor
    component_of: torch.Tensor
    owner: torch.Tensor
    factors: Any
    """Linear layers, with tanh between them."""

    def __init__(self, settings: TrainingSettings, symmetry: str = "D4") -> None:
        super().__init__()
        self.settings, self.symmetry = settings, symmetry
        self.second_order = False
        self.features = make_features(symmetry, settings.baseline_degree)
        terms = self.features.terms
        generator = torch.Generator().manual_seed(settings.seed)
        sizes = (len(self.features.invariants), *settings.hidden, len(terms))
        self.factors = torch.nn.ModuleList(
            torch.nn.utils.skip_init(torch.nn.Linear, *pair, dtype=torch.float64)
            for pair in pairwise(sizes)
        )
        for layer, size in zip(self.factors, sizes, strict=False):
            for values in layer.parameters():
                torch.nn.init.uniform_(values, -(size**-0.5), size**-0.5, generator)
        monomials = self.features.monomials
        for name, size in (("input_scale", INPUTS), ("output_scale", COMPONENTS)):
            self.register_buffer(name, torch.ones(size, dtype=torch.float64))
        self.register_buffer("coefficients", torch.zeros(len(monomials), dtype=torch.float64))
        # of each term: whether its factor at rest is subtracted; of terms and monomials: their
        # components, as 0 and 1
        at_rest = torch.tensor([float(not product) for product, _ in terms], dtype=torch.float64)
        self.register_buffer("at_rest", at_rest, persistent=False)
        for name, named in (("component_of", terms), ("owner", monomials)):
            ones = torch.eye(COMPONENTS, dtype=torch.float64)[[k for _, k in named]]
            self.register_buffer(name, ones, persistent=False)

    def to_parameters(self) -> NetworkParameters:
        """All that the network is, as arrays; the baseline takes away `rest_slopes`."""
        arrays = {name: values.numpy().copy() for name, values in self.state_dict().items()}
        with torch.no_grad():
            arrays["coefficients"] -= np.nan_to_num(self.rest_coefficients(self.rest_slopes().T))
        return NetworkParameters(self.symmetry, self.settings.baseline_degree, arrays)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Components of P̂ (n, 4), µN/µm."""
        x = inputs / self.input_scale
        return self.baseline(x) + self.correction(self.shapes(x))[0]

    def shapes(self, x: torch.Tensor) -> Shapes:
        """All that `correction` needs of scaled inputs (n, 7)."""
        f = self.features
        terms = [product for product, _ in f.terms]
        return Shapes(x, products(x, f.invariants), products(x, terms))

    def correction(self, shapes: Shapes, moving: Shapes | None = None) -> Pair:
        """What the network adds to the baseline (n, 4), µN/µm, and its slopes (n, 4) along a
        direction `moving` of the shapes, None without one."""
        (P, slope), rest = self._from_network(shapes, moving), self.rest_slopes()
        return P - shapes.x @ rest, None if moving is None else slope - moving.x @ rest

    def rest_slopes(self) -> torch.Tensor:
        """(7, 4) slopes at rest of what the network gives, if the baseline takes them; else 0."""
        if not (self.second_order and self.features.monomials):
            return self.input_scale.new_zeros(INPUTS, 4)
        return self._from_network(*self._near_rest)[1]

    @cached_property
    def _near_rest(self) -> tuple[Shapes, Shapes]:
        rest = self.input_scale.new_zeros(INPUTS, INPUTS)
        return along(self.shapes, (rest,), (torch.eye(INPUTS, dtype=rest.dtype),))

    def _from_network(self, shapes: Shapes, moving: Shapes | None) -> Pair:
        factors, steeper = self._factors(shapes.invariants, moving and moving.invariants)
        if self.at_rest.any():  # of terms that are no products
            rest = self.at_rest.new_zeros(1, len(self.features.invariants))
            factors = factors - self.at_rest * self._factors(rest)[0]
        P = factors * shapes.terms @ self.component_of * self.output_scale
        if moving is None:
            return P, None
        slope = steeper * shapes.terms + factors * moving.terms
        return P, slope @ self.component_of * self.output_scale

    def _factors(self, values: torch.Tensor, moving: torch.Tensor | None = None) -> Pair:
        """(n, t) of the terms, and their slopes along a direction `moving` of invariants (n, i);
        written out, for torch's forward differentiation takes four times as long."""
        *inner, last = self.factors
        for layer in inner:
            values = torch.tanh(layer(values))
            if moving is not None:
                moving = (1.0 - values**2) * (moving @ layer.weight.T)
        return last(values), None if moving is None else moving @ last.weight.T

    def to_cauchy(self, x: torch.Tensor) -> torch.Tensor:
        """(n, 4, 4) that takes components of P̂ to those of S = P̂ U/det U, at scaled inputs."""
        s, d, g = (x[:, :STRETCH] * self.input_scale[:STRETCH]).T
        t, none = 2.0 + s, torch.zeros_like(s)
        rows = ((t, d, g, none), (d, t, none, -g), (g, none, t, d), (none, -g, d, t))
        matrix = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
        return matrix * (2.0 / (t**2 - d**2 - g**2))[:, None, None]

    def baseline(self, x: torch.Tensor) -> torch.Tensor:
        """The polynomial part (n, 4), µN/µm, at scaled inputs."""
        return self.monomials(x) @ (self.coefficients[:, None] * self.owner)

    def monomials(self, x: torch.Tensor) -> torch.Tensor:
        """(n, m) of the baseline."""
        return products(x, [product for product, _ in self.features.monomials])

    def rest_coefficients(self, slopes: torch.Tensor) -> Array:
        """Coefficients that give the baseline these slopes (4, 7) at rest; NaN: of higher order."""
        P = slopes.numpy()
        entries = self.features.monomials
        return np.array([P[k, one[0]] if len(one) == 1 else np.nan for one, k in entries])


def products(x: torch.Tensor, factors: Iterable[Product]) -> torch.Tensor:
    """(n, m) products of the inputs of `features`, by scaled inputs x (n, 7)."""
    stretch = x[:, :STRETCH]
    bent = stretch / (BEND**2 + stretch**2).sqrt()
    values = columns(torch.cat([x, torch.ones_like(x[:, :1]), bent], dim=1), factors)
    return torch.stack(values, dim=1) if values else x[:, :0]


def along(function: Callable[..., Any], at: tuple[Any, ...], direction: tuple[Any, ...]) -> Any:
    """(function(*at), its derivative along a direction), by forward differentiation."""
    with warnings.catch_warnings():
        # torch's own first call of jvp goes through what torch has since deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.func.jvp(function, at, direction)
