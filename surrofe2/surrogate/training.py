"""From samples to a `SurrogateLaw`: polynomial by least squares, network by L-BFGS.

Samples with tangents are trained on those as well (Sobolev): the polynomial on all of them, the
network on the slope along one random direction of the inputs a sample. For a network this small
and a stress this smooth, full-batch quasi-Newton steps in float64 reach errors that stochastic
gradients do not in the same time.

`should_stop` may end training after any `ROUND` iterations, as soon as a surrogate is good enough.
Samples held out decide nothing, so the errors on them are those on new samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.domain_fit import fit_domain
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training_task import Task, fit_baseline, make_task, read_data, set_scale

Array = NDArray[np.float64]

LEAST_SAMPLES = 20
ROUND = 100
_MANY_UNITS = 300_000
_ITERATIONS_AT_ONCE = 20
_LISTS = ("old_dirs", "old_stps", "ro")  # of the optimiser: one entry a kept step
_NUMBERS = ("func_evals", "n_iter", "t", "H_diag", "prev_loss")
_VECTORS = ("d", "prev_flat_grad")


@dataclass(frozen=True, eq=False, slots=True)
class TrainingState:
    """An interrupted training, to be carried on.

    Attributes:
        identity: fingerprint of the samples and the settings, as text.
        iterations: done.
        arrays: weights of the network and state of the optimiser, by name.
    """

    identity: Mapping[str, str]
    iterations: int
    arrays: Mapping[str, Array]


Progress = Callable[[int, int, dict[str, float]], None]
ShouldStop = Callable[[SurrogateLaw], bool]
Checkpoint = Callable[[TrainingState], None]


def train(
    samples: StressSamples,
    settings: TrainingSettings,
    *,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resume: TrainingState | None = None,
    symmetry: str | None = None,
    should_stop: ShouldStop | None = None,
) -> SurrogateLaw:
    """Fit a surrogate to the valid samples; the same seed and threads give the same surrogate.

    Args:
        progress: called with (iterations done, iterations in all, figures), among the figures
            `loss` (training) and `held_out_rms`, both relative to the spread of stress.
        checkpoint: called now and then, and when interrupted by the keyboard.
        resume: a state that `checkpoint` was given, to carry on from.
        symmetry: "D4" or "none"; None: that of the plant cell's arrangement.
        should_stop: says after every `ROUND` iterations whether training is to end, by the
            surrogate so far; None: after all iterations.

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

    data = read_data(valid, settings)
    square = samples.cell.symmetry == "D4"
    network = StressNetwork(settings, symmetry or ("D4" if square else "none"))
    network.input_scale.copy_(torch.from_numpy(input_scale(valid.range)))
    fit_baseline(network, data.at(fitted), settings)
    task, test = (make_task(network, data.at(part), settings) for part in (fitted, held_out))
    set_scale(network, task)
    identity = {"data_fingerprint": samples.fingerprint, "settings": repr(settings)}
    minimisation = _Minimisation(network, settings, identity)
    done = 0 if resume is None else minimisation.restore(resume)
    domain = fit_domain(samples)

    def law() -> SurrogateLaw:
        found = SurrogateLaw(
            network=network.to_parameters(),
            cell=samples.cell,
            initialisation=samples.initialisation,
            range=samples.range,
            settings=settings,
            errors={},
            data_fingerprint=samples.fingerprint,
            rest_length=samples.rest_length,
            version=version("surrofe2"),
            domain=domain,
        )
        return replace(found, errors=found.score(valid.at(held_out)))

    improves = True
    with _threads_for(len(fitted) * max(settings.hidden)):
        while improves and done < settings.iterations:
            at_round = done > 0 and done % ROUND == 0
            if should_stop is not None and at_round and should_stop(law()):
                break
            to = settings.iterations if should_stop is None else done - done % ROUND + ROUND
            done, improves = minimisation.run(task, test, done, to, progress, checkpoint)
    return law()


