"""Compressed ``.ptm`` files, lists of lights, and domes of relight."""

import json

import numpy as np
import pytest

import clrelight as cr
from clrelight.exchange.ptm import read_ptm
from clrelight.images import write_image
from clrelight.store import write_fit
from tests.commands import call, succeed
from tests.reference import openlime
from tests.test_exchange import LIGHTS, decibels, made_fit, shown_by_ours


def test_a_compressed_ptm_is_a_jpeg_a_plane(tmp_path):
    fit = made_fit(1)
    write_fit(tmp_path / "fit.h5", fit)
    told = succeed("export", tmp_path / "fit.h5", tmp_path / "x.ptm", "--quality", 95, "--json").json
    lines = (tmp_path / "x.ptm").read_bytes().split(b"\n", 14)
    assert lines[:4] == [b"PTM_1.2", b"PTM_FORMAT_JPEG_RGB", b"50", b"37"]
    scale, bias = (np.array(line.split(), float) for line in lines[4:6])
    planes, at = [], 0
    for size in map(int, lines[12].split()):
        planes.append(openlime.read_jpeg(lines[14][at : at + size])[::-1, :, 0])
        at += size
    assert (len(planes), at) == (18, len(lines[14]))
    u, v = LIGHTS[:, 0], LIGHTS[:, 1]
    terms = np.stack([u * u, v * v, u * v, u, v, np.ones(4)])
    codes = np.reshape(planes, (3, 6, 37, 50))
    values = (codes - bias[:, None, None]) * scale[:, None, None]
    found = np.clip(np.einsum("ti,cthw->ihwc", terms, values) / 255, 0, 1)
    assert decibels(found, shown_by_ours(fit)) > 30
    assert told["refit"] > 30
    np.testing.assert_allclose(read_ptm(tmp_path / "x.ptm").display_values(LIGHTS, 0, 37), found, atol=1e-4)


def jpeg_of(place, plane):
    write_image(place / "p.jpg", plane[..., None])
    return (place / "p.jpg").read_bytes()


def ptm_of(planes, transforms, references, order, extras):
    zeros = " ".join(9 * ["0"])
    lists = [transforms, references, order, [len(each) for each in planes], [len(each) for each in extras]]
    words = [" ".join(map(str, each)) for each in lists]
    head = ["PTM_1.2", "PTM_FORMAT_JPEG_LRGB", "8", "8", "1 1 1 1 1 1", "0 0 0 0 0 0", "90"]
    head += [words[0], zeros, zeros, words[2], words[1], words[3], words[4], ""]
    return "\n".join(head).encode() + b"".join(a + b for a, b in zip(planes, extras, strict=True))


def test_planes_are_predicted_and_corrected(tmp_path):
    flat = [jpeg_of(tmp_path, np.full((8, 8), value, np.uint8)) for value in (40, 128, 140, 128, 128, 128, 9, 9, 9)]
    # Plane 1 is 255 less plane 0, plane 2 is plane 1 and 12, whose first pixel of the lowest row is corrected.
    extras = [b"", b"", b"\0\0\0\0\x07", *6 * [b""]]
    content = ptm_of(flat, [0, 1, 0, 0, 0, 0, 0, 0, 0], [-1, 0, 1, *6 * [-1]], range(9), extras)
    (tmp_path / "x.ptm").write_bytes(content)
    codes = read_ptm(tmp_path / "x.ptm").codes_hwp[0:8]
    assert codes[..., 0].max() == 40
    assert (codes[..., 1] == 215).all()
    assert codes[7, 0, 2] == 7
    assert (codes[:7, :, 2] == 227).all()
    for bad in (
        ptm_of(flat, [2, *8 * [0]], 9 * [-1], range(9), 9 * [b""]),
        ptm_of(flat, 9 * [0], [5, *8 * [-1]], range(9), 9 * [b""]),
        ptm_of(flat, 9 * [0], 9 * [-1], 9 * [0], 9 * [b""]),
        ptm_of(flat, 9 * [0], 9 * [-1], range(9), [b"\0\0\1\0\7", *8 * [b""]]),
        content[:-40],
    ):
        (tmp_path / "bad.ptm").write_bytes(bad)
        with pytest.raises(cr.InputError):
            read_ptm(tmp_path / "bad.ptm")


def test_lights_and_domes(tmp_path):
    write_fit(tmp_path / "fit.h5", made_fit(1, 4, 5))
    succeed("export", tmp_path / "fit.h5", tmp_path / "a.lp", "--names", "img%02d.jpg")
    lines = (tmp_path / "a.lp").read_text().splitlines()
    assert lines[0] == "4"
    assert [line.split()[0] for line in lines[1:]] == [f"img{i:02}.jpg" for i in range(4)]
    np.testing.assert_allclose([[float(x) for x in line.split()[1:]] for line in lines[1:]], LIGHTS, atol=1e-8)
    lamps = [dict(zip("xyz", light, strict=True)) for light in LIGHTS.tolist()]
    images = [{"filename": f"{i}.jpg", "skip": i == 2} for i in range(4)]
    (tmp_path / "d.dome").write_text(json.dumps({"directions": lamps}))
    (tmp_path / "p.relight").write_text(json.dumps({"images": images, "dome": {"directions": lamps}}))
    succeed("export", tmp_path / "d.dome", tmp_path / "d.lp")
    assert len((tmp_path / "d.lp").read_text().splitlines()) == 5
    succeed("export", tmp_path / "p.relight", tmp_path / "p.lp")
    names = [line.split()[0] for line in (tmp_path / "p.lp").read_text().splitlines()[1:]]
    assert names == ["0.jpg", "1.jpg", "3.jpg"]
    for told in ({}, [], {"directions": [{"x": 1}]}, {"directions": [[1, 2, "z"]]}, {"directions": 5}):
        (tmp_path / "bad.dome").write_text(json.dumps(told))
        ended = call("export", tmp_path / "bad.dome", tmp_path / "b.lp")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
