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

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.domain import fit_domain
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.held_out_errors import measure_errors
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training_task import Task, fit_baseline_to, make_task, read_data, set_scales
from surrofe2.surrogate.trust_features import has_square_symmetry

Progress = Callable[[int, int, dict[str, float]], None]
Checkpoint = Callable[[dict[str, Any]], None]

LEAST_SAMPLES = 20
_ITERATIONS_A_ROUND = 20


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

    data = read_data(valid, settings)
    symmetry = symmetry or ("D4" if has_square_symmetry(samples.cell) else "none")
    network = StressNetwork(settings, symmetry)
    network.input_scale.copy_(torch.from_numpy(input_scale(valid.range)))
    fit_baseline_to(network, data.at(fitted), settings)
    task, test = (make_task(network, data.at(part), settings) for part in (fitted, held_out))
    set_scales(network, task)
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
    return replace(law, errors=measure_errors(law, valid.at(held_out)))


def _check_form(settings: TrainingSettings, initialisation: str) -> None:
    if settings.form == "potentials" and initialisation == "constrained-runs":
        raise InputError(
            "training.form: potentials; the viscous tangent of constrained-runs is not symmetric, "
            "so no dissipation potential has it; use form energy"
        )


def _minimise(
    network: StressNetwork,
    task: Task,
    test: Task,
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
        task: Task,
        test: Task,
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

    def figures(self, task: Task, test: Task) -> tuple[dict[str, float], float]:
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
