"""The network: S(U, A) in the components of `components`, with D4 by construction.

    S_k = scale_k [ Σ_m m(x) g_m(i(x)) ] + Σ_p c_p p(x)

x: scaled inputs. i(x): the 13 invariants, products of inputs that D4 leaves alone. m: covariants,
the simplest products with the parity of S_k. g: one tanh network from invariants to the factors
of all covariants; for the sum, g₀(i(x)) − g₀(0). p: the monomials of low degree, each with the
parity of one component only (the baseline, fitted by least squares). Every term is smooth, no
sector is sorted into, and S(I, 0) = 0 exactly.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.surrogate.components import INPUTS, SUM, monomials, parity

Array = NDArray[np.float64]

# input numbers: sum s, difference d, shear g of U − I; sum S, difference D, shear G, spin W of A
_s, _d, _g, _S, _D, _G, _W = range(INPUTS)
INVARIANTS = (
    (_s,), (_S,),
    (_d, _d), (_d, _D), (_D, _D), (_g, _g), (_g, _G), (_G, _G), (_W, _W),
    (_d, _g, _W), (_d, _G, _W), (_g, _D, _W), (_D, _G, _W),
)  # fmt: skip
COVARIANTS = (
    (_d,), (_D,), (_g, _W), (_G, _W),
    (_g,), (_G,), (_d, _W), (_D, _W),
    (_W,), (_d, _g), (_d, _G), (_g, _D), (_D, _G),
)  # fmt: skip


class StressNetwork(torch.nn.Module):
    """S(x) for inputs (n, 7) of `components.to_inputs`; output (n, 4) in µN/µm.

    Args:
        hidden: sizes of the tanh layers.
        degree: of the baseline's monomials; 0: no baseline.
        seed: of the initial weights, uniform within 1/√(inputs of the layer).
    """

    input_scale: torch.Tensor
    output_scale: torch.Tensor
    coefficients: torch.Tensor

    def __init__(self, hidden: tuple[int, ...], degree: int, seed: int = 0) -> None:
        super().__init__()
        self.monomials = monomials(degree)
        sizes = (len(INVARIANTS), *hidden, 1 + len(COVARIANTS))
        with torch.random.fork_rng(devices=[]):  # torch fills layers first, by its global state
            layers = [torch.nn.Linear(*pair, dtype=torch.float64) for pair in pairwise(sizes)]
        self.layers = torch.nn.ModuleList(layers)
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            for layer in layers:
                bound = layer.in_features**-0.5
                for values in layer.parameters():
                    values.uniform_(-bound, bound, generator=generator)
        self.register_buffer("input_scale", torch.ones(INPUTS, dtype=torch.float64))
        self.register_buffer("output_scale", torch.ones(4, dtype=torch.float64))
        self.register_buffer("coefficients", torch.zeros(len(self.monomials), dtype=torch.float64))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Components of S (n, 4), µN/µm."""
        x = inputs / self.input_scale
        correction = self.correction(products(x, INVARIANTS), products(x, COVARIANTS))
        return self.baseline(x) + self.output_scale * correction

    def correction(self, invariants: torch.Tensor, covariants: torch.Tensor) -> torch.Tensor:
        """What the network adds to the baseline (n, 4), in units of `output_scale`."""
        factors = self._factors(invariants)
        at_rest = self._factors(torch.zeros_like(invariants[:1]))
        total = factors[:, :1] - at_rest[:, :1]
        return torch.cat([total, *_by_component(factors[:, 1:] * covariants)], dim=1)

    def baseline(self, x: torch.Tensor) -> torch.Tensor:
        """The low-degree polynomial (n, 4) in µN/µm, at scaled inputs."""
        values = x.new_zeros(len(x), 4)
        if self.monomials:
            target = torch.tensor([parity(product) for product in self.monomials])
            values.index_add_(1, target, products(x, self.monomials) * self.coefficients)
        return values

    def _factors(self, invariants: torch.Tensor) -> torch.Tensor:
        values = invariants
        for layer in self.layers[:-1]:
            values = torch.tanh(layer(values))
        return self.layers[-1](values)


def fit_baseline(x: Array, components: Array, degree: int) -> Array:
    """Coefficients (m,) of the monomials that fit the components (n, 4) best, at scaled inputs.

    Least squares, each component with the monomials of its own parity. Monomials that do not
    vary (a range of zero width) get 0, as the solution of least norm has it.
    """
    basis = monomials(degree)
    owner = np.array([parity(product) for product in basis])
    coefficients = np.zeros(len(basis))
    for component in range(4):
        chosen = np.flatnonzero(owner == component)
        if len(chosen):
            columns = np.stack([x[:, list(basis[k])].prod(axis=1) for k in chosen], axis=1)
            solution = np.linalg.lstsq(columns, components[:, component], rcond=None)[0]
            coefficients[chosen] = solution
    return coefficients


def products(x: torch.Tensor, factors: tuple[tuple[int, ...], ...]) -> torch.Tensor:
    """(n, m) products of the columns of x (n, 7) that `factors` names."""
    columns: dict[tuple[int, ...], torch.Tensor] = {}
    for product in factors:
        prefix = columns.get(product[:-1])
        if prefix is None and len(product) > 1:
            prefix = x[:, list(product[:-1])].prod(dim=1)
        last = x[:, product[-1]]
        columns[product] = last if prefix is None else prefix * last
    return torch.stack([columns[product] for product in factors], dim=1)


def _by_component(terms: torch.Tensor) -> list[torch.Tensor]:
    owner = [parity(product) for product in COVARIANTS]
    return [
        terms[:, [k for k, component in enumerate(owner) if component == target]].sum(
            dim=1, keepdim=True
        )
        for target in range(SUM + 1, 4)
    ]