@contextmanager
def _threads_for(units: int) -> Iterator[None]:
    """One thread of torch where units times samples are few: more would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1 if units < _MANY_UNITS else before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Minimisation:
    """L-BFGS on the weights of a network."""

    def __init__(
        self, network: StressNetwork, settings: TrainingSettings, identity: Mapping[str, str]
    ) -> None:
        self.network, self.settings, self.identity = network, settings, identity
        self.parameters = list(network.parameters())
        self.optimiser = torch.optim.LBFGS(
            self.parameters,
            history_size=settings.history,
            line_search_fn="strong_wolfe",
            tolerance_grad=0.0,
            tolerance_change=0.0,
        )

    def run(
        self,
        task: Task,
        test: Task,
        done: int,
        to: int,
        progress: Progress | None,
        checkpoint: Checkpoint | None,
    ) -> tuple[int, bool]:
        """Iterate `to` a number or until the loss stalls; (iterations done, whether it falls)."""
        # the first steps of L-BFGS want a loss of order 1
        scale = 1.0 / float((task.weight * self.network.output_scale**2).max())

        def loss_and_gradient() -> torch.Tensor:
            self.optimiser.zero_grad()
            loss = scale * task.loss(self.network)
            loss.backward()
            return loss

        most = self.settings.iterations
        to, state, best = min(to, most), self.snapshot(done), np.inf
        try:
            while done < to:
                count = min(_ITERATIONS_AT_ONCE, to - done)
                self.optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
                self.optimiser.step(loss_and_gradient)
                done += count
                figures, loss = self.figures(task, test)
                if not np.isfinite(loss):
                    raise SimulationError(
                        f"training: the loss is not finite after {done} iterations; "
                        "try another seed"
                    )
                if progress is not None:
                    progress(done, most, figures)
                state = self.snapshot(done)
                if checkpoint is not None and done % self.settings.checkpoint_interval < count:
                    checkpoint(state)
                if loss >= best:
                    return done, False
                best = loss
        except KeyboardInterrupt:
            if checkpoint is not None:
                checkpoint(state)
            raise
        return done, True

    def figures(self, task: Task, test: Task) -> tuple[dict[str, float], float]:
        """Errors of stress for the eye, and the loss that is minimised."""
        with torch.no_grad():
            loss = float(task.loss(self.network))
            fitted, held_out = (float(t.stress_loss(self.network)) ** 0.5 for t in (task, test))
        return {"loss": fitted, "held_out_rms": held_out}, loss

    def snapshot(self, done: int) -> TrainingState:
        """All that is needed to carry on after so many iterations."""
        found = {f"network.{k}": v.numpy().copy() for k, v in self.network.state_dict().items()}
        state = self.optimiser.state[self.parameters[0]]
        for name in _LISTS if state else ():
            entries = state[name]
            found[f"optimiser.{name}"] = torch.stack(entries).numpy() if entries else np.empty(0)
        for name in (*_NUMBERS, *_VECTORS) if state else ():
            values = torch.as_tensor(state[name], dtype=torch.float64)
            found[f"optimiser.{name}"] = values.numpy().copy()
        return TrainingState(self.identity, done, found)

    def restore(self, state: TrainingState) -> int:
        """Put back what `snapshot` gave; the iterations that were done."""
        for name, value in self.identity.items():
            if state.identity.get(name) != value:
                raise MismatchError(
                    f"training: the state to resume has {name} {state.identity.get(name)}, "
                    f"not {value}"
                )
        try:
            self._put_back(state)
        except (KeyError, TypeError, ValueError, RuntimeError, OverflowError):
            raise MismatchError("training: the state to resume has not what it must") from None
        return state.iterations

    def _put_back(self, state: TrainingState) -> None:
        parts: dict[str, dict[str, Any]] = {"network": {}, "optimiser": {}}
        for name, array in state.arrays.items():
            part, key = name.split(".", 1)
            parts[part][key] = torch.from_numpy(np.array(array))
        self.network.load_state_dict(parts["network"])
        found = parts["optimiser"]
        size = sum(each.numel() for each in self.parameters)
        steps = len(found["old_dirs"]) if found else 0
        shapes = {"old_dirs": (steps, size), "old_stps": (steps, size), "ro": (steps,)}
        shapes |= dict.fromkeys(_VECTORS, (size,))
        for name, values in found.items():
            single = name in _NUMBERS and values.numel() == 1
            if steps and not single and tuple(values.shape) != shapes[name]:
                raise ValueError(name)
        for name in _LISTS if found else ():
            found[name] = list(found[name])
        for name in _NUMBERS if found else ():
            found[name] = found[name].item()
        for name in ("func_evals", "n_iter") if found else ():
            found[name] = int(found[name])
        self.optimiser.state[self.parameters[0]].update(found)
