from dataclasses import replace

import numpy as np
import pytest

from clrelight.device import Device
from clrelight.matmul import SampleCurve, apply_operator, pack_operator, pad_columns, row_blocks, tile_defines
from clrelight.matmul_gpu import choose_tiling
from clrelight.opencl import devices as device_module
from tests.reference import psnr
from tests.styles import both_styles, gpu_style

# Error of one float32 operation, and the most rows that are summed in one run.
UNIT = 2.0**-24
DEPTH = 64
# Tests have 17 rows where any number will do: GPUs get a program for each tiling, which takes a second to compile.

TABLE_ERROR, FORMULA_ERROR = UNIT, 3e-7
"""Of linear radiance: relative, and on [0, 1] absolute."""


def make_samples(rng, dtype, shape):
    if np.dtype(dtype).kind == "u":
        return rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    return rng.random(shape, np.float32).astype(dtype)


def apply(device, operator_mi, source_ip, *, columns=None, curve=None, weight_i=None):
    """Return the product and the energies, from memory that was full of NaN."""
    columns = columns or source_ip.shape[1]
    shape = (len(operator_mi), columns)
    out, energy = full_of_nan(device, shape), full_of_nan(device, shape[1:])
    extra = {} if weight_i is None else {"energy_q": energy, "weight_i": device.upload(weight_i)}
    packed = pack_operator(device, operator_mi)
    apply_operator(device, packed, device.upload(source_ip), out, curve=curve, **extra)
    return device.download(out), device.download(energy)


def full_of_nan(device, shape):
    values = np.full(shape, np.nan, np.float32)
    array = device.empty(shape, np.float32, values)
    if not device.shares_memory:
        device._cl.enqueue_copy(device._queue, array.buffer, values)
    return array


