"""The torch network as the twin of what is compiled, and surrogate files taken apart."""

from __future__ import annotations

import json

import numpy as np
import torch

from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.store import surrogates
from surrofe2.store.hdf5 import reading, write
from surrofe2.surrogate.network import StressNetwork, along
from surrofe2.surrogate.piola import to_cauchy


def torch_stress(law, F, F_dot):
    """Stress (n, 2, 2) of a surrogate by its torch network, in range or not."""
    return network_stress(StressNetwork.of(law.network, law.settings), F, F_dot)


def network_stress(network, F, F_dot):
    """Stress (n, 2, 2) of a torch network."""
    with torch.no_grad():
        return to_cauchy(F, network(torch.from_numpy(to_inputs(F, F_dot)[0])).numpy())


def differentiate(network, inputs):
    """(P̂ (n, 4) µN/µm, its slopes (n, 4, 7)) at inputs (n, 7), by forward differentiation."""
    count = len(inputs)
    at = torch.from_numpy(inputs).repeat_interleave(INPUTS, dim=0)
    units = torch.eye(INPUTS, dtype=at.dtype).repeat(count, 1)
    with torch.no_grad():
        P, slope = along(network, (at,), (units,))
    values, slopes = (part.numpy().reshape(count, INPUTS, 4) for part in (P, slope))
    return values[:, 0].copy(), np.swapaxes(slopes, 1, 2)


def read_parts(path):
    """(header, arrays) of a surrogate's file; tables of the header opened."""
    with reading(path, surrogates.SURROGATE) as stored:
        header = dict(stored.file.attrs)
        for name, value in header.items():
            if str(value).startswith("{"):
                header[name] = json.loads(value)
        return header, stored.all_arrays()


def write_parts(path, header, arrays):
    """A file of these parts, with the right SHA-256."""
    own = ("sha256", "schema", "schema_version")
    header = {key: value for key, value in header.items() if key not in own}
    write(path, surrogates.SURROGATE, header, arrays)
