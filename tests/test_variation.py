"""Components of pictures and the light behind them: the numbers of the chapter, and exact ways back."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.errors import InputError
from clrelight.images import read_image, write_image
from clrelight.lighting.irradiance import cosine_coefficients
from clrelight.variation.inverse import basis_pictures, find_light
from clrelight.variation.subspaces import analytic_subspace, empirical_subspace, energy_bound, kernel_energy
from tests.commands import call, contents, succeed
from tests.meshes import icosphere
from tests.reference.basis import real_harmonics


def ellipsoid(a=1.0, b=1.0, c=1.0, size=301):
    """Return the normals that are seen from +z, a pixel each."""
    x_hw, y_hw = np.meshgrid(a * np.linspace(-1, 1, size), b * np.linspace(-1, 1, size))
    square_hw = 1 - (x_hw / a) ** 2 - (y_hw / b) ** 2
    inside = square_hw > 0
    normals_p3 = np.stack([x_hw[inside] / a**2, y_hw[inside] / b**2, np.sqrt(square_hw[inside]) / c], axis=1)
    return normals_p3 / np.linalg.norm(normals_p3, axis=1, keepdims=True)


def all_around(count=20_000):
    normals_p3 = np.random.default_rng(1).standard_normal((count, 3))
    return normals_p3 / np.linalg.norm(normals_p3, axis=1, keepdims=True)


def shade(normals_p3, light_kc, degree=2):
    factor_k = np.repeat(cosine_coefficients(degree), 2 * np.arange(degree + 1) + 1)
    return real_harmonics(normals_p3, degree) @ (factor_k[:, None] * light_kc)


def test_energy_of_the_half_cosine():
    total_l = np.cumsum(kernel_energy(4))
    np.testing.assert_allclose(total_l[[0, 1, 2, 4]], [0.375, 0.875, 0.99219, 0.99805], atol=5e-6)
    assert energy_bound(2) == pytest.approx(0.9796, abs=5e-5)
    assert energy_bound(1) == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("axes", "expected"),
    [((1, 1, 1), [0.433, 0.244, 0.244, 0.0237, 0.0237]), ((1, 1.7, 1.3), [0.425, 0.328, 0.167, 0.034, 0.022])],
)
def test_components_of_a_body(axes, expected):
    found = analytic_subspace(ellipsoid(*axes))
    np.testing.assert_allclose(found.variance_r[:5], expected, atol=2e-3)
    if axes == (1, 1, 1):
        assert found.cumulative(3) == pytest.approx(0.922, abs=2e-3)
        assert found.cumulative(5) == pytest.approx(0.969, abs=2e-3)
    assert found.variance_r.sum() == pytest.approx(1)
    raw = analytic_subspace(ellipsoid(*axes), centred=False)
    assert raw.variance_r[0] > 0.6  # the mean


def test_components_of_all_normals_are_the_harmonics():
    found = analytic_subspace(all_around(400_000), centred=False)
    energy = np.repeat(kernel_energy(2) / (2 * np.arange(3) + 1), 2 * np.arange(3) + 1)
    np.testing.assert_allclose(found.variance_r, energy / energy.sum(), atol=3e-3)


@pytest.mark.parametrize("centred", [True, False])
def test_components_of_pictures_by_blocks(centred):
    pictures_ip = np.random.default_rng(0).random((12, 500)) * np.linspace(1, 3, 12)[:, None]
    found = empirical_subspace([pictures_ip[:, :123], pictures_ip[:, 123:]], centred=centred)
    singular_r = np.linalg.svd(pictures_ip - centred * pictures_ip.mean(axis=0), compute_uv=False)
    np.testing.assert_allclose(found.variance_r, singular_r**2 / np.sum(singular_r**2), atol=1e-12)
    with pytest.raises(InputError, match="do not vary"):
        empirical_subspace([np.zeros((3, 5))])
    with pytest.raises(InputError, match="no pictures"):
        empirical_subspace([])


def test_pca_of_photographs(real_data, tmp_path):
    folder = real_data / "stacks" / "loewenkopf"
    cr.ingest(folder / "jpg", tmp_path / "s.h5", lights=folder / "dirs.lp", transfer="linear", report=cr.Report())
    told = succeed("variation", "pca", tmp_path / "s.h5", "--memory", "20M", "--json").json
    assert (told["kind"], told["count"], told["centred"]) == ("stack", 240, True)
    shares = [told["cumulative"][count] for count in ("3", "5", "9")]
    np.testing.assert_allclose(shares, [0.901, 0.924, 0.949], atol=0.015)
    words = ("variation", "pca", tmp_path / "s.h5", "--pictures", tmp_path / "drawn", "--json")
    assert succeed(*words).json["variance"] == pytest.approx(told["variance"])
    with cr.open_stack(tmp_path / "s.h5") as stack:
        grey_ip = np.asarray(stack.images_ihwc[...], np.float64).mean(axis=3).reshape(240, -1)
    best_p = np.linalg.svd(grey_ip - grey_ip.mean(axis=0), full_matrices=False)[2][0]
    drawn = read_image(tmp_path / "drawn" / "component_1.png").ravel().astype(float)
    assert abs(np.corrcoef(drawn, best_p)[0, 1]) > 0.97


def test_pca_of_meshes_and_normals(tmp_path):
    told = cr.Report()
    cr.principal_components(icosphere(4), report=told)
    np.testing.assert_allclose(told.facts["variance"][:5], [0.433, 0.244, 0.244, 0.0237, 0.0237], atol=4e-3)
    normals_p3 = ellipsoid(1, 1.7, 1.3, size=60)
    image = np.zeros((1, len(normals_p3) + 5, 3), np.float32)
    image[0, 5:] = normals_p3
    write_image(tmp_path / "n.exr", image)
    write_image(tmp_path / "n.png", np.rint(32767.5 * image * [1, -1, 1] + 32767.5).astype(np.uint16))
    held = succeed("variation", "pca", tmp_path / "n.exr", "--json").json
    assert (held["kind"], held["count"]) == ("normals", len(normals_p3))
    np.testing.assert_allclose(held["variance"][:5], [0.425, 0.328, 0.167, 0.034, 0.022], atol=4e-3)
    coded = succeed("variation", "pca", tmp_path / "n.png", "--green", "down", "--json").json
    np.testing.assert_allclose(coded["variance"], held["variance"], atol=1e-4)
    words = ("variation", "pca", tmp_path / "n.exr", "--pictures", tmp_path / "drawn")
    assert len(succeed(*words, "--json").json["files"]) == len(list((tmp_path / "drawn").iterdir()))
    # The first harmonic is one value all over, grey beside the pixels that have a normal; every so many are shown.
    step = -(-image.shape[1] // 1024)
    seen = image[0, ::step].any(axis=1)
    drawn = read_image(tmp_path / "drawn" / "harmonic_0_0.png")[0, :, 0]
    assert set(drawn[~seen]) == {128}
    assert set(drawn[seen]) == {255}
    first = read_image(tmp_path / "drawn" / "component_1.png")[0, seen, 0].astype(float)
    basis_pk = real_harmonics(normals_p3, 2)[:, 1:] * np.repeat(cosine_coefficients(2)[1:], [3, 5])
    best_p = basis_pk @ np.linalg.svd(basis_pk, full_matrices=False)[2][0]
    assert abs(np.corrcoef(first, np.concatenate([np.zeros(5), best_p])[::step][seen])[0, 1]) > 0.999
    assert call(*words).err.count("is there: pictures go to a new folder") == 1
    lines = succeed("variation", "pca", tmp_path / "n.exr", "--raw").out
    assert "kept" in lines
    assert "pixels" in lines


@pytest.mark.parametrize(("normals_p3", "condition"), [(all_around(), 4.0), (ellipsoid(), 38.3)])
def test_light_of_nine_terms_comes_back(normals_p3, condition):
    rng = np.random.default_rng(3)
    light_kc, albedo_pc = rng.standard_normal((9, 3)), rng.random((len(normals_p3), 3)) + 0.1
    found = find_light(albedo_pc * shade(normals_p3, light_kc), normals_p3, albedo_pc)
    np.testing.assert_allclose(found.coeffs_kc, light_kc, atol=1e-10)
    plain = find_light(shade(normals_p3, light_kc), normals_p3)
    np.testing.assert_allclose(plain.coeffs_kc, light_kc, atol=1e-10)
    assert plain.condition_l[2] == pytest.approx(condition, rel=0.02)
    assert found.unseen == ()
    assert found.residual < 1e-6


def test_odd_degrees_leave_no_trace():
    light_kc = np.random.default_rng(4).standard_normal((25, 1))
    normals_p3 = all_around()
    found = find_light(shade(normals_p3, light_kc, 4), normals_p3, degree=4)
    assert found.unseen == (3,)
    assert not found.coeffs_kc[9:16].any()
    np.testing.assert_allclose(found.coeffs_kc[:9], light_kc[:9], atol=1e-9)
    np.testing.assert_allclose(found.coeffs_kc[16:], light_kc[16:], atol=1e-9)


def test_flat_views_are_reduced_refused_or_damped():
    normals_p3 = ellipsoid(1, 1, 0.05)
    light_kc = np.random.default_rng(5).standard_normal((9, 1))
    picture_pc = shade(normals_p3, light_kc)
    reduced = find_light(picture_pc, normals_p3)
    assert len(reduced.coeffs_kc) < 9
    with pytest.raises(InputError, match=r"condition is [\d.e+]+, at most 100"):
        find_light(picture_pc, normals_p3, degree=2)
    damped = find_light(picture_pc, normals_p3, degree=2, ridge=1e-4)
    assert np.isfinite(damped.coeffs_kc).all()
    assert damped.residual < 0.05
    with pytest.raises(InputError, match="ridge must be"):
        find_light(picture_pc, normals_p3, ridge=-1.0)
    with pytest.raises(InputError, match="as many normals"):
        find_light(picture_pc, normals_p3[1:])
    with pytest.raises(InputError, match="the picture is black wherever there are normals"):
        find_light(0.0 * picture_pc, normals_p3)
    with pytest.raises(InputError, match="the albedo is 0 everywhere"):
        find_light(picture_pc, normals_p3, 0.0 * picture_pc)


def test_nine_pictures_from_few():
    directions_i3, pictures_kp = all_around(12), np.random.default_rng(6).random((9, 40))
    found = basis_pictures(real_harmonics(directions_i3, 2) @ pictures_kp, directions_i3)
    assert found.degree == 2
    np.testing.assert_allclose(found.pictures_kp, pictures_kp, atol=1e-10)


def test_lights_in_a_cap_are_refused_or_reduced(real_data):
    directions_i3 = np.loadtxt(real_data / "stacks" / "diligent" / "catPNG" / "light_directions.txt")
    directions_i3 /= np.linalg.norm(directions_i3, axis=1, keepdims=True)
    reduced = basis_pictures(np.ones((96, 5)), directions_i3)
    assert (reduced.degree, reduced.pictures_kp.shape) == (1, (4, 5))
    assert reduced.condition_l[2] == pytest.approx(655, abs=1)
    with pytest.raises(InputError, match="9 pictures apart: the condition is 655, at most 100; degree 1"):
        basis_pictures(np.ones((96, 5)), directions_i3, 2)


def test_inverse_command(tmp_path):
    size = 40
    x_hw, y_hw = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    z_hw = np.sqrt(np.maximum(1 - x_hw**2 - y_hw**2, 0))
    normals_hw3 = np.where((z_hw > 0)[..., None], np.stack([x_hw, y_hw, z_hw], axis=2), 0.0)
    light_kc = np.random.default_rng(7).standard_normal((9, 3))
    light_kc[0] = 4.0
    albedo_hwc = np.full((size, size, 3), [0.5, 0.25, 1.0])
    picture_hwc = albedo_hwc * shade(normals_hw3.reshape(-1, 3), light_kc).reshape(size, size, 3)
    for name, values in (("n", normals_hw3), ("a", albedo_hwc), ("p", picture_hwc)):
        write_image(tmp_path / f"{name}.exr", values.astype(np.float32))
    files = [tmp_path / name for name in ("p.exr", "n.exr", "l.h5")]
    told = succeed("variation", "inverse", *files, "--albedo", tmp_path / "a.exr", "--json").json
    assert (told["degree"], told["unseen"], told["file"]) == (2, [], str(files[2]))
    np.testing.assert_allclose(cr.read_light(files[2]).coeffs_kc, light_kc, atol=1e-4)
    np.testing.assert_allclose(told["coefficients"], light_kc, atol=1e-4)
    held = cr.inverse_lighting(*files[:2], albedo=tmp_path / "a.exr", report=cr.Report())
    np.testing.assert_array_equal(held.coeffs_kc, told["coefficients"])
    lines = succeed("variation", "inverse", *files, "--albedo", tmp_path / "a.exr").out
    assert "1, 6.13, 40" in lines
    before = contents(tmp_path)
    write_image(tmp_path / "small.exr", np.ones((3, 3, 3), np.float32))
    before = contents(tmp_path)
    for words, message in (
        ([tmp_path / "small.exr", *files[1:]], "the normals are 40×40"),
        ([files[0], tmp_path / "none.exr", files[2]], "there is no image"),
        ([*files, "--degree", 8], "the condition is"),
    ):
        ended = call("variation", "inverse", *words)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert message in ended.err
        assert contents(tmp_path) == before
