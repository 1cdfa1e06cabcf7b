import functools
import os
import subprocess
import sys
from pathlib import Path

import hypothesis
import pytest

hypothesis.settings.register_profile("patient", deadline=None)  # a busy machine is no failure
hypothesis.settings.load_profile("patient")


def pytest_configure(config):
    """Have the device tested once, in both styles beside each other, before every worker does so by itself."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        return
    code = "import sys; from clrelight.device import open_device; open_device(style=sys.argv[1])"
    # What goes wrong there goes wrong in the tests.
    tested = [
        subprocess.Popen([sys.executable, "-c", code, style], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for style in ("cpu", "gpu")
    ]
    for each in tested:
        each.wait()


@pytest.fixture
def device(request, monkeypatch):
    """Return the default device; `tests.styles` chooses kernels and lanes, also for devices that the test opens."""
    from clrelight.device import open_device
    from clrelight.opencl.devices import DEVICE_VARIABLE, STYLE_VARIABLE

    if hasattr(request, "param"):
        monkeypatch.setenv(DEVICE_VARIABLE if request.param.startswith("@") else STYLE_VARIABLE, request.param)
    return open_device()


@pytest.fixture(autouse=True, scope="session")
def no_long_calls():
    """Look at every program that a test of this process builds: see `tests.calls`."""
    from clrelight.device import Device
    from tests.calls import check_calls, check_spelt

    build, compile_whole = Device._program, Device._compile_whole

    def build_and_look(self, file, defines):
        known = len(self._programs)
        program, name = build(self, file, defines)
        if len(self._programs) > known:
            check_calls(self, file, defines, name)
        return program, name

    def compile_whole_and_look(self, source, options):
        program = compile_whole(self, source, options)
        check_spelt(self, source)
        return program

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Device, "_program", build_and_look)
        patch.setattr(Device, "_compile_whole", compile_whole_and_look)
        yield


@pytest.fixture(autouse=True, scope="session")
def no_optimiser_for_gpus():
    """Have a CPU compile kernels that are for GPUs as they stand, in a fifth of the time: none runs them fast there.

    In processes of their own they are optimised: the test of the device, before any other, is such.
    """
    from clrelight.device import Device

    usual = Device._options.fget

    def options(self):
        as_written = self.style == "gpu" and self.info.kind == "cpu"
        return (*usual(self), *(["-cl-opt-disable"] if as_written else []))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Device, "_options", property(options))
        yield


@pytest.fixture(autouse=True, scope="session")
def one_ring_scene():
    """Have the tree of the ring scene's triangles made once a process, where many tests render it small."""
    from datasets_synth import ring

    make = functools.cache(ring.TorusTracer)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ring, "TorusTracer", lambda tori: make(tuple(tori)))
        yield


@pytest.fixture(autouse=True, scope="session")
def short_timings():
    """Have what experiments time done as often as they are told, not until it took a third of a second in all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clrelight.experiment.bench._ENOUGH", 0.0)
        yield


@pytest.fixture(autouse=True, scope="session")
def data_variable():
    """Return what ``CLRELIGHT_DATA`` was; only `real_data` hands it to tests: no other is to hang on what is there."""
    with pytest.MonkeyPatch.context() as patch:
        value = os.environ.get("CLRELIGHT_DATA")
        patch.delenv("CLRELIGHT_DATA", raising=False)
        yield value


@pytest.fixture(scope="session")
def real_data(data_variable):
    """Return the folder of the real stacks, or skip with the reason."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(data_variable or beside)
    if not folder.is_dir():
        pytest.skip(f"real data is absent: no folder {folder} (set CLRELIGHT_DATA)")
    return folder
