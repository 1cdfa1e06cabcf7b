"""Compiled kernels between runs, damaged in every way, with real processes."""

import json
import os
import random
import re
import resource
import subprocess
import sys

import numpy as np
import pytest

from clrelight.codec import codec_class, encode
from clrelight.device import make_device, open_device
from clrelight.errors import DeviceError
from clrelight.kernel_source import kernel_folder, read_kernel_source
from clrelight.opencl import archives, folder, kernel_cache

JOB = """
import json
import numpy as np
from clrelight.device import open_device
device = open_device("@8")
values = np.arange(96, dtype=np.float32)
for each in (4, 8):  # two programs
    copy, defines = device.empty(values.shape, np.float32), {"EACH": each, "STRIDE": 1}
    device.launch("speed/copy.cl", "copy_p", (96 // each,), copy, device.upload(values), 96, defines=defines)
    values = device.download(copy).copy()
print(json.dumps(values.sum().item()))
"""


@pytest.fixture
def run(tmp_path):
    """Run a job in a process whose cache is a folder of the test."""
    place = tmp_path / "cache"

    def job(**variables):
        environment = {k: v for k, v in os.environ.items() if k != kernel_cache.POCL_VARIABLE}
        environment |= {folder.CACHE_VARIABLE: str(place), **variables}
        ended = subprocess.run(
            [sys.executable, "-c", JOB], capture_output=True, text=True, env=environment, timeout=120
        )
        assert ended.returncode == 0, ended.stderr
        assert json.loads(ended.stdout) == 96 * 95 / 2
        return ended.stderr.splitlines()

    job.place = place
    job.kept = lambda: sorted(place.glob("kernels/*/*.kernels"))
    return job


def pocl_only():
    if "PoCL" not in open_device().info.version:
        pytest.skip("only PoCL leaves kernels in files")


def test_kernels_are_kept_and_found_again(run):
    pocl_only()
    assert run() == []
    kept = {path: (path.read_bytes(), path.stat().st_ino) for path in run.kept()}
    assert len(kept) == 2
    assert run() == []
    # Nothing was compiled, so nothing was written, not even the same once more.
    assert {path: (path.read_bytes(), path.stat().st_ino) for path in run.kept()} == kept
    assert list((run.place / "run").iterdir()) == []


def test_kernels_of_bitcode_are_those_of_the_source(monkeypatch):
    """Of which no other program's may be taken: their names are their own."""
    opened = open_device()
    if not opened._cache._by_bitcode:
        pytest.skip("this driver's programs are built of their source")
    values = np.random.default_rng(0).standard_normal((4, 3, 5, 3)).astype(np.float32)
    found = []
    for by_bitcode in (True, True, False):
        if len(found) == 1:
            monkeypatch.setattr(kernel_cache.KernelCache, "compiling", None)  # a second time nobody compiles
        device = make_device(f"{opened.info.index}@{opened.info.lanes}", style="cpu")
        if not by_bitcode:
            monkeypatch.undo()
            monkeypatch.setattr(device._cache, "_by_bitcode", False)
        found.append([encode(values, codec_class(name)(), device).to_bytes() for name in ("half", "uniform")])
        names = {kernel.function_name for kernel, _ in device._kernels.values()}
        assert len(names) == len(device._kernels)
        built = {name[:16] for _, name in device._programs.values()}
        assert all(name.rpartition("_")[2] in built for name in names) == by_bitcode
    assert found[0] == found[1] == found[2]


def test_kernels_are_found_in_every_source():
    for path in kernel_folder().rglob("*.cl"):
        source = read_kernel_source(path.relative_to(kernel_folder()).as_posix())
        code = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
        found = kernel_cache._KERNEL.findall(code)
        assert len(found) == len(re.findall(r"\b(?:__)?kernel\b", code)), path
        assert set(found) <= set(kernel_cache._KERNEL.findall(source)), path


def test_damage_is_told_and_mended(run):
    pocl_only()
    run()
    rng = random.Random(0)
    kept = {path: path.read_bytes() for path in run.kept()}
    for damage in range(4):
        for path, whole in kept.items():
            at = rng.randrange(len(whole))
            damages = [whole[:at] + rng.randbytes(300) + whole[at + 300 :], b"", whole[:at], whole + b"x"]
            path.write_bytes(damages[damage])
        told = [f"clrelight: {path}: damaged: its kernels are compiled anew" for path in kept]
        assert sorted(run()) == told
        for path in kept:
            content = path.read_bytes()
            assert archives.holds_whole(path, content)
    assert run() == []


