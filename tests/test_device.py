import ctypes
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clrelight import kernel_source
from clrelight.device import Device, open_device
from clrelight.errors import DeviceError
from clrelight.kernel_source import read_kernel_source
from clrelight.opencl import devices as device_module
from clrelight.opencl import drivers
from clrelight.opencl.arguments import check_arguments
from clrelight.opencl.devices import DEVICE_VARIABLE, STYLE_VARIABLE, list_devices, style_of

KERNEL = """
__kernel void combine_kp(__global float *out_kp, __global const uchar *source_ip, __global const float8 *table_i,
                         const float scale, const int size_k, const uint size_p)
{
    const int p = get_global_id(0);
    for (int k = 0; k < size_k; k++) out_kp[k * (int)size_p + p] = scale * source_ip[p] + OFFSET;
}
"""


@pytest.fixture
def launch(tmp_path, monkeypatch, device):
    """Launch the kernel above with good arguments but for those given by name."""
    (tmp_path / "combine.cl").write_text(KERNEL)
    monkeypatch.setattr(kernel_source, "kernel_folder", lambda: tmp_path)
    read_kernel_source.cache_clear()
    good = {
        "out": device.empty((3, 5), np.float32),
        "source": device.upload(np.arange(10, dtype=np.uint8).reshape(2, 5)),
        "table": device.upload(np.zeros(2, np.float32)),
        "scale": 0.5,
        "size_k": 3,
        "size_p": 5,
    }

    def run(global_size=(5,), **changed):
        arguments = {**good, **changed}
        device.launch("combine.cl", "combine_kp", global_size, *arguments.values(), defines={"OFFSET": "1.0f"})
        return device.download(arguments["out"])

    yield run
    read_kernel_source.cache_clear()


def infos():
    """Three devices of a made-up machine."""
    cpu = replace(list_devices()[0], index=0, kind="cpu", name="Small CPU", packaged=False, default=False)
    return [
        replace(cpu, version="OpenCL 3.0 PoCL 5.0"),
        replace(cpu, index=1, version="OpenCL 3.0 PoCL 3.0", packaged=True),
        replace(cpu, index=2, version="OpenCL 3.0 CUDA", name="Big Card", kind="gpu", default=True),
    ]


@pytest.fixture
def without_devices(monkeypatch):
    def set_platforms(get_platforms):
        monkeypatch.setattr("pyopencl.get_platforms", get_platforms)
        device_module.loaded_devices.cache_clear()

    yield set_platforms
    device_module.loaded_devices.cache_clear()


def test_list():
    found = list_devices()
    assert [info.index for info in found] == list(range(len(found)))
    assert sum(info.default for info in found) == 1
    for info in found:
        assert info.kind in ("gpu", "cpu", "other")
        assert min(info.memory_bytes, info.compute_units, info.local_memory_bytes, info.vector_width) > 0
        assert info.name in info.label
        assert info.driver in info.label


def test_open_by_index_kind_and_name(monkeypatch):
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    for info in list_devices():
        assert replace(open_device(str(info.index)).info, default=info.default) == info
        assert open_device(info.name.upper()).info.name == info.name
        if info.kind != "other":
            assert open_device(info.kind).info.kind == info.kind
    assert [info.index for info in list_devices() if info.default] == [open_device().info.index]


@pytest.mark.parametrize(
    ("spec", "index"),
    [(None, 2), ("", 2), ("0", 0), (" 2 ", 2), ("gpu", 2), ("cpu", 1), ("pocl", 1), ("big card", 2), ("small", 0)],
)
def test_choice(spec, index):
    assert device_module._match(spec, infos()) == index


@pytest.mark.parametrize("spec", ["3", "fpga", "-1"])
def test_unknown_device_lists_what_there_is(spec):
    with pytest.raises(DeviceError, match=f"'{spec}'; there are 0: Small CPU; 1: Small CPU; 2: Big Card"):
        device_module._match(spec, infos())


def test_environment_variable(monkeypatch):
    monkeypatch.setenv(DEVICE_VARIABLE, "no such device")
    with pytest.raises(DeviceError, match=r"'no such device' \(CLRELIGHT_DEVICE\); there are 0: "):
        open_device()
    assert open_device("0").info.index == 0
    monkeypatch.setenv(DEVICE_VARIABLE, "0")
    assert open_device().info.index == 0


