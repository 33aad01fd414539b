"""A learnt stress law: samples in, `SurrogateLaw` out.

Reading order: `settings`, `components` (what is learnt), `network`, `training_task`, `training`,
`held_out_errors`, `surrogate_law`, `checkpoint`; where it may be trusted: `domain`,
`calibration`, `trust_features`; and for speed `packing`, `compiled`, `compiled_frame`,
`compiled_network`, `polynomials`, `error_bound`, `lanes`, `vector_tanh`. torch is imported when it
is first needed, so that recipes can be checked without it.
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
