"""What the user asks of the cache: the recipe's section [cache]."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.settings import check_settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheSettings:
    """Tolerance and audit of a cached law."""

    tolerance: float = setting(
        1e-3,
        "allowed error of a stress relative to the spread of stress; inf: range alone decides",
        above=0.0,
        inf=True,
    )
    audit: float = setting(
        0.005,
        "share of the cache's answers at accepted steps that an RVE answers too",
        least=0.0,
        most=1.0,
    )
    seed: int = setting(1, "of the choice of audited answers", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "cache")
