"""From samples to a `SurrogateLaw`: polynomial by least squares, network by L-BFGS.

For a network this small and a stress this smooth, full-batch quasi-Newton steps in float64 reach
errors that stochastic gradients do not in the same time.
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
from surrofe2.sampling import StressSamples
from surrofe2.surrogate.components import input_scale, to_components, to_inputs
from surrofe2.surrogate.domain import fit_domain
from surrofe2.surrogate.held_out_errors import measure_errors
from surrofe2.surrogate.network import (
    COVARIANTS,
    INVARIANTS,
    StressNetwork,
    fit_baseline,
    products,
)
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.tensors import transpose

Array = NDArray[np.float64]
Progress = Callable[[int, int, dict[str, float]], None]
Checkpoint = Callable[[dict[str, Any]], None]

LEAST_SAMPLES = 20
_ITERATIONS_A_ROUND = 20
_LEAST_SPREAD = 1e-3  # a component below this share of the largest is not worth more effort


def train(
    samples: StressSamples,
    settings: TrainingSettings,
    *,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resume: dict[str, Any] | None = None,
) -> SurrogateLaw:
    """Fit a surrogate to the valid samples; the same seed and threads give the same surrogate.

    Args:
        progress: called with (iterations done, iterations in all, figures), among the figures
            `loss` (training) and `held_out_rms`, both relative to the spread of stress.
        checkpoint: called now and then, and when interrupted by the keyboard, with a state of
            tensors and plain data that `torch.load(…, weights_only=True)` reads back.
        resume: such a state, to carry on from.

    Raises:
        InputError: fewer than `LEAST_SAMPLES` valid samples.
        MismatchError: the state to resume is of other samples or settings.
        SimulationError: the loss is not finite.
    """
    valid = samples.valid
    count = len(valid.F)
    if count < LEAST_SAMPLES:
        raise InputError(f"samples: {count} valid; training needs at least {LEAST_SAMPLES}")
    order = np.random.default_rng(settings.seed).permutation(count)
    kept_out = max(2, round(settings.held_out * count))
    held_out, fitted = order[:kept_out], order[kept_out:]
    identity = {"data_fingerprint": samples.fingerprint, "settings": repr(settings)}

    inputs, R = to_inputs(valid.F, valid.F_dot)
    components = to_components(transpose(R) @ valid.stress @ R)
    network = _start(inputs[fitted], components[fitted], input_scale(valid.range), settings)
    task = _make_task(network, inputs[fitted], components[fitted])
    test = _make_task(network, inputs[held_out], components[held_out])
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


@dataclass(frozen=True)
class _Task:
    """What the network is to add to the baseline, at fixed inputs; `weight`: of its square."""

    invariants: torch.Tensor
    covariants: torch.Tensor
    target: torch.Tensor
    weight: torch.Tensor

    def loss(self, network: StressNetwork) -> torch.Tensor:
        """Mean square error relative to the spread of each component."""
        error = network.correction(self.invariants, self.covariants) - self.target
        return (error**2 * self.weight).mean()


def _start(
    inputs: Array, components: Array, scale: Array, settings: TrainingSettings
) -> StressNetwork:
    """The network before its first iteration: scales and baseline in place."""
    network = StressNetwork(settings.hidden, settings.baseline_degree, settings.seed)
    x = inputs / scale
    network.input_scale.copy_(torch.from_numpy(scale))
    network.coefficients.copy_(
        torch.from_numpy(fit_baseline(x, components, settings.baseline_degree))
    )
    rest = components - network.baseline(torch.from_numpy(x)).numpy()
    typical = np.sqrt((rest**2).mean(axis=0))
    network.output_scale.copy_(torch.from_numpy(np.maximum(typical, 1e-9 * _spread(components))))
    return network


def _spread(components: Array) -> Array:
    spread = components.std(axis=0)
    return np.maximum(spread, max(_LEAST_SPREAD * spread.max(), np.finfo(float).tiny))


def _make_task(network: StressNetwork, inputs: Array, components: Array) -> _Task:
    x = torch.from_numpy(inputs) / network.input_scale
    target = (torch.from_numpy(components) - network.baseline(x)) / network.output_scale
    weight = (network.output_scale / torch.from_numpy(_spread(components))) ** 2
    return _Task(products(x, INVARIANTS), products(x, COVARIANTS), target, weight)


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
    optimiser = torch.optim.LBFGS(
        network.parameters(),
        history_size=settings.history,
        line_search_fn="strong_wolfe",
        tolerance_grad=0.0,
        tolerance_change=0.0,
    )
    scale = 1.0 / float(task.weight.max())  # the first steps of L-BFGS want a loss of order 1
    done = 0 if resume is None else _restore(network, optimiser, identity, resume)

    def loss_and_gradient() -> torch.Tensor:
        optimiser.zero_grad()
        loss = scale * task.loss(network)
        loss.backward()
        return loss

    state = _snapshot(network, optimiser, identity, done)
    best = np.inf
    try:
        while done < settings.iterations:
            count = min(_ITERATIONS_A_ROUND, settings.iterations - done)
            optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
            optimiser.step(loss_and_gradient)
            done += count
            figures = _figures(network, task, test)
            if not np.isfinite(figures["loss"]):
                raise SimulationError(
                    f"training: the loss is not finite after {done} iterations; try another seed"
                )
            if progress is not None:
                progress(done, settings.iterations, figures)
            state = _snapshot(network, optimiser, identity, done)
            if checkpoint is not None and done % settings.checkpoint_interval < count:
                checkpoint(state)
            if figures["loss"] >= best:
                break
            best = figures["loss"]
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint(state)
        raise


def _figures(network: StressNetwork, task: _Task, test: _Task) -> dict[str, float]:
    with torch.no_grad():
        pair = (task.loss(network), test.loss(network))
    loss, held_out = (float(value) ** 0.5 for value in pair)
    return {"loss": loss, "held_out_rms": held_out}


def _snapshot(
    network: StressNetwork, optimiser: torch.optim.LBFGS, identity: dict[str, str], done: int
) -> dict[str, Any]:
    parts = {"network": network.state_dict(), "optimiser": optimiser.state_dict()}
    return {**identity, "iterations": done, **copy.deepcopy(parts)}


def _restore(
    network: StressNetwork,
    optimiser: torch.optim.LBFGS,
    identity: dict[str, str],
    state: dict[str, Any],
) -> int:
    for name, value in identity.items():
        if state.get(name) != value:
            raise MismatchError(
                f"training: the state to resume has {name} {state.get(name)}, not {value}"
            )
    network.load_state_dict(state["network"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["iterations"])


def _subset(samples: StressSamples, chosen: NDArray[np.int64]) -> StressSamples:
    arrays = {name: getattr(samples, name)[chosen] for name in ("F", "F_dot", "stress", "status")}
    return replace(samples, **arrays)
