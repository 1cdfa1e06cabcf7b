"""Bodies of great maps that code to next to nothing carry zeros; nothing else does."""

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, encode
from clrelight.codec.minimum_size import drop_padding, minimum_overhead, pad_to_minimum
from clrelight.errors import InputError, PayloadError

SMALL, GREAT = (49, 256, 256, 3), (49, 4096, 4096, 3)


@pytest.mark.parametrize("body", [b"", b"\0\0", b"coded", bytes(range(256)) * 300])
def test_what_was_coded_comes_back(body):
    assert pad_to_minimum(body, SMALL) == drop_padding(body, SMALL) == body
    assert minimum_overhead(SMALL) == 0
    loaded = pad_to_minimum(body, GREAT)
    assert drop_padding(loaded, GREAT) == body
    least = (49 * 4096 * 4096 * 3 - 2**24) / 2**17
    assert least <= len(loaded) <= max(least + 1, len(body) + minimum_overhead(GREAT))


def test_a_few_bytes_are_no_great_map():
    loaded = pad_to_minimum(b"coded", GREAT)
    for damaged in (b"coded", loaded[1:], loaded[:5] + b"\1" + loaded[6:], loaded[:-4] + b"\xff" * 4, loaded + b"\0"):
        with pytest.raises(PayloadError):
            drop_padding(damaged, GREAT)


def test_a_budget_below_the_least_size_is_refused():
    with pytest.raises(InputError, match="take at least 18688 bytes, the budget is 1000"):
        pad_to_minimum(b"coded", GREAT, 1000)


@pytest.mark.parametrize("codec_id", ["wavelet", "klt"])
def test_a_great_black_map_there_and_back(codec_id, device):
    black = np.zeros((4, 2048, 2100, 1), np.float32)
    encoded = encode(black, codec_class(codec_id)(rate=0.01), device)
    assert encoded.encoded_bytes < 300
    assert not decode(encoded.to_bytes(), device).any()
