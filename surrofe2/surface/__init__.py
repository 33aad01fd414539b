"""Free sides of a tissue: (λ, λ̇) along a side in, line tension out.

In reading order: `slab` (plant cells between two free sides), `side_free` (the bulk beside them),
`bent_slab` (how deep they act), `slab_law` (the surface law: what the slab has beyond the bulk),
`tabulated` (the same from a table), `cell_surface` (what runs use: both).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.surface.slab_law import SlabLaw
    from surrofe2.surface.tabulated import TabulatedSurface, tabulate_surface

__getattr__, __dir__ = public_names(__name__)
