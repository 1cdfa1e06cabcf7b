"""Codecs in parts: the bytes and values of coding in memory; bounded memory; nothing left behind."""

import json
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from clrelight.codec import (
    Encoded,
    codec_class,
    codec_ids,
    decode,
    decode_stream,
    encode,
    encode_stream,
    predict_noise,
    predict_noise_of,
)
from clrelight.codec.workspace import PARTS
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.index import degree_of
from clrelight.store import create_fit, open_fit, scratch, write_fit, write_stack
from clrelight.store.coding import PlanesTarget, RowTarget, StoredSource
from clrelight.store.scratch import ScratchBody, scratch_workspace
from tests.commands import ROOT, arrays, call, contents, environment, succeed
from tests.stacks import make_stack

SHAPES = [(9, 37, 13, 3), (4, 1, 53, 3), (16, 61, 1, 1), (9, 13, 17, 2)]
CODECS = {
    "half": {},
    "s3tc": {},
    "bc6h": {},
    "uniform": {"bits": 3},
    "wavelet": {"rate": 4.0},
    "jpeg2000": {"rate": 40.0},
    "vq": {"bits": 3},
    "cpca": {"clusters": 2, "components": 2},
    "klt": {"step": 0.05},
    "whitened": {"codec": "uniform", "options": {"bits": 7}},
    "principal": {"codec": "s3tc"},
}
OTHERS = [
    ("half", {"clamp": True}),
    ("wavelet", {"rate": 4.0, "allocation": "global"}),
    ("whitened", {"codec": "half"}),
    ("whitened", {"codec": "vq", "options": {"bits": 3}}),
    ("principal", {"codec": "wavelet", "options": {"rate": 9.0}}),
]


def make_map(shape, seed=3):
    noise = np.random.default_rng(seed).standard_normal(shape)
    smooth_khwc = np.cumsum(np.cumsum(noise, 1), 2).astype(np.float32) / 50
    return CoefficientMap(smooth_khwc, degree_of(shape[0]), "cls", 1.0, "linear", np.array([[0.0, 0.0, 1.0]]))


@contextmanager
def opened(tmp_path, shape, device):
    """Lend a map, and a source in a file of which a part holds four rows."""
    made = make_map(shape)
    write_fit(tmp_path / "fit.h5", made)
    rows_bytes = 4 * 4 * shape[0] * shape[2] * shape[3]
    with open_fit(tmp_path / "fit.h5") as fit, scratch_workspace(tmp_path, PARTS * rows_bytes) as workspace:
        yield made.coeffs_khwc, StoredSource(fit.coeffs_khwc, device, workspace)


def test_every_codec_is_tried():
    assert set(CODECS) == set(codec_ids())


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize(("name", "options"), [*CODECS.items(), *OTHERS], ids=str)
def test_parts_change_nothing(tmp_path, device, name, options, shape):
    codec = codec_class(name).from_config(options)
    with opened(tmp_path, shape, device) as (coeffs, source):
        expected = encode(coeffs, codec, device)
        noise, noise_there = predict_noise_of(source, codec), predict_noise(coeffs, codec, device)
        assert (noise is None) == (noise_there is None)
        if noise is not None:
            np.testing.assert_array_equal(noise.covariance_jj, noise_there.covariance_jj)
        body = ScratchBody(source.workspace)
        assert encode_stream(source, codec, body) == expected.info
        assert body[:] == expected.body
        there = Encoded(name, {}, shape, body)
        assert there.header() == expected.header()
        values, rows = decode(expected, device), []
        target = RowTarget(
            shape, device, source.workspace, lambda first, part: rows.append((first, part)), codec_id=name, row_step=3
        )
        decode_stream(there, target, device)
        np.testing.assert_array_equal(np.concatenate([part for _, part in rows], axis=1), values)
        assert [first for first, _ in rows] == [0, *np.cumsum([part.shape[1] for _, part in rows])[:-1]]
        kept = PlanesTarget(shape, device, source.workspace, codec_id=name)
        decode_stream(there, kept, device)
        np.testing.assert_array_equal(kept.planes.maps(0, shape[0]), values)


def test_parts_keep_to_the_room(tmp_path, device):
    shape = SHAPES[0]
    with opened(tmp_path, shape, device) as (_, source):
        workspace = source.workspace
        assert workspace.part_rows(shape, 1) == workspace.part_rows(shape, 4) == 4
        with source.rows(4) as parts:
            assert [(first, rows.shape[1]) for first, rows in parts] == [(r, min(4, 37 - r)) for r in range(0, 37, 4)]
        assert [part.stop - part.start for part in source.map_parts()] == [1] * 9


@pytest.mark.parametrize("name", ["half", "s3tc", "uniform", "wavelet"])
def test_a_row_that_is_no_part_is_refused(tmp_path, device, name):
    write_fit(tmp_path / "fit.h5", make_map(SHAPES[0]))
    with open_fit(tmp_path / "fit.h5") as fit, scratch_workspace(tmp_path, 1000) as workspace:
        source = StoredSource(fit.coeffs_khwc, device, workspace)
        with pytest.raises(InputError, match="memory budget"):
            encode_stream(source, codec_class(name)(), ScratchBody(workspace))


