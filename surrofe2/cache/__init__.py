"""Stress from a surrogate where it may be trusted, from the true law elsewhere."""

from surrofe2.cache.cached_law import CachedLaw

__all__ = ["CachedLaw"]
