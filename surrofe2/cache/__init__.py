"""Stress from a surrogate or a table where it may be trusted, from RVEs elsewhere.

In reading order: `protocols` is what a cache asks of others, `settings` of its user; `branches`
says which part answers which point, `audit` finds how wrong the answers were, `trust` draws the
conclusions, `closing_audit` states what holds of a whole run, `cached_law` is the law. `table` is a
surrogate that learns as it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.cache.cached_law import CachedLaw
    from surrofe2.cache.settings import CacheSettings, TableSettings
    from surrofe2.cache.table.stress_table import StressTable, sampled_spread

__getattr__, __dir__ = public_names(__name__)
