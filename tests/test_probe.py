"""Drivers that abort, hang or are wrong, judged by real child processes; what is kept of it."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time

import click
import pytest

from clrelight import truth
from clrelight.cli.quiet import add_quiet, speaking_after
from clrelight.device import open_device
from clrelight.errors import DeviceError
from clrelight.opencl import child, drivers, folder, probe, records
from clrelight.opencl import devices as device_module
from clrelight.opencl.devices import DEVICE_VARIABLE, STYLE_VARIABLE, list_devices
from clrelight.selftest import run_quick_selftest
from tests.styles import every_width

ABORT = "import os, sys; print('LLVM ERROR: Cannot select: fsqrt', file=sys.stderr, flush=True); os.abort()"
HANG = "import time; time.sleep(60)"
RAISE = "raise RuntimeError('no such thing')"
BUILD = "raise ValueError('f.cl does not build\\n\\nerror: unknown target CPU')  # an error"
SILENT = "pass"


USUAL = folder.cache_folder() / "kernels"


def answer(rate, wrong=()):
    return f"import json; print(json.dumps(dict(rate={rate}, checks=17, wrong={list(wrong)!r})))"


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Nothing is known of any device, and what is found is kept in a folder of the test."""
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.delenv(STYLE_VARIABLE, raising=False)
    monkeypatch.setenv(folder.CACHE_VARIABLE, str(tmp_path / "cache"))
    folder.cache_folder.cache_clear()
    monkeypatch.setattr(device_module, "_verdicts", {})
    yield tmp_path / "cache"
    folder.cache_folder.cache_clear()


@pytest.fixture
def compiled(fresh):
    """Nothing is known of any device, but its kernels are compiled: what takes most of a test's time."""
    USUAL.mkdir(parents=True, exist_ok=True)
    fresh.mkdir()
    (fresh / "kernels").symlink_to(USUAL)
    return fresh


def judge(native=8, style="cpu", again=False):
    return probe.judge_device("A driver", "its build", 0, native, style, again=again)


def test_the_rate_of_a_cpu_is_of_work_not_of_waiting(monkeypatch):
    passed = iter(range(10**9))
    monkeypatch.setattr(truth.time, "perf_counter", lambda: 1e6 * next(passed))  # other processes have the machine
    device = open_device()
    if not device.shares_memory:
        pytest.skip("of CPUs")
    assert truth.measure_rate(device) > 0.01


def test_a_clock_that_ticks_slowly_tells_a_rate(monkeypatch):
    reads = iter(range(10**9))
    for name in ("perf_counter", "process_time"):
        monkeypatch.setattr(truth.time, name, lambda: 0.016 * (next(reads) // 5))
    assert 0.0 < truth.measure_rate(open_device()) < 1e6


@every_width
def test_every_width_computes_right(device):
    assert device.info.lanes in (4, 8, 16)
    assert [s for s in run_quick_selftest(device) if not s.holds] == []


def test_the_real_probe_finds_this_machine_sound(compiled):
    info = open_device().info
    assert [listed.index for listed in list_devices() if listed.default] == [info.index]
    assert info.fault == ""
    assert info.lanes in probe.WIDTHS
    assert len(list((compiled / "devices").iterdir())) == len(list_devices())
    assert f"{info.lanes} lanes" in info.label


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        (ABORT, "ends the process, SIGABRT: LLVM ERROR: Cannot select: fsqrt"),
        (RAISE, "fails: RuntimeError: no such thing"),
        (BUILD, "fails: error: unknown target CPU"),
        (SILENT, "says nothing"),
        (
            answer(1.0, ["cls, degree 3: image error 1.0e+00", "half"]),
            "computes wrong numbers with 8 lanes (cls, degree 3: image error 1.0e+00, and 1 more of 17 checks)",
        ),
    ],
)
def test_what_is_wrong_is_said_and_kept_for_a_day(fresh, monkeypatch, code, fault):
    monkeypatch.setattr(probe, "_CODE", code)
    assert judge() == probe.Verdict(0, fault)
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    assert judge() == probe.Verdict(0, fault)
    now = time.time()
    monkeypatch.setattr(records.time, "time", lambda: now + 90000)
    assert judge() == probe.Verdict(8)


@pytest.mark.parametrize("code", ["import clrelight.absent", "exec('a b')", "from clrelight import absent"])
def test_a_program_that_does_not_load_is_no_word_on_a_device(fresh, monkeypatch, code):
    monkeypatch.setattr(probe, "_CODE", code)
    assert judge().lanes == 0
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    assert judge() == probe.Verdict(8)


