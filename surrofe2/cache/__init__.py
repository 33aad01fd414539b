"""Stress from a surrogate where it may be trusted, from the true law elsewhere.

In reading order: `parts` is what a cache asks of others, `cached_law` which part answers which
point and when that may change, `audit` and `error_record` how wrong it was, `trust` and
`collapse` what follows from that, `cost` whether it pays.
"""

from surrofe2.cache.cached_law import CachedLaw
from surrofe2.cache.settings import CacheSettings

__all__ = ["CacheSettings", "CachedLaw"]
