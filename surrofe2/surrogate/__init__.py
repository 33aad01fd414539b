"""A learnt stress law: samples in, `SurrogateLaw` out.

Reading order: `settings`, `features` (what is learnt), `network`, `piola`, `training_task`,
`training`; where it may be trusted: `domain`, `domain_fit`, `error_bound` (with the local
tolerance), `deformation_paths`, `calibration`; and for speed `network_arrays`, `polynomial`,
`compiled_frame`, `compiled_network`, `compiled_lookup`, all put together in `surrogate_law`.
`quadratic_law` has the moduli at rest alone. Only `network`, `training_task` and `training` import
torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.surrogate.settings import TrainingSettings
    from surrofe2.surrogate.surrogate_law import SurrogateLaw
    from surrofe2.surrogate.training import train

__getattr__, __dir__ = public_names(__name__)
