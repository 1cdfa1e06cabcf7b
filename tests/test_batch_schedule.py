"""The simulation of schedules, where the answer is known; and what fuzzers are given."""

import numpy as np
import pytest

from benchmarks.schedule import Nothing, measure_driver, scale_rows, simulate
from tests.python_fuzz import prepare, targets
from tests.refusal_times import CORPORA, Slowest


def test_schedules_that_can_be_told_beforehand():
    assert simulate([3.0, 4.0, 5.0], 1, start=1.0) == 13.0
    assert simulate([2.0] * 10, 4) == 6.0  # three rounds
    assert simulate([10.0, 1.0, 1.0, 1.0], 2) == 10.0
    assert simulate([], 3, start=2.0) == 2.0


def test_a_driver_that_is_slower_than_its_workers():
    assert simulate([1e-6] * 1000, 100, driver=0.01) == pytest.approx(10.0, rel=0.01)
    # One worker waits for the driver after each task, unless the next one is there already.
    assert simulate([1.0] * 100, 1, driver=0.1) == pytest.approx(110.0)
    assert simulate([1.0] * 100, 1, ahead=1, driver=0.1) == pytest.approx(100.1, abs=0.1)


def test_deaths_cost_what_was_begun():
    lengths = [10.0] * 400
    calm = simulate(lengths, 4)
    # Of tasks of 10 s with a death in 100 s, e^0.1 begin anew; what was done of them is lost.
    lively = [simulate(lengths, 4, deaths=0.01, again=1.0, seed=seed) for seed in range(20)]
    expected = 100.0 * (np.exp(0.1) - 1.0) * 100.0 + 400 * (np.exp(0.1) - 1.0) / 4
    assert calm == 1000.0
    assert np.mean(lively) == pytest.approx(expected, rel=0.03)
    assert simulate(lengths, 4, deaths=0.01, seed=3) == simulate(lengths, 4, deaths=0.01, seed=3)


def test_what_stops_more_workers():
    rows = scale_rows(10_000, 30.0, 1e9, 0.0, 0.01, 2e9)
    assert [row[4] for row in rows] == ["", "", "the file system", "the file system", "the file system"]
    assert float(rows[0][1].replace(",", "")) == pytest.approx(10_000 * 30 / 3600, rel=0.05)
    assert scale_rows(10**6, 1.0, 1.0, 0.0, 0.01, 1e12)[3][4] == "the driver"


def test_the_driver_alone(tmp_path):
    assert 0 < measure_driver(tmp_path, 20) < 1.0
    assert len((tmp_path / "journal.jsonl").read_text().splitlines()) == 22
    assert Nothing().isolates


@pytest.mark.parametrize("name", ["journal", "list", "shards", "file fit", "half"])
def test_what_fuzzers_are_given(name, tmp_path):
    """Seeds, and some of them cut short: nothing that is not refused."""
    assert name in targets()
    run, seeds = prepare(name, tmp_path)
    assert seeds
    for seed in seeds[:3]:
        for end in (len(seed), len(seed) // 2, 1, 0):
            run(seed[:end])


@pytest.mark.parametrize("kind", ["tiles", "shards", "journals", "lists", "stacks made to do harm"])
def test_what_is_to_be_refused(kind, tmp_path):
    slowest = Slowest(10.0)
    CORPORA[kind](tmp_path, 3, slowest, np.random.default_rng(1))
    told = slowest.told(kind)
    assert not told["failures"]
    assert told["refused"] > 0
    assert told["slowest_cpu_ms"] > 0


def test_an_exception_that_is_no_refusal_is_a_failure():
    slowest = Slowest(10.0)
    slowest.time("a case", lambda: 1 / 0)
    assert slowest.told("kind")["failures"] == ["a case: ZeroDivisionError('division by zero')"]
