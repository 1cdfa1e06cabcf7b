"""Parts of what lies in a file without a name are read as they were written, however far apart their rows are."""

import numpy as np
import pytest

from clrelight.store.scratch import Scratch
from clrelight.tiles import Rectangle


@pytest.mark.parametrize("in_memory", [False, True])
@pytest.mark.parametrize("width", [50, 3000])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_parts_are_what_was_written(tmp_path, in_memory, width, dtype):
    written = np.random.default_rng(0).integers(0, 200, (3, 40, width, 3)).astype(dtype)
    scratch = Scratch(tmp_path, written.nbytes, in_memory=in_memory)
    scratch.write(0, written)
    for sides in ((0, 0, 40, width), (5, 7, 9, 33), (39, width - 1, 40, width), (0, 1, 40, 2)):
        tile = Rectangle(*sides)
        found = np.empty((2, *tile.shape, 3), dtype)
        scratch.read_tile_into(written.shape, tile, found, np.array([2, 0]))
        np.testing.assert_array_equal(found, written[[2, 0], tile.rows, tile.columns])
    scratch.close()