def test_an_error_of_ours_is_told_as_one_and_not_kept(fresh, monkeypatch):
    # An exception of a driver's wrong numbers, or of its build, has another name.
    monkeypatch.setattr(probe, "_CODE", "from clrelight.truth import main; main(None)")
    told = judge()
    assert told.lanes == 0
    assert told.fault.startswith("cannot be tested, by a fault of this program and not of the driver: TypeError: ")
    assert re.search(r" \(truth\.py, line \d+\)$", told.fault)
    assert not (fresh / "devices").exists()
    monkeypatch.setattr(probe, "_CODE", "raise ValueError('TypeError: of a driver')")
    assert judge().fault == "fails: ValueError: TypeError: of a driver"


def test_a_fault_is_forgotten_when_the_program_changes(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", ABORT)
    assert judge().lanes == 0
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    assert judge().lanes == 0
    monkeypatch.setattr(probe, "code_identity", lambda: "another")
    assert judge() == probe.Verdict(8)
    monkeypatch.setattr(probe, "_CODE", ABORT)
    monkeypatch.setattr(probe, "code_identity", lambda: "a third")
    assert judge() == probe.Verdict(8)  # what is sound stays so: kernels and their test are the same


def test_a_terminal_is_told_of_a_test_unless_it_wants_quiet(fresh, monkeypatch, capsys):
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(probe, "_tells", True)
    judge()
    assert "testing A driver" in capsys.readouterr().err
    add_quiet(group := click.Group(commands=[click.Command("test", callback=lambda: judge(again=True))]))
    with speaking_after():
        group.main(["test", "--quiet"], standalone_mode=False)
    assert capsys.readouterr().err == ""


def test_a_driver_that_hangs_is_left(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", HANG)
    monkeypatch.setattr(probe, "SECONDS", 0.5)
    start = time.monotonic()
    assert judge() == probe.Verdict(0, "does not answer within 0 s")
    assert time.monotonic() - start < 10


def test_again_asks_again(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", ABORT)
    judge()
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    assert judge(again=True) == judge() == probe.Verdict(8)


ABORTS_ABOVE = "import os; int(words[1]) > {} and os.abort(); "


@pytest.mark.parametrize(
    ("native", "code", "lanes"),
    [
        (16, answer("100 - int(words[1])"), 8),
        (16, answer("int(words[1])"), 16),
        (16, ABORTS_ABOVE.format(4) + answer(1.0), 4),
        (8, ABORTS_ABOVE.format(4) + answer(1.0), 4),
        (4, answer("100 - int(words[1])"), 4),
        (1, answer("int(words[1])"), 8),
    ],
)
def test_the_faster_of_what_is_sound(fresh, monkeypatch, native, code, lanes):
    monkeypatch.setattr(probe, "_CODE", code)
    assert judge(native) == probe.Verdict(lanes)


@pytest.mark.parametrize(("fault", "taken"), [("", 8), ("it crashed", 16)])
def test_the_first_of_processes_that_ask_at_once_decides(fresh, monkeypatch, fault, taken):
    keys = []

    def overtaken(index, native, style):
        """Another process, asked at the same time, ends first."""
        records.write_record("devices", keys[-1], {"lanes": 8, "fault": fault})
        return probe.Verdict(16)

    read = records.read_record
    monkeypatch.setattr(probe, "read_record", lambda kind, key: keys.append(key) or read(kind, key))
    monkeypatch.setattr(probe, "_find_width", overtaken)
    assert judge().lanes == taken
    assert judge().lanes == taken


def test_kernels_for_gpus_have_one_width(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    assert judge(16, style="gpu") == probe.Verdict(8)


def test_where_nothing_is_sound_each_fault_is_said(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", ABORT)
    with pytest.raises(DeviceError, match=r"computes soundly: .*SIGABRT: LLVM ERROR.*another driver may: .*install"):
        open_device()
    index = str(list_devices()[0].index)
    with pytest.raises(DeviceError, match="is not sound: it ends the process, SIGABRT"):
        open_device(index)
    assert open_device(index + "@8").info.lanes == 8  # who asks for it gets it
    assert not any(info.default for info in list_devices())


def test_the_next_device_is_taken(fresh, monkeypatch):
    first = device_module.loaded_devices()[0][0]
    two = [(first, None), (device_module.replace(first, index=1, name="Other", packaged=False), None)]
    monkeypatch.setattr(device_module, "loaded_devices", lambda: two)
    monkeypatch.setattr(
        device_module, "_verdicts", {(0, "cpu"): probe.Verdict(0, "hangs"), (1, "cpu"): probe.Verdict(4)}
    )
    assert device_module.choose_device(None, None).name == "Other"
    assert [info.default for info in list_devices()] == [False, True]


@pytest.mark.parametrize("spec", ["@5", "cpu@", "0@32"])
def test_lanes_that_there_are_not(spec):
    with pytest.raises(DeviceError, match="must be one of 16, 8, 4"):
        open_device(spec)


def test_damaged_records_count_as_absent(fresh, monkeypatch):
    monkeypatch.setattr(probe, "_CODE", answer(1.0))
    judge()
    (path,) = (fresh / "devices").iterdir()
    whole = path.read_bytes()
    asked = []
    monkeypatch.setattr(probe, "_ask", lambda *words: asked.append(words) or (1.0, ""))
    for damaged in (b"", b"{}", b"[]", whole[:-5], whole.replace(b'"lanes": 8', b'"lanes": 4')):
        path.write_bytes(damaged)
        assert judge() == probe.Verdict(8)
    assert len(asked) == 5


def test_circumstances_are_named_and_not_held_against_the_driver(fresh, monkeypatch):
    monkeypatch.setenv("PATH", str(fresh))
    probe.machine_identity.cache_clear()
    monkeypatch.setattr(probe, "_CODE", ABORT)
    if sys.platform == "linux":
        assert "needs the linker ld" in judge().fault
        assert not (fresh / "devices").exists()
    probe.machine_identity.cache_clear()


def test_little_memory_and_few_files_are_named(monkeypatch):
    monkeypatch.setattr(child, "_limits", lambda: (2 << 30, 16))
    told = "; ".join(child.circumstances())
    assert "the address space is limited to 2.0 GiB, see ulimit -v" in told
    assert "only 16 files may be open at once, see ulimit -n" in told
    monkeypatch.setattr(child, "_limits", lambda: (-1, -1))
    assert not any("limited" in words or "files" in words for words in child.circumstances())


@pytest.fixture
def vendors(tmp_path, monkeypatch):
    """A folder of drivers of which one ends the process that loads it."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform in ("win32", "darwin"):
        pytest.skip("needs a C compiler, to make a driver that aborts")
    place = tmp_path / "vendors"
    place.mkdir()
    source = tmp_path / "bad.c"
    source.write_text("#include <stdlib.h>\n__attribute__((constructor)) static void f(void) { abort(); }\n")
    library = tmp_path / "libbad.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source], check=True)
    (place / "bad.icd").write_text(f"{library}\n")
    (place / "absent.icd").write_text("libnowhere.so\n")
    for file in drivers._vendor_files():  # one of them may be the only sound driver here
        shutil.copy(file, place)
    monkeypatch.setenv(drivers.VENDORS_VARIABLE, str(place))
    return place


def test_a_driver_that_aborts_when_loaded_is_left_out(compiled, vendors):
    code = "from clrelight.device import open_device; open_device('@8'); print('alive')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (0, "alive\n"), ended.stderr
    listed = subprocess.run([sys.executable, "-m", "clrelight", "devices", "--json"], capture_output=True, text=True)
    assert listed.returncode == 0, listed.stderr
    left_out = json.loads(listed.stdout)["left_out"]
    assert list(left_out) == [str(vendors / "bad.icd")]
    assert "SIGABRT" in left_out[str(vendors / "bad.icd")]


def test_use_after_fork_is_an_error_at_once():
    code = """
import os, sys
import numpy as np
from clrelight.device import open_device
from clrelight.errors import DeviceError
device = open_device()
array = device.upload(np.zeros(4, np.float32))
child = os.fork()
if child == 0:
    for use in (open_device, device.finish, lambda: device.download(array), lambda: device.upload(np.zeros(3))):
        try:
            use()
        except DeviceError as error:
            print(str(error)[:40], flush=True)
    sys.exit(7)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
device.finish()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ended.stdout.splitlines() == ["OpenCL was used before this process was "] * 4 + ["7"], ended.stderr
    assert ended.stderr == ""


@pytest.mark.skipif(not hasattr(signal, "alarm"), reason="Windows has no alarms")
def test_a_child_ends_by_itself_where_nobody_ends_it():
    """Its parent may be killed; a driver that hangs would keep a processor for ever."""
    code, output, _ = child.run_child("import signal; print(signal.alarm(0))", seconds=7)
    assert (code, 7 < int(output) <= 12) == (0, True)


def test_advice_on_address_space_is_more_than_the_limit(monkeypatch):
    """Also where the limit is wide, and nearly all of it is taken."""
    limits = iter([(500_000 << 10, -1), (8 << 30, -1), (-1, -1)])
    monkeypatch.setattr(child, "_limits", lambda: next(limits))
    monkeypatch.setattr(child, "SPARE_ADDRESSES", 1 << 62)
    for least in (2_000_000, 8 << 20):
        with pytest.raises(DeviceError, match="ulimit -v") as told:
            child.check_addresses()
        assert int(str(told.value).split()[-1]) >= least
    child.check_addresses()
