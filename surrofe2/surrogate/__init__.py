"""A learnt stress law: samples in, `SurrogateLaw` out.

Reading order: `settings`, `features` (what is learnt), `network`, `piola`, `training_task`,
`training`; where it may be trusted: `domain`, `error_bound`, `deformation_paths`,
`calibration`; and for speed `network_arrays`, `polynomial`, `compiled_frame`, `compiled_network`,
`compiled_bound`, `compiled_lookup`, all put together in `surrogate_law`. Only
`network`, `training_task` and `training` import torch, so `train` is imported when it is first
asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from surrofe2.surrogate.settings import TrainingSettings

if TYPE_CHECKING:
    from surrofe2.surrogate.surrogate_law import SurrogateLaw
    from surrofe2.surrogate.training import train

__all__ = ["SurrogateLaw", "TrainingSettings", "train"]

_HOMES = {"SurrogateLaw": "surrogate_law", "train": "training"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
