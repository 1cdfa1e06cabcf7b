"""Memory of arrays that are gone is used again, and never that of arrays that are not."""

import gc
import threading
from collections import deque

import numpy as np
import pytest

from clrelight import recycling


@pytest.fixture(autouse=True)
def nothing_kept():
    gc.collect()
    recycling._unused.clear()
    yield
    recycling._unused.clear()


def address(array):
    return array.__array_interface__["data"][0]


def test_an_array_is_as_numpys_own():
    array = recycling.empty((3, 70, 501), np.float32)
    assert array.shape == (3, 70, 501)
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    assert array.flags.writeable
    array[...] = 7.0
    assert (array == 7.0).all()


@pytest.mark.parametrize("size", [recycling._LEAST, (1 << 20) + 12, recycling._KEPT + 4])
def test_vectors_lie_in_one_line_of_the_caches(size):
    for array in (recycling.empty((size // 4,), np.float32), recycling.empty((size // 4,), np.float32)):
        assert address(array) % 64 == 0


def test_memory_is_used_again():
    first = recycling.empty((1 << 20,), np.uint8)
    place = address(first)
    del first
    assert address(recycling.empty((1 << 18,), np.float32)) == place


def test_a_view_keeps_its_memory():
    first = recycling.empty((1 << 20,), np.float32)
    first[...] = 3.0
    view = first.reshape(1024, 1024)[5:, ::2].view(np.int32)
    place = address(first)
    del first
    other = recycling.empty((1 << 20,), np.float32)
    other[...] = 4.0
    assert address(other) != place
    assert (view.view(np.float32) == 3.0).all()


def test_a_somewhat_larger_block_is_used_too():
    first = recycling.empty((3 << 20,), np.uint8)
    place = address(first)
    del first
    assert address(recycling.empty((1 << 20,), np.uint8)) != place  # a third of it
    assert address(recycling.empty((5 << 19,), np.uint8)) == place


def test_looking_for_a_block_leaves_the_order():
    sizes = [1 << 18, 1 << 20, 1 << 22, 1 << 24]
    recycling._unused.extend(np.empty(size, np.uint8) for size in sizes)
    recycling.empty((1 << 20,), np.uint8)  # its block comes back as the last
    assert [block.size for block in recycling._unused] == [1 << 18, 1 << 22, 1 << 24, 1 << 20]
    recycling.empty((1 << 26,), np.uint8)  # there is none
    assert [block.size for block in recycling._unused][:4] == [1 << 18, 1 << 22, 1 << 24, 1 << 20]


def test_zeros_and_copies_of_memory_that_was_used():
    array = recycling.empty((1 << 18,), np.uint8)
    array[...] = 7
    copy = recycling.copied(array.reshape(1 << 9, 1 << 9)[:, ::2])
    assert copy.flags.c_contiguous
    assert (copy == 7).all()
    del array
    assert not recycling.zeros((1 << 18,), np.uint8).any()
    assert not recycling.zeros((recycling._KEPT // 4 + 1,), np.float32)[::4096].any()


def test_no_more_than_a_bound_is_kept():
    arrays = [recycling.empty((1 << 24,), np.uint8) for _ in range(recycling._KEPT // (1 << 24) + 4)]
    del arrays
    assert 0 < sum(block.size for block in recycling._unused) <= recycling._KEPT


@pytest.mark.parametrize("size", [0, 1, recycling._LEAST - 1, recycling._KEPT + 1])
def test_small_and_huge_arrays_are_not_kept(size):
    recycling.empty((size,), np.uint8)
    assert not recycling._unused


def test_many_threads_share_no_memory():
    faults = []

    def work(number):
        for _ in range(200):
            array = recycling.empty((1 << 18,), np.uint8)
            array[...] = number
            if not (array == number).all():
                faults.append(number)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults


def test_blocks_that_others_took_meanwhile_are_no_error(monkeypatch):
    class Taken(deque):
        def popleft(self):
            self.clear()
            return super().popleft()

    monkeypatch.setattr(recycling, "_unused", Taken([np.empty(recycling._KEPT, np.uint8)]))
    recycling._give_back(np.empty(1 << 20, np.uint8))
    assert not recycling._unused


def test_a_budget_bounds_what_lies_unused_while_it_is_kept_to():
    def unused():
        return sum(block.size for block in recycling._unused)

    arrays = [recycling.empty((1 << 22,), np.uint8) for _ in range(8)]
    del arrays
    assert unused() == 8 << 22
    with recycling.kept_within(64 << 20):
        assert 0 < unused() <= (64 << 20) // recycling._SHARE
        with recycling.kept_within(1 << 20):
            assert unused() == 0
            recycling.empty((1 << 22,), np.uint8)
            assert unused() == 0
        recycling.empty((1 << 22,), np.uint8)
        recycling.empty((1 << 25,), np.uint8)  # more than the bound, which takes nothing else with it
        assert unused() == 1 << 22
    arrays = [recycling.empty((1 << 22,), np.uint8) for _ in range(8)]
    del arrays
    assert unused() == 8 << 22