@pytest.mark.parametrize("name", ["half", "bc6h"])
def test_a_coefficient_that_overflows_is_named_by_its_own_row(tmp_path, device, name):
    made = make_map(SHAPES[0])
    made.coeffs_khwc[2, 30, 5, 1] = 70000.0
    write_fit(tmp_path / "fit.h5", made)
    with open_fit(tmp_path / "fit.h5") as fit, scratch_workspace(tmp_path, 30000) as workspace:
        source = StoredSource(fit.coeffs_khwc, device, workspace)
        with pytest.raises(InputError, match=r"\(2, 30, 5, 1\) is 70000"):
            encode_stream(source, codec_class(name)(), ScratchBody(workspace))


@pytest.mark.parametrize("name", ["half", "bc6h"])
def test_a_map_that_vanishes_is_refused(tmp_path, device, name):
    made = make_map(SHAPES[0])
    write_fit(tmp_path / "fit.h5", replace(made, coeffs_khwc=made.coeffs_khwc * np.float32(1e-12)))
    with open_fit(tmp_path / "fit.h5") as fit, scratch_workspace(tmp_path, 30000) as workspace:
        source = StoredSource(fit.coeffs_khwc, device, workspace)
        with pytest.raises(InputError, match="all would be 0"):
            encode_stream(source, codec_class(name)(), ScratchBody(workspace))


@pytest.mark.parametrize("name", ["half", "jpeg2000", "whitened"])
def test_a_coefficient_that_is_not_finite_is_named(tmp_path, device, name):
    made = make_map(SHAPES[0])
    made.coeffs_khwc[8, 35, 5, 1] = np.nan
    write_fit(tmp_path / "fit.h5", made)
    with open_fit(tmp_path / "fit.h5") as fit, scratch_workspace(tmp_path, 30000) as workspace:
        source = StoredSource(fit.coeffs_khwc, device, workspace)
        with pytest.raises(InputError, match=r"\(8, 35, 5, 1\) is nan"):
            encode_stream(source, codec_class(name).from_config(CODECS[name]), ScratchBody(workspace))


def test_values_that_are_not_finite_are_not_handed_on(tmp_path, device):
    """Endpoints may be as large as float32 holds, sums of them larger."""
    blocks_gjb = np.zeros((4, 7, 1), np.uint32)
    blocks_gjb[:, :6] = np.float32(3e38).view(np.uint32)
    encoded = Encoded("whitened", {}, (4, 4, 4, 3), b"\x04s3tc" + blocks_gjb.tobytes())
    with scratch_workspace(tmp_path, 1 << 20) as workspace:
        kept = PlanesTarget(encoded.shape, device, workspace, codec_id="whitened")
        rows = RowTarget(
            encoded.shape, device, workspace, lambda first, part: pytest.fail("it came"), codec_id="whitened"
        )
        for target in (kept, rows):
            with pytest.raises(PayloadError, match="not finite: codec whitened"):
                decode_stream(encoded, target, device)


# The commands.


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    write_stack(folder / "stack.h5", make_stack(24, (67, 71, 3)))
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", "2", "--no-measure")
    return folder


ROW = 4 * 9 * 71 * 3
COMMANDS = ["half", "s3tc", "bc6h", "uniform", "jpeg2000", "half --basis whitened", "uniform --basis klt"]


@pytest.mark.parametrize("codec", COMMANDS)
def test_commands_give_the_same_files(files, tmp_path, codec):
    words = ["--codec", *codec.split(), "--json"]
    told = {}
    for name, memory in (("all", "1GiB"), ("parts", 4 * 5 * ROW)):
        limit = ["--memory", memory]
        encoded, decoded = tmp_path / f"{name}.enc.h5", tmp_path / f"{name}.fit.h5"
        told[name] = succeed("encode", files / "fit.h5", encoded, *words, *limit, "--stack", files / "stack.h5").json
        succeed("decode", encoded, decoded, *limit)
    left, right = (arrays(tmp_path / f"{name}.fit.h5") for name in ("all", "parts"))
    for name, values in left.items():
        np.testing.assert_array_equal(values, right[name])
    assert (tmp_path / "all.enc.h5").read_bytes() == (tmp_path / "parts.enc.h5").read_bytes()
    assert (tmp_path / "all.fit.h5").read_bytes() == (tmp_path / "parts.fit.h5").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        f"{name}.{kind}.h5" for name in ("all", "parts") for kind in ("enc", "fit")
    ]
    assert told["all"]["psnr"] == pytest.approx(told["parts"]["psnr"], abs=1e-6)
    assert told["all"]["coding_noise"] == pytest.approx(told["parts"]["coding_noise"], abs=1e-6)


