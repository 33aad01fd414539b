"""Labelled images of tissue: each pixel has the whole number of its cell, or 0 between cells.

TIFF is read by tifffile, PNG by imageio, both of the extra `image`; NPY by NumPy.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError
from surrofe2.store.store import read_bytes

Labels = NDArray[np.int64]

_MOST_LABEL = 2**53
"""Above this number labels would not be told apart as floats."""
_FEWEST = 3


def read_labels(path: Path) -> Labels:
    """(rows, columns) labels of an image's pixels, the first row at the top.

    Raises:
        FileError: the file is not there, or is no image of its kind.
        InputError: the kind is none of those, it needs the extra `image`, or its pixels are no
            labels.
    """
    kinds = {".npy": _read_npy, ".png": _read_png, ".tif": _read_tiff, ".tiff": _read_tiff}
    read = kinds.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: no kind of image; it must end in {', '.join(kinds)}")
    content = read_bytes(path)
    try:
        image = np.asarray(read(content))
    except ImportError as error:
        raise InputError(
            f"{path}: {error.name} is not installed; it comes with pip install 'surrofe2[image]'"
        ) from None
    except Exception as error:  # readers raise what they like
        raise FileError(f"{path}: not an image of its kind: {error}") from None
    return _checked(path, image)


def _read_npy(content: bytes) -> Any:
    return np.load(io.BytesIO(content), allow_pickle=False)


def _read_png(content: bytes) -> Any:
    from imageio.v3 import imread

    return imread(content, extension=".png")


def _read_tiff(content: bytes) -> Any:
    from tifffile import imread

    return imread(io.BytesIO(content))


def _checked(path: Path, image: NDArray[Any]) -> Labels:
    """The image as labels; refused where it has colours, slices, fractions or too few labels."""
    image = image.squeeze()  # files may have one slice, channel or time
    if image.ndim != 2:
        shape = " × ".join(map(str, image.shape))
        raise InputError(
            f"{path}: {shape} pixels; it must be one plane of labels, rows × columns: choose a "
            "slice, and labels instead of colours"
        )
    is_number = np.issubdtype(image.dtype, np.integer) or np.issubdtype(image.dtype, np.floating)
    if not is_number or not np.isfinite(image).all() or (image != np.round(image)).any():
        raise InputError(f"{path}: {image.dtype} pixels; labels must be whole numbers")
    if image.size and (image.min() < 0 or image.max() > _MOST_LABEL):
        raise InputError(f"{path}: labels must be from 0, between cells, to 2⁵³")
    labels: Labels = image.astype(np.int64)
    there = np.unique(labels)
    if (there > 0).sum() < _FEWEST:
        raise InputError(
            f"{path}: {(there > 0).sum()} labels; each cell needs a number of its own: label it "
            "first, for example by skimage.measure.label"
        )
    return labels
