"""Settings of the cache and its table: the recipe's sections [cache] and [table]."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.base.settings import check_settings, setting

# Allowed error relative to the local stress, over the tolerance, where a recipe does not state it.
_RELATIVE = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheSettings:
    """Tolerance and audit of a cached law.

    The local stress is that of the moduli at rest, see `surrogate.domain`; a table knows the
    first tolerance alone.
    """

    tolerance: float = setting(
        1e-3,
        "allowed error of a stress relative to the spread of stress; inf: range alone decides",
        above=0.0,
        inf=True,
    )
    relative_tolerance: float | None = setting(
        None,
        "allowed error relative to the local stress, where that is less; left out: 30 × tolerance; "
        "inf: the other alone",
        above=0.0,
        inf=True,
    )
    audit: float = setting(
        0.005,
        "fraction of the cache's answers that RVEs compute, too; at least 360 per run; 0: none",
        least=0.0,
        most=1.0,
    )
    seed: int = setting(1, "seed of the choice of audited answers", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "cache")

    @property
    def relative(self) -> float:
        """Allowed error relative to the local stress, stated or by default."""
        stated = self.relative_tolerance
        return _RELATIVE * self.tolerance if stated is None else stated


@dataclass(frozen=True, slots=True, kw_only=True)
class TableSettings:
    """Adaptive table of RVE stresses (`--law table`)."""

    tolerance: float = setting(
        1e-3, "largest error of a stress over the spread of stress", above=0.0, below=1.0
    )
    most_records: int = setting(
        4096,
        "most records; after that a table only grows its ellipsoids",
        least=1,
        most=4096,
    )

    def __post_init__(self) -> None:
        check_settings(self, "table")
