"""Photographs that are packed lie in memory where the system has much to spare, else in a file."""

import errno
import os

import numpy as np
import pytest

from clrelight.images import write_image
from clrelight.ingest import read_folder
from clrelight.jobs.ingest import lend_photographs
from clrelight.jobs.memory import SPARE_SHARE, _left_in, spare_memory
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern

V2 = ("memory.max", "memory.current", "inactive_file")


def make_group(folder, most, used, unused=0):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "memory.max").write_text(f"{most}\n")
    (folder / "memory.current").write_text(f"{used}\n")
    (folder / "memory.stat").write_text(f"anon 7\ninactive_file {unused}\n")


def write_folder(folder, n_light=5):
    folder.mkdir()
    images, lines = np.random.default_rng(0).integers(0, 256, (n_light, 6, 7, 3), dtype=np.uint8), [str(n_light)]
    for light, (image, direction) in enumerate(zip(images, make_pattern("uniform", n_light), strict=True)):
        write_image(folder / f"{light}.png", image)
        lines.append(f"{light}.png {' '.join(map(str, direction))}")
    (folder / "dome.lp").write_text("\n".join(lines))
    return folder, images


def test_the_least_of_a_group_and_of_those_above_is_left(tmp_path):
    make_group(tmp_path / "a" / "b", "max", 900)
    make_group(tmp_path / "a", 1000, 700, 50)
    assert _left_in(tmp_path, "/a/b", *V2) == 350
    make_group(tmp_path / "a" / "b", 400, 300)
    assert _left_in(tmp_path, "/a/b", *V2) == 100


def test_groups_that_say_nothing_leave_everything(tmp_path):
    assert _left_in(tmp_path, "/not/seen/from/here", *V2) == float("inf")
    make_group(tmp_path / "a", "what", 1)
    assert _left_in(tmp_path, "/a", *V2) == float("inf")


@pytest.mark.skipif(not os.path.exists("/proc/meminfo"), reason="only Linux says what it has to spare")
def test_spare_memory_is_some_of_all_memory():
    assert 0 < spare_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="the system has no files in memory")
@pytest.mark.parametrize("enough", [True, False])
def test_photographs_lie_in_memory_where_there_is_enough(tmp_path, monkeypatch, enough):
    folder, images = write_folder(tmp_path / "photos")
    monkeypatch.setattr("clrelight.jobs.ingest.spare_memory", lambda: SPARE_SHARE * images.nbytes - (not enough))
    report = Report()
    with lend_photographs(
        read_folder(folder), tmp_path, 1 << 24, report, None, [tmp_path / "out.h5"], lambda stack: None
    ) as stack:
        assert (stack.images_ihwc[:] == images).all()
        assert report.facts["photographs_in_memory"] == (images.nbytes if enough else 0)


def test_a_system_that_forbids_files_in_memory_has_them_on_the_disk(tmp_path, monkeypatch):
    folder, images = write_folder(tmp_path / "photos")

    def forbidden(*_):
        raise OSError(errno.EPERM, "a sandbox")

    monkeypatch.setattr("clrelight.jobs.ingest.spare_memory", lambda: SPARE_SHARE * images.nbytes)
    monkeypatch.setattr(os, "memfd_create", forbidden, raising=False)
    report = Report()
    with lend_photographs(
        read_folder(folder), tmp_path, 1 << 24, report, None, [tmp_path / "o.h5"], lambda stack: None
    ) as stack:
        assert (stack.images_ihwc[:] == images).all()
        assert report.facts["photographs_in_memory"] == 0
