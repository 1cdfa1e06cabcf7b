"""How far what trade takes lies from the front of all settings: the verdict of the benchmark."""

import pytest

from benchmarks.trade_front import judge
from tests.test_trade import trial


def test_the_verdict_names_what_all_settings_would_be_taken_for():
    tried = [trial(1.0, 1000, 20.0), trial(1.0, 100, 12.0)]
    on_front = judge(tried, [trial(1.0, 999, 19.0), trial(1.0, 120, 11.0)])
    assert (on_front.behind_db, on_front.best) == (0.0, tried[0])
    smaller, better = trial(1.0, 300, 19.8), trial(1.0, 1000, 20.2)
    found = judge(tried, [smaller, better])
    assert (found.taken, found.best) == (tried[0], better)
    assert found.behind_db == pytest.approx(0.2)
    assert (found.worst_db, found.worst_bytes) == (pytest.approx(7.8), 300)
    assert judge(tried, [smaller]).best is smaller  # 0.2 dB below the best, and a third of the bytes


def test_sizes_that_are_alike_are_no_gap():
    assert judge([trial(1.0, 1000, 20.0)], [trial(1.0, 990, 19.9)]).worst_db == 0.0
