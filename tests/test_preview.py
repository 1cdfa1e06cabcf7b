"""Pictures of files: as images, and within encodings, whose bytes stay what they were."""

import h5py
import numpy as np
import pytest

import clrelight as cr
from clrelight.conventions import linear_to_srgb
from clrelight.images import read_image, write_image
from clrelight.jobs.thumbnail import LIGHT, thumbnail
from clrelight.sampling import make_pattern
from tests.commands import call, contents, succeed
from tests.test_store_nexus import default_group, make_fit, make_stack, signal_of, text


@pytest.fixture(scope="module")
def encoded(tmp_path_factory):
    place = tmp_path_factory.mktemp("preview")
    for channels in (1, 3):
        cr.write_fit(place / f"fit{channels}.h5", make_fit(channels))
        succeed("encode", place / f"fit{channels}.h5", place / f"enc{channels}.h5", "--codec", "half")
    return place


@pytest.mark.parametrize("channels", [1, 3])
def test_a_copy_of_an_encoding_opens_on_its_picture(channels, encoded, tmp_path):
    source, copy = encoded / f"enc{channels}.h5", tmp_path / "shown.h5"
    told = succeed("preview", source, copy, "--json").json
    assert told["size"] == [7, 5]
    assert told["bytes_on_disk"] == copy.stat().st_size
    expected = thumbnail(source)
    with h5py.File(copy) as file, h5py.File(source) as before:
        signal = signal_of(default_group(file))
        assert text(signal.attrs["interpretation"]) == ("rgb-image" if channels == 3 else "image")
        np.testing.assert_array_equal(signal[...].reshape(5, 7, channels), expected)
        np.testing.assert_array_equal(file["payload"][...], before["payload"][...])
        assert file.attrs["record"].tobytes() == before.attrs["record"].tobytes()
        assert "default" not in before.attrs
    one, other = (cr.read_encoded(path) for path in (source, copy))
    assert one[0].to_bytes() == other[0].to_bytes()
    np.testing.assert_array_equal(one[1].directions_i3, other[1].directions_i3)
    np.testing.assert_array_equal(cr.decode(copy).coeffs_khwc, cr.decode(source).coeffs_khwc)
    cr.preview(source, tmp_path / "again.h5")
    assert (tmp_path / "again.h5").read_bytes() == copy.read_bytes()


@pytest.mark.parametrize("kind", ["stack", "fit"])
def test_a_picture_of_any_file_becomes_an_image(kind, encoded, tmp_path):
    source = tmp_path / "s.h5" if kind == "stack" else encoded / "fit3.h5"
    if kind == "stack":
        cr.write_stack(source, make_stack(3))
    report = cr.preview(source, tmp_path / "p.png", size=4)
    assert report.facts["size"] == [4, 3]
    np.testing.assert_array_equal(read_image(tmp_path / "p.png"), thumbnail(source, 4))


def test_what_makes_no_sense_is_refused_and_nothing_written(encoded, tmp_path):
    before = contents(encoded)
    for source, out, words in (
        (encoded / "fit3.h5", tmp_path / "copy.h5", "is for encodings"),
        (encoded / "enc3.h5", encoded / "enc3.h5", "input"),
        (encoded / "none.h5", tmp_path / "p.png", "none.h5"),
        (encoded / "enc3.h5", tmp_path / "p.xyz", "p.xyz"),
    ):
        ended = call("preview", source, out)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert words in ended.err
    assert contents(encoded) == before
    assert list(tmp_path.iterdir()) == []


def test_a_list_of_vertices_has_no_picture(tmp_path):
    fitted = make_fit(1)
    line = cr.CoefficientMap(
        fitted.coeffs_khwc.reshape(4, 35, 1, 1),
        degree=1,
        method="uls",
        peak=1.0,
        transfer="linear",
        directions_i3=fitted.directions_i3,
    )
    cr.write_fit(tmp_path / "f.h5", line)
    assert thumbnail(tmp_path / "f.h5") is None
    assert "holds no picture" in call("preview", tmp_path / "f.h5", tmp_path / "p.png").err


def photographs(place):
    """Write eight photographs with their lights."""
    place.mkdir()
    values = np.random.default_rng(3).integers(20, 230, (8, 24, 32, 3), dtype=np.uint8)
    directions = make_pattern("uniform", 8)
    for index, image in enumerate(values):
        write_image(place / f"{index}.png", image)
    lines = [f"{index}.png {x} {y} {z}" for index, (x, y, z) in enumerate(directions)]
    (place / "dome.lp").write_text("\n".join(["8", *lines]))
    return place


