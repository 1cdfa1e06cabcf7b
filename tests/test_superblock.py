"""Files that HDF5 leaves as open ones, as 1.14 does with those it built in memory."""

import h5py
import pytest

from clrelight.store.superblock import closed, lookup3


def join(image):
    return b"".join(closed(image))


def test_checksums_are_those_of_lookup3():
    assert lookup3(b"Four score and seven years ago") == 0x17770551  # of the test in lookup3.c


def test_a_file_left_open_is_closed(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w", libver="latest") as file:
        file["values"] = range(5)
    whole = (tmp_path / "a.h5").read_bytes()
    assert whole[8] in (2, 3)
    assert join(whole) == whole
    # Flagged, with the checksum of that; and, as 1.14 does, without the flag but with that checksum.
    flagged = whole[:11] + b"\1" + whole[12:44]
    left = whole[:44] + lookup3(flagged).to_bytes(4, "little") + whole[48:]
    (tmp_path / "left.h5").write_bytes(left)
    with pytest.raises(OSError, match="checksum"):
        h5py.File(tmp_path / "left.h5")
    assert join(left) == whole
    assert join(flagged + left[44:]) == whole


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n\0" + bytes(90), b"no HDF5" * 9])
def test_what_has_no_such_superblock_stays(content):
    assert join(content) == content
