import numpy as np
import pytest

import clrelight as cr
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.images import read_image
from clrelight.store import read_fit, write_stack
from tests.commands import call, succeed
from tests.reference.basis import real_harmonics
from tests.reference.spheres import lamps

CAP = np.array([[0.3, 0.0], [-0.2, 0.25], [-0.1, -0.3], [0.05, 0.1]])
ALBEDO = np.array([0.5, 0.25, 0.8])


def bump(side=13):
    """Return unit normals of a bump that all lights of CAP see."""
    y_hw, x_hw = np.mgrid[0.5 : -0.5 : 1j * side, -0.5 : 0.5 : 1j * side]
    return np.stack([x_hw, y_hw, np.sqrt(1.0 - x_hw**2 - y_hw**2)], axis=2)


def upwards(slopes_i2):
    return np.column_stack([slopes_i2, np.sqrt(1.0 - np.sum(slopes_i2**2, axis=1))])


def lit(normals_hw3, directions_i3):
    shading_ihw = np.maximum(np.einsum("hwa,ia->ihw", normals_hw3, directions_i3), 0.0)
    return LightStack((shading_ihw[..., None] * ALBEDO).astype(np.float32), directions_i3, 1.0)


def exact(normals_hw3):
    """Return the nine pictures of a matte surface: albedo times pi, 2 pi / 3 and pi / 4 of the harmonics."""
    factor_k = np.repeat([np.pi, 2.0 * np.pi / 3.0, np.pi / 4.0], [1, 3, 5])
    shown_pk = real_harmonics(normals_hw3.reshape(-1, 3), 2) * factor_k
    return (shown_pk.T[:, :, None] * ALBEDO).reshape(9, *normals_hw3.shape[:2], 3)


def test_nine_from_photographs_of_degree_2(device, tmp_path):
    directions_i3 = np.concatenate([lamps(11, 3), [[0.0, 0.0, 1.0]]])
    pictures_khwc = np.random.default_rng(6).random((9, 5, 7, 3)) * 0.05
    pictures_khwc[0] += 2.0
    images = np.einsum("ik,khwc->ihwc", real_harmonics(directions_i3, 2), pictures_khwc)
    write_stack(tmp_path / "s.h5", LightStack(images.astype(np.float32), directions_i3, 1.0))
    words = ("variation", "basis", tmp_path / "s.h5", tmp_path / "b.h5", "--pictures", tmp_path / "nine")
    told = succeed(*words, "--json").json
    assert (told["degree"], told["count"], told["by"], len(told["condition"])) == (2, 9, "lights", 3)
    np.testing.assert_allclose(read_fit(tmp_path / "b.h5").coeffs_khwc, pictures_khwc, atol=2e-4)
    assert len(told["files"]) == 10
    assert read_image(tmp_path / "nine" / "harmonic_2_-1.png").shape[:2] == (5, 7)
    assert "9 pictures of degree 2 by lights" in succeed(*words[:4]).out
    for name, line in (("new.h5", "twice: the map and the pictures have that name"), ("no/nine", "there is no folder")):
        ended = call(*words[:3], tmp_path / "new.h5", "--pictures", tmp_path / name)
        assert ended.code == 2
        assert line in ended.err
        assert not (tmp_path / "new.h5").exists()


def test_nine_of_normals_from_four_photographs(device, tmp_path):
    normals_hw3 = bump()
    write_stack(tmp_path / "four.h5", lit(normals_hw3, upwards(CAP)))
    words = ("variation", "basis", tmp_path / "four.h5", tmp_path / "b.h5")
    ended = call(*words)
    assert ended.code == 2
    assert "4 lights do not tell 9 pictures apart" in ended.err
    assert "--by normals makes nine" in ended.err
    assert not (tmp_path / "b.h5").exists()
    told = succeed(*words, "--by", "normals", "--json").json
    assert (told["degree"], told["count"], len(told["condition"])) == (2, 9, 1)
    np.testing.assert_allclose(read_fit(tmp_path / "b.h5").coeffs_khwc, exact(normals_hw3), atol=1.5e-3)
    four = cr.basis_images(lit(normals_hw3, upwards(CAP)), by="normals", degree=1, report=cr.Report())
    np.testing.assert_allclose(four.coeffs_khwc, exact(normals_hw3)[:4], atol=1.5e-3)


def test_lights_in_a_cap_give_four_and_a_note(device):
    report, directions_i3 = cr.Report(), upwards(np.concatenate([CAP, CAP[:, ::-1] - 0.03, CAP * 0.5]))
    made = cr.basis_images(lit(bump(5), directions_i3), report=report)
    assert (made.degree, report.facts["count"]) == (1, 4)
    assert report.facts["condition"][2] > 100.0
    assert report.notes[-1].endswith("these are 4; --by normals makes nine of a convex matte view")
    with pytest.raises(InputError, match=r"12 lights do not tell 9 pictures apart: .* degree 1 can be had"):
        cr.basis_images(lit(bump(5), directions_i3), degree=2, report=cr.Report())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": "magic"}, "by must be lights or normals, got 'magic'"),
        ({"degree": 3}, "degree must be within 0 and 2, got 3"),
    ],
)
def test_odd_options_are_one_line(options, message):
    with pytest.raises(InputError, match=message):
        cr.basis_images(lit(bump(5), upwards(CAP)), report=cr.Report(), **options)


def test_photographs_that_tell_nothing_are_refused(device):
    along = np.linspace(0.3, 2.8, 12)
    in_a_plane = np.stack([np.cos(along), 0.0 * along, np.sin(along)], axis=1)
    for directions_i3, text in ((upwards(CAP)[:1], "1 light does not"), (in_a_plane, "12 lights do not")):
        with pytest.raises(InputError, match=f"{text}.*and not 4 either$"):
            cr.basis_images(lit(bump(5), directions_i3), report=cr.Report())
    with pytest.raises(InputError, match="nearly in one plane"):
        cr.basis_images(lit(bump(5), in_a_plane), by="normals", report=cr.Report())
    for code in (0, 255):
        blank = LightStack(np.full((4, 5, 5, 3), code, np.uint8), upwards(CAP), 255.0)
        with pytest.raises(InputError, match=r"no pixel tells a normal: .* all is black, clipped, or as under no lamp"):
            cr.basis_images(blank, by="normals", report=cr.Report())
