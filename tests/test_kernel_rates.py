import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import kernels
from clrelight.errors import InputError
from clrelight.speed.peak import copy_values, peak_run
from tests.styles import both_styles


@both_styles
@pytest.mark.parametrize(
    "count", [1, 511, 512, 513, 16383, 16384, 16385, 40009]
)  # about what one group or work-item takes
def test_a_copy_is_whole(device, count):
    values = np.random.default_rng(count).standard_normal(count).astype(np.float32)
    out_p = device.empty(values.shape, np.float32)
    copy_values(device, out_p, device.upload(values))
    np.testing.assert_array_equal(device.download(out_p), values)


@both_styles
def test_the_peak_kernel_does_all_its_steps(device, monkeypatch):
    monkeypatch.setattr("clrelight.speed.peak._STEPS", 64)
    held = {}
    empty = device.empty
    monkeypatch.setattr(device, "empty", lambda *size: held.setdefault("sums", empty(*size)))
    run, flops = peak_run(device)
    run()
    sums = device.download(held["sums"]).astype(np.float64)
    # x <- factor x + addend tends to addend / (1 - factor) = 1, from each chain's start.
    gpu = device.style == "gpu"
    starts = np.arange(16 if gpu else 12) + (1e-6 * np.arange(len(sums))[:, None] if gpu else 0.0)
    expected = (1.0 + 0.999**64 * (starts - 1.0)).sum(axis=1) if gpu else 2.0 * (1.0 + 0.999**64 * (starts - 1.0)).sum()
    np.testing.assert_allclose(sums, expected, rtol=1e-4)
    assert flops % (2 * 64 * len(sums)) == 0


@pytest.mark.parametrize("only", ["uint8, n = 9", "decode half"])
def test_shares_of_the_peaks(device, tmp_path, monkeypatch, only):
    monkeypatch.setattr("clrelight.speed.peak._STEPS", 64)
    monkeypatch.setattr("clrelight.speed.peak._COPIED_BYTES", 1 << 16)
    file = tmp_path / "kernels.json"
    arguments = ["--columns", "17", "--rounds", "1", "--only", only, "--json", str(file)]
    done = CliRunner().invoke(kernels.main, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    (row,) = json.loads(file.read_text())["kernels"]
    assert row["name"] in done.output
    assert 0 < row["bandwidth_share"] < math.inf
    assert (row["multiply_add_share"] is None) == ("half" in only)


def test_no_such_kernel(device):
    with pytest.raises(InputError, match="no kernel has 'warp' in its name"):
        CliRunner().invoke(kernels.main, ["--columns", "16", "--only", "warp"], catch_exceptions=False)
