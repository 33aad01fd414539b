"""Stress from a surrogate or a table where it may be trusted, from the true law elsewhere.

In reading order: `protocols` is what a cache asks of others, `cached_law` which part answers which
point and when that may change, `bookkeeping` what changes besides, `audit` and `error_record` how
wrong it was, `trust` and `collapse` what follows from that, `cost` whether it pays; `table`
answers from what was asked before, `table_behind` puts it behind another surrogate.
"""

from surrofe2.cache.cached_law import CachedLaw
from surrofe2.cache.settings import CacheSettings
from surrofe2.cache.table import StressTable, sampled_spread
from surrofe2.cache.table_behind import TableBehind
from surrofe2.cache.table_settings import TableSettings

__all__ = [
    "CacheSettings",
    "CachedLaw",
    "StressTable",
    "TableBehind",
    "TableSettings",
    "sampled_spread",
]