def test_an_archive_of_another_program_or_driver_is_not_taken(tmp_path, monkeypatch):
    """Its kernels would be wrong, or not be there."""
    monkeypatch.setenv(folder.CACHE_VARIABLE, str(tmp_path))
    folder.cache_folder.cache_clear()
    monkeypatch.setattr(kernel_cache, "_run_folder", tmp_path / "run" / "1")
    (tmp_path / "run" / "1" / "AB" / "C").mkdir(parents=True)
    (tmp_path / "run" / "1" / "AB" / "C" / "program.bc").write_bytes(b"x")
    said = []
    monkeypatch.setattr(kernel_cache, "_say_once", said.append)
    cache, other = kernel_cache.KernelCache("a driver"), kernel_cache.KernelCache("another")
    cache._programs["p"] = {"AB/C"}
    cache.seal({"p"})
    monkeypatch.setattr(kernel_cache, "_run_folder", tmp_path / "run" / "2")
    other._folder.mkdir()
    for taken in (cache._path("q"), other._path("p")):
        taken.write_bytes(cache._path("p").read_bytes())
    assert [each._unpack(name) for each, name in ((cache, "q"), (other, "p"))] == [set(), set()]
    assert len(said) == 2
    assert not (tmp_path / "run" / "2").exists()
    assert cache._unpack("p") == {"AB/C"}
    folder.cache_folder.cache_clear()


@pytest.mark.parametrize("bitcode", [b"", b"of no driver" * 99])
def test_bitcode_that_the_driver_does_not_take_is_made_anew(monkeypatch, bitcode):
    opened = open_device()
    if not opened._cache._by_bitcode:
        pytest.skip("this driver's programs are built of their source")
    device = make_device(f"{opened.info.index}@{opened.info.lanes}", style="cpu")
    kept, forget, forgotten = device._cache.bitcode, device._cache.forget, []
    monkeypatch.setattr(device._cache, "bitcode", lambda name: kept(name) if name in forgotten else bitcode)
    monkeypatch.setattr(device._cache, "forget", lambda name: (forgotten.append(name), forget(name)))
    values = np.linspace(-1.0, 1.0, 48, dtype=np.float32).reshape(4, 2, 2, 3)
    found = encode(values, codec_class("half")(), device).to_bytes()
    assert forgotten
    assert found == encode(values, codec_class("half")(), opened).to_bytes()


def test_a_whole_disk_of_damage_in_what_the_driver_left(run):
    """Folders of a run that was killed are nobody's: the next one takes its own."""
    pocl_only()
    left = run.place / "run" / "123-killed" / "AB" / "CDEF"
    left.mkdir(parents=True)
    (left / "program.bc").write_bytes(b"x" * 1000)
    assert run() == []


def test_a_folder_that_cannot_be_made(run):
    lines = run(**{folder.CACHE_VARIABLE: "/proc/nothing"})
    assert len(lines) == 1
    assert "/proc/nothing" in lines[0]
    assert "compiled anew" in lines[0]


def test_a_folder_that_is_a_file(run, tmp_path):
    (tmp_path / "file").write_text("")
    (line,) = run(**{folder.CACHE_VARIABLE: str(tmp_path / "file")})
    assert "compiled anew" in line


def test_a_full_disk_costs_the_archive(run, monkeypatch, tmp_path):
    pocl_only()
    monkeypatch.setenv(folder.CACHE_VARIABLE, str(tmp_path / "full"))
    folder.cache_folder.cache_clear()
    monkeypatch.setattr(kernel_cache, "_run_folder", tmp_path / "running")
    (tmp_path / "running" / "AB" / "C").mkdir(parents=True)
    (tmp_path / "running" / "AB" / "C" / "program.bc").write_bytes(b"x")
    cache = kernel_cache.KernelCache("a driver")
    cache._programs["p"] = {"AB/C"}

    def full(path, content):
        raise OSError(28, "No space left on device")

    said = []
    monkeypatch.setattr(archives, "write_whole", full)
    monkeypatch.setattr(kernel_cache, "_say_once", said.append)
    cache.seal({"p"})
    assert len(said) == 1
    assert "No space left on device" in said[0]
    folder.cache_folder.cache_clear()


