"""Parts of images come out alike wherever these lie."""

import h5py
import numpy as np
import pytest

from clrelight.store.blocks import BlockWriter
from clrelight.store.foreign import ForeignImages
from clrelight.store.scratch_images import ScratchImages
from clrelight.store.stored import StoredArray
from clrelight.tiles import LightSubset, PixelArray, Rectangle, read_tile, row_tiles

SHAPE = (6, 11, 7, 3)
VALUES = np.random.default_rng(3).integers(0, 60000, SHAPE, np.uint16)
PARTS = [Rectangle(0, 0, 11, 7), Rectangle(2, 3, 9, 5), Rectangle(10, 6, 11, 7), Rectangle(4, 2, 4, 5)]


@pytest.fixture(params=["memory", "chunks", "one block", "HDF5", "deflated", "MATLAB", "wide", "scratch", "h5py"])
def images(request, tmp_path):
    kind, path = request.param, tmp_path / "x.h5"
    if kind == "memory":
        yield VALUES
        return
    if kind == "scratch":
        scratch = ScratchImages(tmp_path, SHAPE, VALUES.dtype)
        for light, image in enumerate(VALUES):
            scratch.write_rows(light, 0, image)
        yield scratch
        scratch.close()
        return
    held = {"MATLAB": VALUES.transpose(), "wide": VALUES.astype(np.int64)}.get(kind, VALUES)
    chunks = {"chunks": (2, 3, 7, 3), "HDF5": (4, 4, 4, 3), "deflated": (3, 4, 7, 3)}.get(kind)
    sums = None
    with h5py.File(path, "w") as file:
        if kind in ("chunks", "one block"):
            dataset = file.create_dataset("x", SHAPE, held.dtype, chunks=chunks)
            writer = BlockWriter(dataset)
            writer.write(writer.blocks.everything, held)
            sums = writer.sums()
        else:
            file.create_dataset("x", data=held, chunks=chunks, compression="gzip" if kind == "deflated" else None)
    with h5py.File(path) as file:
        if kind == "h5py":
            yield file["x"]
            return
        stored = StoredArray(file["x"], "x.h5", sums)
        axes = {"MATLAB": (3, 2, 1, 0), "wide": (0, 1, 2, 3)}.get(kind)
        yield stored if axes is None else ForeignImages(stored, axes, VALUES.dtype)


def read(images, part, picked=None):
    count = len(images) if picked is None else len(picked)
    return read_tile(images, part, np.zeros((count, *part.shape, 3), np.uint16), picked)


@pytest.mark.parametrize("part", PARTS)
def test_parts_are_those_that_were_written(images, part):
    np.testing.assert_array_equal(read(images, part), VALUES[:, part.rows, part.columns])
    for picked in (np.arange(6), np.array([4, 1, 5]), np.array([2, 2])):
        np.testing.assert_array_equal(read(images, part, picked), VALUES[picked][:, part.rows, part.columns])


def test_parts_of_some_of_some_lights(images):
    some = LightSubset(images, np.array([5, 0, 3, 1]))
    assert isinstance(some, PixelArray)
    part, picked = Rectangle(3, 1, 8, 6), np.array([3, 0])
    found = read_tile(some, part, np.zeros((2, 5, 5, 3), np.uint16), picked)
    np.testing.assert_array_equal(found, VALUES[[1, 5], 3:8, 1:6])


@pytest.mark.parametrize(
    "part", [Rectangle(-1, 0, 2, 7), Rectangle(0, 0, 12, 7), Rectangle(0, 5, 3, 8), Rectangle(3, 4, 5, 2)]
)
def test_parts_beyond_an_image_are_refused(images, part):
    if not isinstance(images, np.ndarray | h5py.Dataset):
        with pytest.raises(ValueError, match="expected a part of 11 x 7 pixels"):
            images.read_into(part, np.zeros((6, 3, 7, 3), np.uint16))


def test_an_array_of_another_shape_is_refused(images):
    if not isinstance(images, np.ndarray | h5py.Dataset):
        with pytest.raises(ValueError, match="expected an array"):
            images.read_into(Rectangle(0, 0, 3, 7), np.zeros((6, 3, 6, 3), np.uint16))


def test_rows_in_tiles():
    assert row_tiles((3, 11), 3) == [(3, 6), (6, 9), (9, 11)]
    assert row_tiles((0, 0), 3) == []