REFUSED = [
    ("encode fit.h5 out.h5 --codec half --memory 4001", "more than the memory budget 4001"),
    ("encode fit.h5 out.h5 --codec s3tc --memory 60k", "4 rows"),
    ("encode fit.h5 out.h5 --codec klt --memory 200k", "encoding by klt takes"),
    ("encode fit.h5 out.h5 --codec wavelet --memory 200k", "encoding by wavelet takes"),
    (
        "encode fit.h5 out.h5 --codec vq --memory 200k",
        "the 0.191 MiB of --memory; give --memory 2MiB, or --codec half, s3tc",
    ),
    ("encode fit.h5 out.h5 --codec cpca --basis whitened --memory 200k", "by whitened takes"),
    ("encode fit.h5 out.h5 --codec vq --basis klt --memory 200k", "by principal takes"),
    ("encode fit.h5 out.h5 --target-psnr 20 --stack stack.h5 --memory 200k", "; give --memory 3MiB, or --rate"),
    ("encode fit.h5 out.h5 --codec half --memory none", "number of bytes"),
    ("decode half.h5 out.h5 --memory 4k", "memory budget"),
    ("decode klt.h5 out.h5 --memory 2k", "of --memory\n"),
    ("decode whitened.h5 out.h5 --memory 200k", "decoding whitened takes"),
]


@pytest.fixture(scope="module")
def coded(files):
    succeed("encode", files / "fit.h5", files / "half.h5", "--codec", "half")
    succeed("encode", files / "fit.h5", files / "klt.h5", "--codec", "klt", "--step", "0.1")
    succeed("encode", files / "fit.h5", files / "whitened.h5", "--codec", "vq", "--basis", "whitened", "--bits", "4")
    return files


@pytest.mark.parametrize(("words", "expected"), REFUSED)
def test_what_memory_does_not_hold_is_one_line(coded, monkeypatch, words, expected):
    monkeypatch.chdir(coded)
    (coded / "out.h5").write_bytes(b"an older file")
    before = contents(coded)
    ended = call(*words.split())
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
    assert expected in ended.err
    assert contents(coded) == before


def test_a_codec_that_takes_all_says_so_unless_a_budget_was_set(coded, monkeypatch, tmp_path):
    monkeypatch.setattr(codec_class("cpca"), "encoding_holds", 1e6)
    ended = call("encode", coded / "fit.h5", tmp_path / "o.h5", "--codec", "cpca")
    assert ended.code == 0
    assert "note: encoding by cpca takes" in ended.err
    assert "MiB at once" in ended.err


def test_a_full_disk_leaves_nothing(files, tmp_path, monkeypatch):
    monkeypatch.setattr(scratch.Part, "reserve", _refuse)
    ended = call("encode", files / "fit.h5", tmp_path / "o.h5", "--codec", "uniform", "--memory", 4 * 5 * ROW)
    assert ended.code == 2
    assert "the disk is full" in ended.err
    assert not list(tmp_path.iterdir())


def _refuse(part, n_bytes):
    raise OSError(28, "No space left on device")


def test_a_damaged_payload_leaves_nothing(coded, tmp_path):
    import h5py

    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes((coded / "half.h5").read_bytes())
    with h5py.File(damaged, "r+") as file:
        file["payload"][5000] ^= 1
    for memory in ("1GiB", 4 * 5 * ROW):
        ended = call("decode", damaged, tmp_path / "o.h5", "--memory", memory)
        assert ended.code == 2
        assert "checksum" in ended.err
        assert [path.name for path in tmp_path.iterdir()] == ["damaged.h5"]


PEAK = """
import contextlib, io, json, sys
from clrelight.cli.app import run
from clrelight.jobs.memory import peak_memory
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()):
        assert run(words) == 0
print(peak_memory())
"""


def peak_of(*commands):
    """Return the most memory that a process had resident which ran commands."""
    words = json.dumps([[str(word) for word in words] for words in commands])
    command = [sys.executable, "-c", PEAK, words]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=True)
    return int(done.stdout)


def test_memory_does_not_grow_with_the_height(tmp_path, device):
    rows = np.random.default_rng(0).standard_normal((16, 64, 256, 3)).astype(np.float32)
    peaks = {}
    for height in (2048, 64, 2048):  # the first builds the kernels, which takes memory of its own
        record = replace(FitRecord.of(make_map((16, 1, 1, 1))), method="cls", name="tall")
        path = tmp_path / f"{height}.h5"
        with create_fit(path, record, (height, 256, 3)) as sink:
            for first in range(0, height, 64):
                sink.write_rows(first, rows, None, None)
        coded, limit = tmp_path / "coded.h5", ["--memory", "8MiB"]
        peaks[height] = peak_of(
            ["encode", path, coded, "--codec", "s3tc", *limit], ["decode", coded, tmp_path / "o.h5", *limit]
        )
    # The tall map takes 96 MiB.
    assert peaks[2048] - peaks[64] < 48 << 20


@pytest.mark.parametrize("words", ["encode fit.h5 {} --codec uniform", "decode half.h5 {}"])
def test_an_interrupt_leaves_nothing(coded, tmp_path, monkeypatch, words):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.chdir(coded)
    monkeypatch.setattr(scratch.Scratch, "read_into", interrupted)
    ended = call(*words.format(tmp_path / "o.h5").split(), "--memory", 4 * 5 * ROW)
    assert ended.code == 130
    assert not list(tmp_path.iterdir())
