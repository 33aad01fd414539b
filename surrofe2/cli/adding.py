"""Harvests of runs as further samples to train on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surrofe2.sampling import StressSamples


def with_harvests(samples: StressSamples, paths: Sequence[Path]) -> StressSamples:
    """The samples and, after them, the true answers in these harvests.

    The range stays that of the samples: states beyond it are trained on, and do not widen it.
    Harvests have no tangents, so neither do the samples then.

    Raises:
        MismatchError: a harvest is of other cell parameters or initialisation.
    """
    from dataclasses import replace

    import numpy as np

    from surrofe2.io.harvest import check_harvest, read_harvest

    parts = []
    for path in paths:
        harvest = read_harvest(path)
        check_harvest(path, harvest, samples.cell, samples.initialisation)
        parts.append(harvest)
    if not parts:
        return samples
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in (samples, *parts)])
        for name in ("F", "F_dot", "stress", "status")
    }
    left = samples.left_bifurcation
    if left is not None:  # harvests have no answers from beyond a bifurcation
        arrays["left_bifurcation"] = np.pad(left, (0, len(arrays["status"]) - len(left)))
    return replace(samples, P_by_F=None, P_by_F_dot=None, **arrays)