def test_kernels_go_by_the_kind_unless_forced(monkeypatch):
    monkeypatch.delenv(STYLE_VARIABLE, raising=False)
    assert [style_of(kind) for kind in ("cpu", "gpu", "other")] == ["cpu", "gpu", "cpu"]
    own = open_device()
    assert own.style == style_of(own.info.kind)
    assert "kernels" not in own.info.label
    other = open_device(style="cpu" if own.style == "gpu" else "gpu")
    assert other is not own
    assert other.info.label.endswith(f", {other.style} kernels)")
    assert not other.shares_memory
    monkeypatch.setenv(STYLE_VARIABLE, other.style)
    assert open_device() is other
    assert open_device(style=own.style) is own
    assert {info.style for info in list_devices()} == {other.style}


def test_unknown_kernels(monkeypatch):
    with pytest.raises(DeviceError, match=r"kernels \(CLRELIGHT_KERNELS\) must be cpu or gpu, got 'vector'"):
        open_device(style="vector")
    monkeypatch.setenv(STYLE_VARIABLE, "vector")
    with pytest.raises(DeviceError, match="got 'vector'"):
        open_device()
    with pytest.raises(DeviceError, match="got 'vector'"):
        list_devices()


def test_no_platform_says_how_to_install(without_devices):
    without_devices(list)
    assert list_devices() == []
    with pytest.raises(DeviceError, match=r"no OpenCL device found; .*pip install 'pyopencl\[pocl\]'"):
        open_device()


def test_no_loader_is_no_device(without_devices):
    import pyopencl as cl

    def refuse():
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    without_devices(refuse)
    with pytest.raises(DeviceError, match="no OpenCL device found"):
        open_device("cpu")


def test_a_broken_driver_does_not_hide_the_others(without_devices):
    import pyopencl as cl

    class Broken:
        def get_devices(self):
            raise cl.LogicError("clGetDeviceIDs failed: DEVICE_NOT_FOUND")

    platforms = cl.get_platforms()
    without_devices(lambda: [Broken(), *platforms])
    assert len(list_devices()) == sum(len(p.get_devices()) for p in platforms)


def test_one_device_object_per_thread():
    others = []
    thread = threading.Thread(target=lambda: others.append(open_device("0")))
    thread.start()
    thread.join()
    assert open_device("0") is open_device("0")
    assert others[0] is not open_device("0")


def test_launch(launch):
    np.testing.assert_array_equal(launch(), np.tile(np.arange(5) * 0.5 + 1, (3, 1)))


def test_launch_takes_numpy_scalars(launch):
    assert launch(scale=np.float64(2), size_k=np.int64(3), size_p=np.uint8(5))[0, 1] == 3


@pytest.mark.parametrize(
    ("dtype", "shape", "name", "error", "message"),
    [
        (np.float64, (3, 5), "out", TypeError, r"out_kp is float\*, which takes float32, got float64"),
        (np.int8, (2, 5), "source", TypeError, r"source_ip is uchar\*, which takes uint8, got int8"),
        (np.float32, (15,), "out", ValueError, r"out_kp has 2 axes by its name, got shape \(15,\)"),
        (np.uint8, (2, 6), "source", ValueError, "source_ip has 6 along p, but out_kp has 5"),
        (np.float32, (3,), "table", ValueError, "table_i has 3 along i, but source_ip has 2"),
    ],
)
def test_launch_refuses_arrays(device, launch, dtype, shape, name, error, message):
    with pytest.raises(error, match="combine.cl:combine_kp: " + message):
        launch(**{name: device.empty(shape, dtype)})


@pytest.mark.parametrize(
    ("name", "value", "error", "message"),
    [
        ("out", np.zeros((3, 5), np.float32), TypeError, "out_kp must be an array on the device, got ndarray"),
        ("source", None, TypeError, "source_ip must be an array on the device, got NoneType"),
        ("scale", np.zeros(2), TypeError, "scale must be one float, got ndarray"),
        ("size_k", 4, ValueError, "size_k is 4, but out_kp has 3 along k"),
        ("size_p", 6, ValueError, "size_p is 6, but out_kp has 5 along p"),
        ("size_k", 3.5, TypeError, "size_k must be a whole number, got 3.5"),
        ("size_k", 2**40, OverflowError, "out of bounds"),
        ("size_p", -5, OverflowError, "out of bounds"),
    ],
)
def test_launch_refuses_values(launch, name, value, error, message):
    with pytest.raises(error, match=message):
        launch(**{name: value})