def test_where_compiled_files_would_not_fit(monkeypatch):
    """Else LLVM ends the process."""
    monkeypatch.setattr(kernel_cache, "_has_room", lambda folder: False)
    with pytest.raises(DeviceError, match="there is no such room in"):
        kernel_cache._make_run_folder()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 19, before[1]))
    try:
        with pytest.raises(DeviceError, match="may have 524288 bytes: raise ulimit -f"):
            kernel_cache._make_run_folder()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_folder_that_the_user_named_is_left_to_him(run, tmp_path):
    pocl_only()
    assert run(**{kernel_cache.POCL_VARIABLE: str(tmp_path / "own")}) == []
    assert run.kept() == []
    assert list((tmp_path / "own").rglob("program.bc"))


def test_the_oldest_archives_go(tmp_path, monkeypatch):
    monkeypatch.setenv(folder.CACHE_VARIABLE, str(tmp_path))
    folder.cache_folder.cache_clear()
    monkeypatch.setattr(kernel_cache, "_run_folder", tmp_path / "run" / "1")
    monkeypatch.setattr(kernel_cache, "MOST_BYTES", 2500)
    for name in "abc":
        for i in range(3):
            file = tmp_path / "run" / "1" / "AB" / name / f"{i}.so"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(random.Random(name).randbytes(300))
    cache = kernel_cache.KernelCache("a driver")
    cache._programs.update({name: {f"AB/{name}"} for name in "abc"})
    for age, name in enumerate("abc"):
        cache.seal({name})
        os.utime(cache._path(name), (age, age))
    assert [path.stem for path in sorted(cache._folder.iterdir())] == ["b", "c"]
    folder.cache_folder.cache_clear()


@pytest.mark.parametrize("when", ["before they are measured", "after"])
def test_two_may_prune_at_once(tmp_path, monkeypatch, when):
    monkeypatch.setenv(folder.CACHE_VARIABLE, str(tmp_path))
    folder.cache_folder.cache_clear()
    monkeypatch.setattr(kernel_cache, "_run_folder", tmp_path / "run" / "1")
    monkeypatch.setattr(kernel_cache, "MOST_BYTES", 400)
    cache = kernel_cache.KernelCache("a driver")
    cache._folder.mkdir(parents=True)
    paths = [cache._folder / f"{name}.kernels" for name in "abc"]
    for path in paths:
        path.write_bytes(bytes(300))
    entries = list(os.scandir(cache._folder))
    if when == "after":
        for entry in entries:
            entry.stat()  # kept by the entry
    paths[0].unlink()  # by the other one
    monkeypatch.setattr(kernel_cache, "_archives", lambda parent: iter(entries))
    cache._prune()
    assert sum(path.exists() for path in paths) == 1
    folder.cache_folder.cache_clear()


def test_concurrent_runs_do_not_meet(run):
    pocl_only()
    environment = {**os.environ, folder.CACHE_VARIABLE: str(run.place)}
    jobs = [subprocess.Popen([sys.executable, "-c", JOB], env=environment, stderr=subprocess.PIPE) for _ in range(3)]
    assert [(job.communicate()[1], job.returncode) for job in jobs] == [(b"", 0)] * 3


def test_pyopencl_needs_no_folder_of_the_user(run, tmp_path):
    """Nor reads the database that it may have left there."""
    (tmp_path / "file").write_text("")
    assert run(XDG_CACHE_HOME=str(tmp_path / "file" / "none")) == []
    import pyopencl.invoker

    kept = getattr(pyopencl.invoker, "invoker_cache", None)
    assert kept is None, "opened without its cache by the tests' process too"
    (tmp_path / "xdg" / "pytools").mkdir(parents=True)
    name = f"pdict-v5-pyopencl-invoker-cache-v42-nano-{'.'.join(map(str, sys.version_info))}.sqlite"
    (tmp_path / "xdg" / "pytools" / name).write_bytes(b"damaged" * 999)
    assert run(XDG_CACHE_HOME=str(tmp_path / "xdg")) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a full device is Linux's")
def test_a_kernel_that_does_not_build_tells_why_and_of_a_full_folder(monkeypatch, tmp_path, device):
    from clrelight.opencl import child

    def refuse(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(child.tempfile, "TemporaryFile", refuse)
    told = r"half.cl does not build \(temporary files cannot be written: No space left.*\): error: .*VECTORS must be"
    with pytest.raises(DeviceError, match=told):
        device._program("codec/half.cl", {"NONE": "such"})