@pytest.mark.parametrize("words", [["--codec", "half"], ["--rate", "8"], ["--bytes", "3000"]])
def test_encode_writes_the_picture_of_its_file_beside_it(words, encoded, tmp_path):
    out, picture = tmp_path / "e.h5", tmp_path / "e.png"
    told = succeed("encode", encoded / "fit3.h5", out, *words, "--preview", picture, "--json").json
    assert told["preview"] == {"file": str(picture), "size": [7, 5]}
    np.testing.assert_array_equal(read_image(picture), thumbnail(out))


def test_a_large_map_by_a_codec_without_levels_is_shown_as_it_went_in(encoded, tmp_path, monkeypatch):
    monkeypatch.setattr("clrelight.jobs.thumbnail._MOST_VALUES", 100)
    ended = call("encode", encoded / "fit3.h5", tmp_path / "e.h5", "--codec", "vq", "--preview", tmp_path / "e.png")
    assert ended.code == 0
    assert "shows the fit before it was coded" in ended.err
    np.testing.assert_array_equal(read_image(tmp_path / "e.png"), thumbnail(encoded / "fit3.h5"))


def test_a_fit_of_another_basis_is_shown_by_its_own_functions(tmp_path):
    stack = make_stack(3)
    fitted = cr.fit(stack, "uls", 1, basis="hsh")
    cr.write_fit(tmp_path / "f.h5", fitted)
    expected = 255 * linear_to_srgb(np.clip(cr.relight(fitted, LIGHT), 0, 1))
    np.testing.assert_allclose(thumbnail(tmp_path / "f.h5"), expected, atol=1.0)


def test_pack_writes_the_picture_of_its_file_beside_it(tmp_path):
    folder = photographs(tmp_path / "photos")
    out, picture = tmp_path / "v.h5", tmp_path / "v.jpg"
    ended = succeed("pack", folder, out, "--method", "uls", "--degree", "1", "--preview", picture)
    assert f"preview  {picture}, 32×24" in " ".join(ended.out.split("\n")).replace("   ", "  ")
    expected = thumbnail(out).astype(float)
    assert np.abs(read_image(picture) - expected).mean() < 12  # JPEG's


def test_a_map_of_many_coefficients_is_shown_too(tmp_path, monkeypatch):
    """`pack` and `preview` decode however long it takes; where nobody asked, a smaller picture stands for it."""
    monkeypatch.setattr("clrelight.jobs.thumbnail._MOST_VALUES", 100)
    out, picture = tmp_path / "v.h5", tmp_path / "v.png"
    words = ("--method", "uls", "--degree", "1", "--preview", picture)
    assert succeed("pack", photographs(tmp_path / "photos"), out, *words).code == 0
    expected = thumbnail(out, is_patient=True)
    assert expected.shape == (24, 32, 3)
    np.testing.assert_array_equal(read_image(picture), expected)
    succeed("preview", out, tmp_path / "again.png")
    np.testing.assert_array_equal(read_image(tmp_path / "again.png"), expected)
    small = thumbnail(out)
    assert max(small.shape[:2]) <= 4
    assert np.abs(small.mean(axis=(0, 1)) - expected.mean(axis=(0, 1))).max() < 25


def test_a_preview_that_cannot_be_is_refused_before_work(encoded, tmp_path):
    folder = photographs(tmp_path / "photos")
    before = contents(tmp_path), contents(folder), contents(encoded)
    for words, told in (
        (("pack", folder, tmp_path / "v.h5", "--preview", folder / "0.png"), "0.png"),
        (("pack", folder, tmp_path / "v.png", "--preview", tmp_path / "v.png"), "twice"),
        (("pack", folder, tmp_path / "v.h5", "--preview", tmp_path / "v.h5"), "ends in .png"),
        (("encode", encoded / "fit3.h5", tmp_path / "e.h5", "--preview", tmp_path / "no" / "e.png"), "no folder"),
        (("encode", encoded / "fit3.h5", tmp_path / "e.h5", "--preview", tmp_path / "e.exr"), "ends in .png"),
    ):
        ended = call(*words)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert told in ended.err
    assert (contents(tmp_path), contents(folder), contents(encoded)) == before
    with pytest.raises(cr.InputError, match="give out"):
        cr.encode(encoded / "fit3.h5", preview=tmp_path / "e.png")
