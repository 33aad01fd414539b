"""Labelled images in the formats that are read, and what is no image of labels."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
from PIL import Image

from surrofe2.base.errors import FileError, InputError
from surrofe2.store.labelled_image import read_labels

io = pytest.importorskip("skimage.io")
data = pytest.importorskip("skimage.data")
measure = pytest.importorskip("skimage.measure")

BLOBS = data.binary_blobs(length=64, blob_size_fraction=0.15, volume_fraction=0.4, rng=1)
LABELS = measure.label(BLOBS, connectivity=1)


def written(path, image):
    if path.suffix == ".npy":
        np.save(path, image)
    else:
        io.imsave(path, image, check_contrast=False)
    return path


@pytest.mark.parametrize("name", ["a.npy", "a.tif", "a.TIFF", "a.png"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_labels_are_read_as_they_were_written(tmp_path, name, kind):
    path = tmp_path / name
    written(tmp_path / name.lower(), LABELS.astype(kind)).rename(path)
    labels = read_labels(path)
    assert labels.dtype == np.int64
    np.testing.assert_array_equal(labels, LABELS)


def test_whole_numbers_as_floats_and_single_planes_are_labels(tmp_path):
    path = written(tmp_path / "a.npy", LABELS[None].astype(np.float32))
    np.testing.assert_array_equal(read_labels(path), LABELS)


def test_a_png_with_a_palette_has_labels_for_its_colours(tmp_path):
    """Programs show labels by colours: each number of such a PNG is a place in its palette."""
    image = Image.fromarray(LABELS.astype(np.uint8)).convert("P")
    image.putpalette(np.random.default_rng(1).integers(0, 255, 768).tolist())
    image.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png"), LABELS)


def test_a_compressed_tiff_is_read_or_says_what_reads_it(tmp_path):
    image = Image.fromarray(LABELS.astype(np.uint8))
    image.save(tmp_path / "a.tif", compression="tiff_adobe_deflate")
    np.testing.assert_array_equal(read_labels(tmp_path / "a.tif"), LABELS)
    image.save(tmp_path / "b.tif", compression="tiff_lzw")
    if find_spec("imagecodecs"):
        np.testing.assert_array_equal(read_labels(tmp_path / "b.tif"), LABELS)
    else:
        with pytest.raises(FileError, match=r"requires the 'imagecodecs' package"):
            read_labels(tmp_path / "b.tif")


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((5, 5, 3), np.uint8), "5 × 5 × 3 pixels; it must be one plane of labels"),
        (np.full((5, 5), 0.5), "float64 pixels; labels must be whole numbers"),
        (np.full((5, 5), np.nan), "labels must be whole numbers"),
        (np.full((5, 5), "a"), "labels must be whole numbers"),
        (np.full((5, 5), -1), "labels from -1 to -1; they must be from 0"),
        (BLOBS.astype(np.uint8), "1 label besides 0; at least 3 are needed"),
        (np.zeros((0, 0), np.uint8), "0 labels besides 0"),
    ],
    ids=["colours", "fractions", "NaN", "text", "negative", "binary", "empty"],
)
def test_what_is_no_image_of_labels_is_refused(tmp_path, image, message):
    with pytest.raises(InputError, match=message):
        read_labels(written(tmp_path / "a.npy", image))


@pytest.mark.parametrize("name", ["a.npy", "a.tif", "a.png"])
def test_damaged_and_missing_files_are_named(tmp_path, name):
    with pytest.raises(FileError, match="No such file"):
        read_labels(tmp_path / name)
    (tmp_path / name).write_bytes(b"no image")
    with pytest.raises(FileError, match="cannot be read as an image of its kind"):
        read_labels(tmp_path / name)


def test_objects_are_not_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(FileError, match="cannot be read as an image of its kind"):
        read_labels(tmp_path / "a.npy")


def test_other_kinds_and_missing_libraries_say_what_helps(tmp_path, monkeypatch):
    kinds = r"must end in \.npy, \.png, \.tif, \.tiff, and a surface.* in \.ply"
    with pytest.raises(InputError, match=kinds):
        read_labels(tmp_path / "a.jpg")
    path = written(tmp_path / "a.tif", LABELS.astype(np.uint8))
    monkeypatch.setitem(sys.modules, "tifffile", None)
    with pytest.raises(InputError, match=r"pip install 'surrofe2\[image\]'"):
        read_labels(path)