def test_launch_refuses_an_array_for_a_scalar(device, launch):
    with pytest.raises(TypeError, match="scale must be one float, got DeviceArray"):
        launch(scale=device.empty((1,), np.float32))


def test_launch_refuses_a_wrong_count(device, launch):
    launch()
    with pytest.raises(TypeError, match=r"takes 6 arguments \(out_kp, source_ip, table_i, .*\), got 1"):
        device.launch("combine.cl", "combine_kp", (5,), 1.0, defines={"OFFSET": "1.0f"})


def test_launch_refuses_an_empty_range(launch):
    with pytest.raises(ValueError, match="global size must be positive"):
        launch(global_size=(0,))


def test_half_samples_may_be_read_as_ushort_or_half(device):
    array = device.upload(np.zeros(3, np.float16))
    for element in ("half", "ushort"):
        assert check_arguments("k", [(f"{element}*", "a_p")], (array,)) == [array]
    with pytest.raises(TypeError, match="got float16"):
        check_arguments("k", [("short*", "a_p")], (array,))


def test_upload_and_download_round_trip(device):
    for dtype in ("uint8", "int16", "float16", "float32", "float64"):
        values = np.arange(7).astype(dtype)
        np.testing.assert_array_equal(device.download(device.upload(values)), values)


def test_upload_refuses_what_kernels_cannot_read(device):
    with pytest.raises(ValueError, match="C-contiguous"):
        device.upload(np.zeros((4, 4), np.float32).T[1:])
    with pytest.raises(ValueError, match=r"cannot be empty, got shape \(0, 3\)"):
        device.upload(np.zeros((0, 3), np.float32))
    with pytest.raises(ValueError, match=r"cannot be empty, got shape \(2, 0\)"):
        device.empty((2, 0), np.float32)


def test_a_cpu_writes_into_the_given_host_array(device):
    if not device.shares_memory:
        pytest.skip("this device has memory of its own")
    host = np.zeros((2, 3), np.float32)
    assert device.download(device.empty((2, 3), np.float32, host)) is host
    for wrong in (np.zeros((3, 2), np.float32), np.zeros((2, 3)), np.zeros((3, 2), np.float32).T):
        with pytest.raises(ValueError, match="expected a C-contiguous float32 host array"):
            device.empty((2, 3), np.float32, wrong)


@pytest.mark.parametrize("changed", [{"kind": "gpu"}, {"style": "gpu"}])
def test_a_device_with_its_own_memory_copies(changed):
    _, raw = device_module.loaded_devices()[open_device().info.index]
    apart = Device(replace(open_device().info, **changed), raw)
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    on_device = apart.upload(values)
    values[:] = -1
    np.testing.assert_array_equal(apart.download(on_device), np.arange(6).reshape(2, 3))


@pytest.mark.skipif(not drivers.packaged_version(), reason="the Python package's PoCL is not installed")
def test_the_packaged_driver_is_told_by_its_library():
    """A system's PoCL may have the version of the Python package's."""
    import pyopencl as cl

    version = f"OpenCL 3.0 PoCL {drivers.packaged_version()}"
    platform = next(each for each in cl.get_platforms() if drivers.packaged_version() in each.version)
    assert drivers.library_of(platform.int_ptr).is_relative_to(Path(cl.__file__).parent)
    assert drivers.is_packaged(version, platform.int_ptr)
    elsewhere = ctypes.cast(ctypes.CDLL(None).malloc, ctypes.c_void_p).value
    assert not drivers.library_of(elsewhere).is_relative_to(Path(cl.__file__).parent)
    assert not drivers.is_packaged(version, elsewhere)
    assert not drivers.is_packaged("OpenCL 3.0 PoCL 1.8", platform.int_ptr)
    heap = ctypes.create_string_buffer(64)
    assert drivers.library_of(ctypes.addressof(heap)) is None
    assert drivers.is_packaged(version, ctypes.addressof(heap))  # by its version alone, as where nobody tells
