"""Free sides of a tissue: (λ, λ̇) along a side in, line tension out.

In reading order: `slab` (plant cells between two free sides, straight and bent), `slab_law` (the
bulk beside them; the surface law: what the slab has beyond the bulk), `tabulated` (the same from a
table, as runs use it).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.surface.slab_law import SlabLaw
    from surrofe2.surface.tabulated import TabulatedSurface, tabulate_surface

__getattr__, __dir__ = public_names(__name__)
