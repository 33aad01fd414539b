"""Labelled images of tissue: each pixel has the whole number of its cell, or 0 between cells.

TIFF is read by tifffile, of the extra `image`; PNG by Pillow, which comes with matplotlib; NPY by
NumPy.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError, shortened
from surrofe2.store.store import read_bytes

Labels = NDArray[np.int64]
# Pixels between cells, in the narrowest direction, up to which they are a line and no hole, where
# it is not stated.
LINE = 3

# Above this number labels in an image of floats could not be told apart.
_MOST_LABEL = 2**53
# Fewer labels than this are most likely a mask of cells and background.
_FEWEST = 3


def read_labels(path: Path) -> Labels:
    """Read the labels (rows, columns) of an image's pixels, the first row at the top.

    Raises:
        FileError: the file is not there, or is no image of its kind.
        InputError: the kind is unknown, it needs the extra `image`, or its pixels are no labels.
    """
    kinds = {".npy": _read_npy, ".png": _read_png, ".tif": _read_tiff, ".tiff": _read_tiff}
    read = kinds.get(path.suffix.lower())
    if read is None:
        raise InputError(
            f"{path}: files of this kind are not read; an image must end in {', '.join(kinds)}, "
            "and a surface, which `surrofe2 cells` reads, in .ply"
        )
    content = read_bytes(path)
    try:
        image = np.asarray(read(content))
    except ImportError as error:
        raise InputError(
            f"{path}: {error.name} is not installed; it comes with pip install 'surrofe2[image]'"
        ) from None
    except Exception as error:  # the readers raise errors of any kind
        reason = shortened(" ".join(str(error).split()), 150)
        raise FileError(f"{path}: cannot be read as an image of its kind: {reason}") from None
    return _checked(path, image)


def _read_npy(content: bytes) -> Any:
    """Read an array of numpy."""
    return np.load(io.BytesIO(content), allow_pickle=False)


def _read_png(content: bytes) -> Any:
    """Read a PNG."""
    from PIL.PngImagePlugin import PngImageFile

    # of a PNG with a palette its pixels are the numbers, not the colours
    return PngImageFile(io.BytesIO(content))


def _read_tiff(content: bytes) -> Any:
    """Read a TIFF."""
    from tifffile import imread

    return imread(io.BytesIO(content))


def _checked(path: Path, image: NDArray[Any]) -> Labels:
    """Return the image as labels; reject colours, slices, fractions and too few labels."""
    image = image.squeeze()  # files may have one slice, channel or time
    if image.ndim != 2:
        shape = " × ".join(map(str, image.shape))
        raise InputError(
            f"{path}: {shape} pixels; it must be one plane of labels, rows × columns: choose a "
            "slice, and labels instead of colours"
        )
    is_number = np.issubdtype(image.dtype, np.integer) or np.issubdtype(image.dtype, np.floating)
    if not is_number or not np.isfinite(image).all() or (image != np.round(image)).any():
        raise InputError(
            f"{path}: {image.dtype} pixels; labels must be whole numbers, as of "
            "skimage.measure.label"
        )
    if image.size and (image.min() < 0 or image.max() > _MOST_LABEL):
        raise InputError(
            f"{path}: labels from {image.min():g} to {image.max():g}; they must be from 0, which "
            "is between cells, to 2⁵³"
        )
    labels: Labels = image.astype(np.int64)
    check_count(path, labels)
    return labels


def check_count(path: Path, labels: Labels) -> None:
    """Raise InputError where there are too few labels besides 0."""
    count = np.count_nonzero(np.unique(labels))
    if count < _FEWEST:
        raise InputError(
            f"{path}: {'1 label' if count == 1 else f'{count} labels'} besides 0; at least "
            f"{_FEWEST} are needed, and each cell needs a number of its own: label it first, for "
            "example by skimage.measure.label"
        )
