"""From samples to a `SurrogateLaw`: polynomial by least squares, network by L-BFGS.

Samples with tangents are trained on those as well (Sobolev): the polynomial on all of them, the
network on the slope along one random direction of the inputs a sample. For a network this small
and a stress this smooth, full-batch quasi-Newton steps in float64 reach errors that stochastic
gradients do not in the same time.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.polar_inputs import INPUTS, to_inputs
from surrofe2.sampling import TANGENTS, StressSamples
from surrofe2.surrogate.baseline import fit_baseline
from surrofe2.surrogate.components import input_scale
from surrofe2.surrogate.domain import fit_domain
from surrofe2.surrogate.features import STRETCH
from surrofe2.surrogate.held_out_errors import measure_errors
from surrofe2.surrogate.network import Member, Shapes, StressNetwork
from surrofe2.surrogate.network_slopes import along
from surrofe2.surrogate.piola import to_piola, to_slopes
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.trust_features import has_square_symmetry

Array = NDArray[np.float64]
Progress = Callable[[int, int, dict[str, float]], None]
Checkpoint = Callable[[dict[str, Any]], None]

LEAST_SAMPLES = 20
_ITERATIONS_A_ROUND = 20
_OUTLIER = 8.0  # times the median of what the baseline leaves of a slope: of no use for training
_LEAST_SPREAD = 0.1  # a component of less than this share of the largest counts as one of it


def train(
    samples: StressSamples,
    settings: TrainingSettings,
    *,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resume: dict[str, Any] | None = None,
    symmetry: str | None = None,
) -> SurrogateLaw:
    """Fit a surrogate to the valid samples; the same seed and threads give the same surrogate.

    Args:
        progress: called with (iterations done, iterations in all, figures), among the figures
            `loss` (training) and `held_out_rms`, both relative to the spread of stress.
        checkpoint: called now and then, and when interrupted by the keyboard, with a state of
            tensors and plain data that `torch.load(…, weights_only=True)` reads back.
        resume: such a state, to carry on from.
        symmetry: "D4" or "none"; None: that of the plant cell's arrangement.

    Raises:
        InputError: fewer than `LEAST_SAMPLES` valid samples, or form "potentials" for constrained
            runs.
        MismatchError: the state to resume is of other samples or settings.
        SimulationError: the loss is not finite.
    """
    _check_form(settings, samples.initialisation)
    valid = samples.valid
    count = len(valid.F)
    if count < LEAST_SAMPLES:
        raise InputError(f"samples: {count} valid; training needs at least {LEAST_SAMPLES}")
    order = np.random.default_rng(settings.seed).permutation(count)
    kept_out = max(2, round(settings.held_out * count))
    held_out, fitted = order[:kept_out], order[kept_out:]
    identity = {"data_fingerprint": samples.fingerprint, "settings": repr(settings)}

    data = _read(valid, settings)
    symmetry = symmetry or ("D4" if has_square_symmetry(samples.cell) else "none")
    network = StressNetwork(settings, symmetry)
    network.input_scale.copy_(torch.from_numpy(input_scale(valid.range)))
    _fit_baseline(network, data.at(fitted), settings)
    task, test = (_make_task(network, data.at(part), settings) for part in (fitted, held_out))
    _set_scales(network, task)
    _minimise(network, task, test, settings, identity, progress, checkpoint, resume)

    network = network.to(getattr(torch, settings.precision))
    law = SurrogateLaw(
        network=network,
        cell=samples.cell,
        initialisation=samples.initialisation,
        range=samples.range,
        settings=settings,
        errors={},
        data_fingerprint=samples.fingerprint,
        rest_length=samples.rest_length,
        domain=fit_domain(samples),
    )
    return replace(law, errors=measure_errors(law, _subset(valid, held_out)))


def _check_form(settings: TrainingSettings, initialisation: str) -> None:
    if settings.form == "potentials" and initialisation == "constrained-runs":
        raise InputError(
            "training.form: potentials; the viscous tangent of constrained-runs is not symmetric, "
            "so no dissipation potential has it; use form energy"
        )


@dataclass(frozen=True)
class _Data:
    """Scaled inputs (n, 7), P̂ (n, 4) and, where the samples have tangents, its slopes by x."""

    x: torch.Tensor
    target: torch.Tensor
    slopes: torch.Tensor | None

    def at(self, chosen: NDArray[np.int64]) -> _Data:
        slopes = None if self.slopes is None else self.slopes[chosen]
        return _Data(self.x[chosen], self.target[chosen], slopes)


def _read(samples: StressSamples, settings: TrainingSettings) -> _Data:
    inputs, _ = to_inputs(samples.F, samples.F_dot)
    scale = input_scale(samples.range)
    target = torch.from_numpy(to_piola(samples.F, samples.stress))
    by_F, by_rate = samples.P_by_F, samples.P_by_F_dot
    slopes = None
    if settings.tangent_weight > 0.0 and by_F is not None and by_rate is not None:
        slopes = torch.from_numpy(to_slopes(samples.F, by_F, by_rate) * scale)
    return _Data(torch.from_numpy(inputs / scale), target, slopes)


@dataclass(frozen=True)
class _Task:
    """What a network is to add to the baseline, and the matrices that take it to Cauchy stress.

    `weight` (4,): of the squared error of a component of S = Rᵀ σ R. `slope` (n, 4): of P̂ along
    one direction a sample, along which the shapes have the slopes `moving`; both None where there
    are no tangents. `slope_weight` (n, 1): of its squared error, 0 at outliers.
    """

    shapes: Shapes
    target: torch.Tensor
    to_cauchy: torch.Tensor
    weight: torch.Tensor
    moving: Shapes | None = None
    slope: torch.Tensor | None = None
    slope_weight: torch.Tensor | float = 0.0

    def loss(self, network: StressNetwork, member: Member) -> torch.Tensor:
        """Mean square error relative to the spread of each component, with that of slopes."""
        if self.moving is None:
            return self._mean_square(network.correction(member, self.shapes) - self.target)
        found, slope = along(
            lambda *shapes: network.correction(member, Shapes(*shapes)), self.shapes, self.moving
        )
        by_stress = self._mean_square(found - self.target)
        return by_stress + (self.slope_weight * self._squares(slope - self.slope)).mean()

    def _mean_square(self, error: torch.Tensor) -> torch.Tensor:
        return self._squares(error).mean()

    def _squares(self, error: torch.Tensor) -> torch.Tensor:
        cauchy = torch.matmul(self.to_cauchy, error[:, :, None])[:, :, 0]
        return cauchy**2 * self.weight

    def stress_loss(self, network: StressNetwork, member: Member) -> torch.Tensor:
        """The mean square error of stress alone."""
        return replace(self, moving=None).loss(network, member)


def _fit_baseline(network: StressNetwork, data: _Data, settings: TrainingSettings) -> None:
    weight = 1.0 / _spread(data.target) ** 2
    fit_baseline(network, data.x, data.target, weight, data.slopes, settings.tangent_weight)


def _spread(target: torch.Tensor) -> torch.Tensor:
    spread = target.std(dim=0)
    return spread.clamp(min=max(_LEAST_SPREAD * float(spread.max()), np.finfo(float).tiny))


def _make_task(network: StressNetwork, data: _Data, settings: TrainingSettings) -> _Task:
    to_cauchy = network.to_cauchy(data.x)
    task = _Task(
        shapes=network.shapes(data.x),
        target=data.target - network.baseline(data.x),
        to_cauchy=to_cauchy,
        weight=1.0 / _spread(torch.einsum("nij,nj->ni", to_cauchy, data.target)) ** 2,
    )
    if data.slopes is None:
        return task
    directions = np.random.default_rng(settings.seed).standard_normal((len(data.x), INPUTS))
    direction = torch.from_numpy(directions)
    below = along(network.baseline, (data.x,), (direction,))[1]
    slope = torch.einsum("nkj,nj->nk", data.slopes, direction) - below
    moving = along(network.shapes, (data.x,), (direction,))[1]
    weight = settings.tangent_weight * _typical(task, slope)
    return replace(task, moving=moving, slope=slope, slope_weight=weight)


def _typical(task: _Task, slope: torch.Tensor) -> torch.Tensor:
    """(n, 1): 0 where a slope is an outlier, else 1.

    Where a pair of particles is about to cross the cut-off, the tangent of the slow manifold is
    exact for steps of F of some 1e-5 and off for all others; a few such steer a whole network.
    """
    size = task._squares(slope).sum(dim=1, keepdim=True).sqrt()
    return (size <= _OUTLIER * size.median()).to(slope.dtype)


def _set_scales(network: StressNetwork, task: _Task) -> None:
    """Outputs of order 1 give what the baseline leaves."""
    typical = (task.target**2).mean(dim=0).sqrt()
    network.output_scale.copy_(typical.maximum(1e-9 / task.weight.sqrt()))
    widths = network.input_scale[:STRETCH]
    network.energy_scale.fill_(float(network.output_scale.max() * widths.min()) / 2.0)


def _minimise(
    network: StressNetwork,
    task: _Task,
    test: _Task,
    settings: TrainingSettings,
    identity: dict[str, str],
    progress: Progress | None,
    checkpoint: Checkpoint | None,
    resume: dict[str, Any] | None,
) -> None:
    first, done, optimiser = 0, 0, None
    if resume is not None:
        first, done, optimiser = _restore(network, settings, identity, resume)
    for k in range(first, settings.members):
        optimiser = optimiser or _make_optimiser(network, k, settings)
        run = _Run(network, k, optimiser, identity)
        done = run.minimise(task, test, settings, done, progress, checkpoint)
        done, optimiser = 0, None


def _make_optimiser(network: StressNetwork, k: int, settings: TrainingSettings) -> Any:
    return torch.optim.LBFGS(
        network.members[k].parameters(),
        history_size=settings.history,
        line_search_fn="strong_wolfe",
        tolerance_grad=0.0,
        tolerance_change=0.0,
    )


@dataclass(frozen=True)
class _Run:
    """The training of one network of the ensemble."""

    network: StressNetwork
    number: int
    optimiser: torch.optim.LBFGS
    identity: dict[str, str]

    def minimise(
        self,
        task: _Task,
        test: _Task,
        settings: TrainingSettings,
        done: int,
        progress: Progress | None,
        checkpoint: Checkpoint | None,
    ) -> int:
        """Iterate until the settings' number or until nothing is gained; the iterations done."""
        member = self.network.ensemble[self.number]
        # the first steps of L-BFGS want a loss of order 1
        scale = 1.0 / float((task.weight * self.network.output_scale**2).max())

        def loss_and_gradient() -> torch.Tensor:
            self.optimiser.zero_grad()
            loss = scale * task.loss(self.network, member)
            loss.backward()
            return loss

        before = self.number * settings.iterations
        state = self.snapshot(done)
        best = np.inf
        try:
            while done < settings.iterations:
                count = min(_ITERATIONS_A_ROUND, settings.iterations - done)
                self.optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
                self.optimiser.step(loss_and_gradient)
                done += count
                figures, loss = self.figures(task, test)
                if not np.isfinite(loss):
                    raise SimulationError(
                        f"training: the loss is not finite after {before + done} iterations; "
                        "try another seed"
                    )
                if progress is not None:
                    progress(before + done, settings.members * settings.iterations, figures)
                state = self.snapshot(done)
                if checkpoint is not None and done % settings.checkpoint_interval < count:
                    checkpoint(state)
                if loss >= best:
                    break
                best = loss
        except KeyboardInterrupt:
            if checkpoint is not None:
                checkpoint(state)
            raise
        return done

    def figures(self, task: _Task, test: _Task) -> tuple[dict[str, float], float]:
        """Errors of stress for the eye, and the loss that is minimised."""
        member = self.network.ensemble[self.number]
        with torch.no_grad():
            loss = float(task.loss(self.network, member))
            fitted, held_out = (
                float(part.stress_loss(self.network, member)) ** 0.5 for part in (task, test)
            )
        return {"loss": fitted, "held_out_rms": held_out}, loss

    def snapshot(self, done: int) -> dict[str, Any]:
        """All that is needed to carry on after so many iterations."""
        parts = {"network": self.network.state_dict(), "optimiser": self.optimiser.state_dict()}
        return {
            **self.identity,
            "member": self.number,
            "iterations": done,
            **copy.deepcopy(parts),
        }


def _restore(
    network: StressNetwork,
    settings: TrainingSettings,
    identity: dict[str, str],
    state: dict[str, Any],
) -> tuple[int, int, Any]:
    for name, value in identity.items():
        if state.get(name) != value:
            raise MismatchError(
                f"training: the state to resume has {name} {state.get(name)}, not {value}"
            )
    number = int(state["member"])
    network.load_state_dict(state["network"])
    optimiser = _make_optimiser(network, number, settings)
    optimiser.load_state_dict(state["optimiser"])
    return number, int(state["iterations"]), optimiser


def _subset(samples: StressSamples, chosen: NDArray[np.int64]) -> StressSamples:
    names = ["F", "F_dot", "stress", "status"]
    names += [name for name in TANGENTS if getattr(samples, name) is not None]
    return replace(samples, **{name: getattr(samples, name)[chosen] for name in names})