def additions(n_in):
    """Bound on the roundings that one term passes: its product, its run, the runs before and after."""
    return min(n_in, DEPTH) + -(-n_in // DEPTH) + 4


def check(device, operator_mi, source_ip, columns=None, curve=None, decoded_ip=None, sample_error=0.0):
    rng = np.random.default_rng(7)
    n_in = operator_mi.shape[1]
    weight_i = rng.random(n_in, np.float32)
    out, energy = apply(device, operator_mi, source_ip, columns=columns, curve=curve, weight_i=weight_i)
    exact_ip = (source_ip if decoded_ip is None else decoded_ip).astype(np.float64)
    p = exact_ip.shape[1]
    rounded_mi = operator_mi.astype(np.float32).astype(np.float64)
    size_mp = np.abs(rounded_mi) @ np.abs(exact_ip)
    error = np.abs(out[:, :p] - rounded_mi @ exact_ip)
    assert (error <= UNIT * additions(n_in) * size_mp + sample_error * np.abs(rounded_mi).sum(axis=1)[:, None]).all()
    square_p = weight_i.astype(np.float64) @ exact_ip**2
    slack_p = 2.0 * sample_error * (weight_i @ np.abs(exact_ip)) + n_in * sample_error**2
    assert (np.abs(energy[:p] - square_p) <= UNIT * (additions(n_in) + 2) * square_p + slack_p).all()
    assert (out[:, p:] == 0).all()
    assert (energy[p:] == 0).all()


def with_limits(device, **changed):
    """The same device, said to be smaller or wider than it is."""
    _, raw = device_module.loaded_devices()[device.info.index]
    return Device(replace(device.info, **changed), raw)


@both_styles
@pytest.mark.parametrize("n_in", [1, 2, 63, 64, 65, 255, 256, 257, 600])
def test_any_number_of_rows_in(device, n_in):
    rng = np.random.default_rng(n_in)
    check(device, rng.standard_normal((17, n_in)), make_samples(rng, np.float32, (n_in, 61)))


@pytest.mark.parametrize("n_out", [1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 16, 17, 49, 70])
def test_any_number_of_rows_out(device, n_out):
    rng = np.random.default_rng(n_out)
    check(device, rng.standard_normal((n_out, 70)), make_samples(rng, np.uint8, (70, 37)))


@gpu_style
@pytest.mark.parametrize("n_out", [1, 16, 17, 49, 131])  # one work-item's, one block, and more
def test_any_number_of_rows_out_on_a_gpu(device, n_out):
    rng = np.random.default_rng(n_out)
    check(device, rng.standard_normal((n_out, 37)), make_samples(rng, np.uint8, (37, 37)))


@pytest.mark.parametrize("offset", [-255, -1, 0, 1, 241])  # 1, tile - 1, tile, tile + 1 and a prime
@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_any_number_of_columns(device, offset, padded, dtype):
    rng = np.random.default_rng(1)
    columns = int(tile_defines(device)["TILE"]) + offset
    wanted = pad_columns(columns) if padded else columns
    check(device, rng.standard_normal((10, 66)), make_samples(rng, dtype, (66, columns)), columns=wanted)


@gpu_style
@pytest.mark.parametrize("columns", [1, 127, 128, 129, 255, 256, 257, 397])  # the widths of the tiles of either kernel
@pytest.mark.parametrize("n_out", [5, 17])
def test_any_number_of_columns_on_a_gpu(device, n_out, columns):
    rng = np.random.default_rng(columns)
    operator, source = rng.standard_normal((n_out, 66)), make_samples(rng, "uint8", (66, columns))
    check(device, operator, source, columns=pad_columns(columns))


@both_styles
@pytest.mark.parametrize("dtype", ["float16", "float32"])
@pytest.mark.parametrize("n_in", [1, 7, 8, 9, 49, 257])
@pytest.mark.parametrize("n_out", [1, 2, 3, 4])
def test_few_rows_as_in_relighting_by_one_light(device, n_in, n_out, dtype):
    rng = np.random.default_rng(n_in)
    operator, source = rng.standard_normal((n_out, n_in)), make_samples(rng, dtype, (n_in, 2048 + 2049))
    exact = operator.astype(np.float32).astype(np.float64)
    whole, _ = apply(device, operator, source)
    allowed = UNIT * additions(n_in) * (np.abs(exact) @ source.astype(np.float64))
    assert (np.abs(whole - exact @ source.astype(np.float64)) <= allowed).all()
    for columns in (
        1,
        15,
        16,
        17,
        1023,
        1025,
        1360,
        1361,
        2047,
        2048,
        2049,
        2071,
    ):  # about a vector's width, and a tile's
        part = np.ascontiguousarray(source[:, :columns])
        out, _ = apply(device, operator, part, columns=pad_columns(columns))
        np.testing.assert_array_equal(out[:, :columns], whole[:, :columns])
        assert (out[:, columns:] == 0).all()


@both_styles
@pytest.mark.parametrize("columns", [3, 16, 300])
def test_fewer_columns_out_than_in(device, columns):
    rng = np.random.default_rng(2)
    operator, source = rng.standard_normal((5, 20)).astype(np.float32), make_samples(rng, np.float32, (20, 601))
    whole, _ = apply(device, operator, source)
    part, _ = apply(device, operator, source, columns=columns)
    np.testing.assert_array_equal(part, whole[:, :columns])


@both_styles
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
@pytest.mark.parametrize("columns", [5, 271])
def test_every_sample_type(device, dtype, columns):
    rng = np.random.default_rng(3)
    check(device, rng.standard_normal((17, 130)), make_samples(rng, dtype, (130, columns)))


@both_styles
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
@pytest.mark.parametrize("peak", [1.0, 200.0])
def test_srgb_samples(device, dtype, peak):
    rng = np.random.default_rng(4)
    source = make_samples(rng, dtype, (90, 271))
    if np.dtype(dtype).kind == "f":
        source = (source * peak).astype(dtype)
    else:
        peak = float(np.iinfo(dtype).max) if peak == 1.0 else peak * np.iinfo(dtype).max / 255.0
    decoded = psnr.decode(source.astype(np.float64) / peak)
    error = FORMULA_ERROR if np.dtype(dtype).kind == "f" else TABLE_ERROR * decoded.max()
    curve = SampleCurve(peak, "srgb")
    check(device, rng.standard_normal((6, 90)), source, curve=curve, decoded_ip=decoded, sample_error=error)
    assert curve.operator_scale() == 1.0


def test_srgb_formula_over_its_whole_range(device):
    values = np.concatenate([np.linspace(0, 1, 20001), np.linspace(0.04, 0.041, 500)]).astype(np.float32)
    out, _ = apply(device, np.ones((1, 1)), values[None], curve=SampleCurve(1.0, "srgb"))
    assert np.abs(out[0] - psnr.decode(values.astype(np.float64))).max() < FORMULA_ERROR


@pytest.mark.parametrize(
    "changed",
    [
        {"lanes": 4},
        {"lanes": 8},
        {"lanes": 16},
        {"lanes": 4, "local_memory_bytes": 49152},
        {"lanes": 16, "local_memory_bytes": 16384},
        {"lanes": 8, "kind": "gpu"},
    ],
)
def test_devices_of_every_width_and_memory(device, changed):
    other = with_limits(device, **changed)
    tile = tile_defines(other)
    assert tile["VECTOR"] == other.info.lanes
    assert other.info.local_memory_bytes >= 4 * int(tile["TILE"]) * (int(tile["CHUNK"]) + 8)
    rng = np.random.default_rng(5)
    operator, source = rng.standard_normal((49, 300)), make_samples(rng, np.float32, (300, 523))
    if other.shares_memory:
        check(other, operator, source)
    else:
        np.testing.assert_array_equal(
            apply(other, operator, source)[0], apply(with_limits(device, lanes=8), operator, source)[0]
        )


@both_styles
def test_columns_do_not_depend_on_their_neighbours(device):
    rng = np.random.default_rng(6)
    operator, source = rng.standard_normal((17, 300)), make_samples(rng, np.uint8, (300, 600))
    weight = np.ones(300, np.float32)
    whole, energy = apply(device, operator, source, weight_i=weight)
    for first, end in ((0, 1), (17, 290), (599, 600)):
        part = np.ascontiguousarray(source[:, first:end])
        out, part_energy = apply(device, operator, part, weight_i=weight)
        np.testing.assert_array_equal(out, whole[:, first:end])
        np.testing.assert_array_equal(part_energy, energy[first:end])


@both_styles
def test_shapes_that_do_not_fit(device):
    packed = pack_operator(device, np.ones((4, 5)))
    with pytest.raises(ValueError, match=r"operator \(4, 5\) does not map 6 rows to 4"):
        apply_operator(device, packed, device.empty((6, 8), np.float32), device.empty((4, 8), np.float32))
    source, out = device.empty((5, 8), np.float32), device.empty((4, 8), np.float32)
    with pytest.raises(TypeError, match="weight_i must be an array"):
        apply_operator(device, packed, source, out, energy_q=device.empty((8,), np.float32))
    with pytest.raises(ValueError, match="energy_q has 9 along q, but out_mq has 8"):
        apply_operator(device, packed, source, out, energy_q=device.empty((9,), np.float32), weight_i=source)


def test_row_blocks():
    for rows in range(1, 200):
        for widest in (6, 8):
            blocks = row_blocks(rows, widest)
            assert sum(blocks) == rows
            assert min(blocks) >= 1
            assert max(blocks) <= widest
            assert max(blocks) - min(blocks) <= 1
            assert len(blocks) == -(-rows // widest)
    assert [pad_columns(p) for p in (1, 15, 16, 17)] == [16, 16, 16, 32]
    assert [pad_columns(p) for p in (240, 241, 256, 257, 1 << 15)] == [240, 272, 272, 272, (1 << 15) + 16]


def test_tilings_hold_all_rows_in_one_group_s_reach():
    for rows in range(17, 1700):
        tiling = choose_tiling(rows)
        held = tiling.rows * tiling.threads_y
        assert tiling.blocks * held >= rows
        assert held <= 64
        assert 128 <= 32 * tiling.threads_y <= 256
        assert tiling.depth % tiling.threads_y == 0
        # Idle rows cost as much as others.
        assert held - -(-rows // tiling.blocks) <= 7
