"""Small tasks that go to a worker several at a time: how many, and what is known of them where it dies."""

import pytest

from clrelight.batch import run_batch
from clrelight.batch.engine import Ended
from clrelight.batch.pace import MOST_SECONDS, SECONDS, Pace
from clrelight.batch.perform import perform
from clrelight.batch.task import Outcome, Task
from clrelight.jobs.report import Report


@pytest.mark.parametrize(
    ("seconds", "size"),
    [([], 1), ([0.05] * 4, 10), ([0.5], 1), ([60.0], 1), ([0.24] * 3, 3), ([0.0] * 9, 64), ([2.0, *[0.1] * 6], 5)],
)
def test_parcels_take_half_a_second(seconds, size):
    pace = Pace()
    pace.learn(seconds)
    assert pace.size == size


def test_parcels_follow_what_tasks_take():
    pace = Pace()
    for seconds, size in ((0.05, 10), (5.0, 1), (0.1, 5)):
        pace.learn([seconds] * 15)
        assert pace.size == size


class Parcels:
    """An engine whose workers have several tasks each, one after the other; a task named ``poison`` ends its worker."""

    label, workers, isolates = "parcels", 2, False

    def __init__(self, size, deaths=None):
        self.size, self.deaths = size, dict(deaths or {"poison": 99})
        self.ahead, self.held, self.begun, self.died = self.workers * (2 * size - 1), [], [], 0

    def __call__(self, lock):
        return self

    def submit(self, work):
        self.held.append(work)

    def collect(self, seconds):
        parcel, self.held = self.held[: self.size], self.held[self.size :]
        self.begun.append([work.name for work in parcel])
        for work in parcel:
            if self.deaths.get(work.name, 0):
                self.deaths[work.name] -= 1
                self.died += 1
                return [Ended(each.name, None, "ends the process of its worker", "died") for each in parcel]
        return [Ended(work.name, Outcome(work.name, "done", work.key).to_json()) for work in parcel]

    def doing(self):
        return ""

    def avoid(self, worker):
        return False

    def close(self):
        pass


def run(engine, names, tmp_path, **changes):
    tasks = [Task(name, "fit", f"/none/{name}.h5", str(tmp_path / f"{name}.h5")) for name in names]
    done = run_batch(tasks, tmp_path, engine=engine, keep_going=True, report=Report(), **changes)
    return {each.name: each for each in done.outcomes}


NAMES = ["a", "b", "poison", "c", "d", "e", "f"]


@pytest.mark.parametrize("size", [1, 3, 20])
def test_a_poison_task_ends_two_workers_and_its_neighbours_are_done(size, tmp_path):
    engine = Parcels(size)
    done = run(engine, NAMES, tmp_path)
    assert {name for name in NAMES if done[name].is_done} == {*NAMES} - {"poison"}
    assert done["poison"].error == "ends the process of its worker, 2 times"
    assert engine.died == 2
    # Who waited behind it is done before a second worker has to end.
    assert engine.begun[-1] == ["poison"] or size > 1


def test_without_retries_only_who_is_alone_fails(tmp_path):
    engine = Parcels(3)
    done = run(engine, NAMES, tmp_path, retries=0)
    assert [name for name in NAMES if not done[name].is_done] == ["poison"]
    assert done["poison"].tries == 2  # among others, and alone
    done = run(Parcels(3, {"a": 1, "d": 1}), NAMES, tmp_path, retries=0, anew=True)
    assert all(each.is_done for each in done.values())


def test_neighbours_of_many_deaths_have_not_died_themselves(tmp_path):
    """Deaths of a parcel count once for each task of it, and those of a task that is alone each time."""
    engine = Parcels(3, {"a": 1, "b": 1})
    done = run(engine, ["a", "b", "c"], tmp_path, retries=2)
    assert all(each.is_done for each in done.values())
    done = run(Parcels(3, {"b": 3}), ["a", "b", "c"], tmp_path, retries=2, anew=True)
    assert [name for name, each in done.items() if not each.is_done] == ["b"]


def test_a_worker_begins_no_more_when_its_time_is_up(monkeypatch):
    """Tasks that take longer than those before them are for others."""
    pytest.importorskip("distributed", reason="the engines of Dask: pip install 'clrelight[cluster]'")
    from types import SimpleNamespace

    import distributed

    from clrelight.batch import cluster

    now = [100.0]

    def takes(seconds):
        def work(task, key, code, device):
            now[0] += seconds
            return {"name": task, "seconds": seconds}

        return work

    monkeypatch.setattr(cluster.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(distributed, "get_worker", lambda: SimpleNamespace(address="tcp://w"))
    works = [{"task": str(number), "key": "", "code": "", "device": None} for number in range(10)]
    for seconds, done in ((SECONDS / 10, 10), (MOST_SECONDS / 4 + 0.01, 4), (60.0, 1)):
        monkeypatch.setattr(cluster, "perform", takes(seconds))
        told = cluster._perform(works)
        assert [each["name"] for each in told] == [str(number) for number in range(done)]
        assert {each["worker"] for each in told} == {"tcp://w"}
    assert perform is not cluster.perform
