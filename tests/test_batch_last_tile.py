"""The last tile of `pack` by workers: coded again in parts, by whoever holds one, with the bytes of one process."""

import functools

import pytest

from clrelight.batch import local
from clrelight.batch.engine import Work
from clrelight.batch.single import run_single
from clrelight.codec.formats import klt_tiles
from clrelight.jobs import packing_chores
from clrelight.jobs.pack import pack
from clrelight.jobs.packing_farm import even_groups
from clrelight.jobs.report import Report
from tests.test_batch import Here
from tests.test_batch_pack import OPTIONS, write


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """A stack, and what one process makes of it."""
    folder = tmp_path_factory.mktemp("last")
    write(folder / "a.h5")
    pack(folder / "a.h5", folder / "one.h5", report=Report(), **OPTIONS, measure="none")
    return folder / "a.h5", (folder / "one.h5").read_bytes()


class Forgetful(Here):
    """Each chore by a process that holds nothing of those before."""

    def collect(self, seconds):
        packing_chores._held._key = None
        return super().collect(seconds)


@pytest.mark.parametrize("kind", [Here, Forgetful])
def test_the_last_tile_is_coded_again_by_whoever_has_it_or_not(packed, tmp_path, monkeypatch, kind):
    """In parts, whose streams are asked for at other multipliers until the budget is filled."""
    monkeypatch.setattr(klt_tiles, "PART_PIXELS", 1)
    again, made = [], []
    code, of = packing_chores.code_tile, packing_chores.CodedPart.of

    @functools.wraps(code)
    def listen(*arguments, **given):
        again.append(given.get("again"))
        return code(*arguments, **given)

    monkeypatch.setattr(packing_chores, "code_tile", listen)
    monkeypatch.setattr(packing_chores.CodedPart, "of", lambda *a: made.append(a[1]) or of(*a))
    options = {**OPTIONS, "measure": "none"}
    run_single("pack", packed[0], tmp_path / "a.h5", options=options, engine=kind(), report=Report())
    assert (tmp_path / "a.h5").read_bytes() == packed[1]
    asked = [each for each in again if each is not None]
    assert asked
    # Who has a part codes it once; who has not codes it each time, with the same bytes.
    assert (len(made) < len(asked) + 2) == (kind is Here)


def test_a_chore_goes_to_the_worker_that_had_one_of_its_name(monkeypatch):
    class Fake:
        def __init__(self, workers, lock):
            self.near, self.got, self.is_alive = set(), [], True

        def begin(self, work, timeout):
            self.got.append(work.name)

    monkeypatch.setattr(local, "_Worker", Fake)
    engine = local.LocalEngine(2)
    for _ in range(2):
        engine.begin()
        assert len(engine._idle) == 2  # which load meanwhile what they need

    def give(**near_of):
        for name, near in near_of.items():
            engine.submit(Work(name, {"near": near}, "", "", None))
        found = {name: engine._busy.pop(name) for name in near_of}
        engine._idle.extend(found.values())
        return found

    first = give(a="left", b="right")
    assert first["a"] is not first["b"]
    for names in ({"c": "left", "d": "right"}, {"d": "right", "c": "left"}):
        again = give(**names)
        assert again["c"] is first["a"]
        assert again["d"] is first["b"]
    assert give(e="")["e"] in first.values()


@pytest.mark.parametrize(("count", "most", "sizes"), [(28, 4, {3, 4}), (12, 6, {6}), (5, 4, {2, 3}), (1, 4, {1})])
def test_groups_are_even(count, most, sizes):
    places = [[n, 0, n + 1, 1] for n in range(count)]
    groups = even_groups(places, most)
    assert [place for group in groups for place in group] == places
    assert {len(group) for group in groups} == sizes
    assert len(groups) % 2 == 0 or len(groups) == 1
    assert even_groups([], most) == []
