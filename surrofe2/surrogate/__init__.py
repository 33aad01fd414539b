"""A learnt stress law: samples in, `SurrogateLaw` out.

Reading order: `settings`; what is learnt: `products` of inputs, `features` and weights of a
network, `network` in torch, `piola`, `training`; where it may be trusted: `domain` (and bound),
`deformation_paths`, `calibration`; for speed `lookup`; all put together in `surrogate_law`. Only
`network` and `training` import torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.surrogate.settings import TrainingSettings
    from surrofe2.surrogate.surrogate_law import SurrogateLaw
    from surrofe2.surrogate.training import train

__getattr__, __dir__ = public_names(__name__)
