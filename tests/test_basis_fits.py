"""Fits of other bases than spherical harmonics, from photographs through files and codecs to images."""

from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight.bases import basis_of
from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.codec.rate.noise import measure_image_error
from clrelight.errors import InputError, PayloadError, StoreFormatError
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import relight_under
from clrelight.relight import relight
from tests.commands import attributes, call, succeed
from tests.reference import bases as reference
from tests.reference.basis import real_harmonics
from tests.reference.cpca import decode_cpca
from tests.reference.klt4 import decode_klt4
from tests.stacks import columns_of, make_stack, samples_of

HEMISPHERICAL = ("hsh", "gram-schmidt", "zernike", "makhotkin", "haar")


@pytest.fixture(scope="module")
def stack():
    return make_stack(shape_hwc=(8, 12, 3))


@pytest.fixture(scope="module")
def stack_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("bases") / "stack.h5"
    succeed("synth", "ring", path, "--size", 24, "--lights", 48)
    return path


@pytest.mark.parametrize("name", HEMISPHERICAL)
def test_uls_is_the_least_squares_of_that_basis(stack, name):
    fitted = cr.fit(stack, "uls", 3, basis=name)
    basis_ik = reference.FUNCTIONS[name](stack.directions_i3, 3)
    expected = np.linalg.lstsq(basis_ik, samples_of(stack), rcond=None)[0]
    np.testing.assert_allclose(columns_of(fitted), expected, rtol=0, atol=3e-5)
    assert fitted.basis == name


@pytest.mark.parametrize("name", HEMISPHERICAL)
def test_spline_takes_the_roughness_of_the_basis(stack, name):
    fitted = cr.fit(stack, "spline", 3, basis=name, lam=0.01)
    basis_ik = basis_of(name).evaluate(stack.directions_i3, 15)
    k = np.arange(256)
    l = np.sqrt(k).astype(int)
    level = np.where(k > 0, np.floor(np.log2(np.maximum(k, 1)) / 2 + 1e-12), 0)
    rough = np.where(k > 0, 4.0 ** (level + 1), 0.01) if name == "haar" else 0.01 + (l * (l + 1.0)) ** 2
    expected = np.linalg.solve(basis_ik.T @ basis_ik + 0.01 * np.diag(rough), basis_ik.T @ samples_of(stack))
    np.testing.assert_allclose(columns_of(fitted), expected[:16], rtol=0, atol=3e-5)
    assert "lam" in cr.fit(stack, "spline", 3, basis=name).config  # by cross-validation, at degree 15


def test_what_has_no_basis_is_as_it_was(stack):
    assert "basis" not in cr.fit(stack, "uls", 3).config
    plain, named = cr.fit(stack, "uls", 3), cr.fit(stack, "uls", 3, basis="sh")
    assert dict(plain.config) == dict(named.config)
    np.testing.assert_array_equal(plain.coeffs_khwc, named.coeffs_khwc)


@pytest.mark.parametrize(
    ("method", "degree", "basis", "match"),
    [
        ("cls", 3, "hsh", "method cls fits spherical harmonics"),
        ("auto", 3, "hsh", "method auto fits spherical harmonics"),
        ("uls", "auto", "hsh", "needs a degree by number"),
        ("uls", 3, "hash", "unknown basis 'hash'"),
        ("uls", 4, "haar", "haar has degrees 0, 1, 3, 7"),
        ("uls", 9, "hsh", "100 coefficients but there are 90 lights"),
    ],
)
def test_requests_that_are_refused(stack, method, degree, basis, match):
    with pytest.raises(InputError, match=match):
        cr.fit(stack, method, degree, basis=basis)


def test_lights_below_the_horizon_are_refused(stack):
    directions = stack.directions_i3.copy()
    directions[5] = [0.6, 0.0, -0.8]
    with pytest.raises(InputError, match="basis zernike knows the upper hemisphere only"):
        cr.fit(replace(stack, directions_i3=directions), "uls", 3, basis="zernike")


@pytest.mark.parametrize("name", HEMISPHERICAL)
def test_relit_under_a_direction_and_under_a_light(device, stack, name):
    fitted = cr.fit(stack, "uls", 3, basis=name)
    directions = stack.directions_i3[::7]
    images = relight(fitted, directions)
    expected = reference.FUNCTIONS[name](directions, 3) @ columns_of(fitted)
    np.testing.assert_allclose(images.reshape(len(directions), -1), expected, rtol=0, atol=1e-5)
    light = Light(np.random.default_rng(4).standard_normal((16, 1)))
    nodes, weights = reference.root_quadrature(120, 60)
    radiance = real_harmonics(nodes, 3) @ light.coeffs_kc[:, 0]
    whole = (weights * radiance) @ reference.FUNCTIONS[name](nodes, 3) @ columns_of(fitted)
    found = relight_under(fitted, light, device=device)
    tolerance = 2e-2 if name == "haar" else 1e-5  # the reference's steps across edges of cells
    np.testing.assert_allclose(found.ravel(), whole, rtol=0, atol=tolerance * np.abs(whole).max())


@pytest.mark.parametrize("name", HEMISPHERICAL)
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_klt_decodes_by_its_page(device, stack, name, transfer):
    fitted = cr.fit(stack, "uls", 3, basis=name)
    codec = codec_class("klt")(step=0.02, transfer=transfer)
    encoded = encode(fitted.coeffs_khwc, codec, device, name)
    found = decode(encoded.to_bytes(), device)
    expected = decode_klt4(encoded.body, encoded.shape).coeffs
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
    view = decode_view(encoded, device)
    images = view.relight(stack.directions_i3[:5], device)
    relit = np.einsum("ik,khwc->ihwc", reference.FUNCTIONS[name](stack.directions_i3[:5], 3), found)
    if encoded.body[10] % 2 == 0:  # behind the curve, code values are what is evaluated
        np.testing.assert_allclose(images, relit, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", HEMISPHERICAL)
def test_cpca_codes_any_basis(device, stack, tmp_path, name):
    """Decoded by the page of the format, said by its file to be of that basis, relit by that basis."""
    fitted = cr.fit(stack, "uls", 3, basis=name)
    cr.encode(fitted, "cpca", out=tmp_path / "e.h5", clusters=2, components=48, bits=12)
    held = cr.decode(tmp_path / "e.h5")
    assert (held.basis, held.degree) == (name, 3)
    encoded = cr.encode(fitted, "cpca", clusters=2, components=48, bits=12)
    expected = decode_cpca(encoded.body, encoded.shape)
    np.testing.assert_allclose(held.coeffs_khwc, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
    nodes, weights = reference.hemisphere_quadrature(6)
    shown_np = reference.FUNCTIONS[name](nodes, 3) @ columns_of(fitted)
    relit_np = relight(cr.decode(tmp_path / "e.h5"), nodes).reshape(len(nodes), -1)
    assert weights @ ((relit_np - shown_np) ** 2).mean(axis=1) < 1e-5 * (weights @ (shown_np**2).mean(axis=1))


def test_klt_of_harmonics_says_no_basis(device, stack):
    fitted = cr.fit(stack, "uls", 3)
    body = encode(fitted.coeffs_khwc, codec_class("klt")(step=0.02), device).body
    assert body[10] >> 4 == 0


@pytest.mark.parametrize("name", ["hsh", "makhotkin"])
@pytest.mark.parametrize("codec", ["uniform", "klt"])
def test_coding_error_is_that_of_images(device, stack, name, codec):
    """Measured in the metric of the basis, and by relighting at the nodes of a quadrature."""
    fitted = cr.fit(stack, "uls", 3, basis=name)
    options = {"bits": 5} if codec == "uniform" else {"step": 0.05}
    decoded = decode(encode(fitted.coeffs_khwc, codec_class(codec).from_config(options), device, name), device)
    nodes, weights = reference.hemisphere_quadrature(6)
    lost_kp = (decoded - fitted.coeffs_khwc).reshape(16, -1).astype(np.float64)
    expected = weights @ ((reference.FUNCTIONS[name](nodes, 3) @ lost_kp) ** 2).mean(axis=1) / (2 * np.pi)
    assert expected > 1e-9
    np.testing.assert_allclose(measure_image_error(fitted.coeffs_khwc, decoded, name), expected, rtol=1e-6)


def test_no_step_is_wasted_on_what_no_image_shows(device, stack):
    """At one size, klt in the metric of makhotkin's functions loses less of the image than in that of others."""
    fitted = cr.fit(stack, "uls", 7, basis="makhotkin")

    def lost(basis):
        encoded = encode(fitted.coeffs_khwc, codec_class("klt")(rate=1.5), device, basis)
        return measure_image_error(fitted.coeffs_khwc, decode(encoded, device), "makhotkin")

    assert lost("makhotkin") < 0.9 * lost("hsh")


@pytest.mark.parametrize("codec", ["whitened", "principal"])
def test_codecs_in_the_metric_of_harmonics_refuse(stack, codec):
    with pytest.raises(InputError, match=f"codec {codec} makes spherical harmonics orthonormal"):
        cr.encode(cr.fit(stack, "uls", 3, basis="hsh"), codec)


def test_bytes_that_disagree_with_their_record_are_refused(device, stack):
    fitted = cr.fit(stack, "uls", 3, basis="hsh")
    encoded = cr.encode(fitted, "klt", rate=0.5)
    other = replace(encoded.record, config={**encoded.record.config, "basis": "zernike"})
    with pytest.raises(PayloadError, match="klt body is of basis hsh, what it comes with says zernike"):
        decode_view(replace(encoded, record=other), device)
    body = bytearray(encoded.body)
    body[10] = 0x70  # there is no basis 7
    with pytest.raises(PayloadError, match="cannot have transfer curve 0 and basis 7"):
        codec_class("klt").decode_body(bytes(body), encoded.shape, device)
    body[10] = 0x50  # haar has no degree 4
    with pytest.raises(PayloadError):
        codec_class("klt").decode_body(bytes(body), (25, *encoded.shape[1:]), device)


def test_files_say_which_basis(stack, tmp_path):
    for name, schema in (("sh", "fit/1"), ("hsh", "fit/2")):
        report = cr.fit(stack, "uls", 3, basis=name, out=tmp_path / f"{name}.h5")
        assert report.facts["config"].get("basis", "sh") == name
        assert attributes(tmp_path / f"{name}.h5")["clrelight_schema"] == schema
        assert cr.read_fit(tmp_path / f"{name}.h5").basis == name
        cr.encode(tmp_path / f"{name}.h5", "uniform", out=tmp_path / f"{name}.enc.h5")
        assert attributes(tmp_path / f"{name}.enc.h5")["clrelight_schema"] == "encoded/4"
        assert cr.decode(tmp_path / f"{name}.enc.h5").basis == name


def test_a_version_that_holds_no_such_basis_is_refused(stack, tmp_path):
    from clrelight.store.fits import check_version
    from clrelight.store.opening import opening
    from clrelight.store.schemas import FIT

    cr.fit(stack, "uls", 3, basis="hsh", out=tmp_path / "hsh.h5")
    with opening(tmp_path / "hsh.h5") as opened, pytest.raises(StoreFormatError, match="fit/2 holds no coefficients"):
        check_version(opened, cr.fit(stack, "uls", 3), FIT)


@pytest.mark.parametrize("name", HEMISPHERICAL)
def test_the_walk_through_the_commands(stack_file, tmp_path, name):
    fit, enc, back = (tmp_path / f"{step}.h5" for step in ("fit", "enc", "back"))
    facts = succeed(
        "fit", stack_file, fit, "--method", "spline", "--degree", 3, "--basis", name, "--holdout", 5, "--json"
    ).json
    assert facts["config"]["basis"] == name
    for codec, rest in (("klt", ("--rate", 1)), ("wavelet", ("--rate", 4)), ("s3tc", ()), ("half", ()), ("vq", ())):
        succeed("encode", fit, enc, "--codec", codec, *rest)
        succeed("decode", enc, back)
        one, other = (succeed("psnr", path, stack_file, "--json").json["psnr"] for path in (enc, back))
        assert one == pytest.approx(other, abs=1e-3)
        assert one["pooled_fitted"] > facts["psnr"]["pooled_fitted"] - 3
        for path in (enc, back):
            succeed("relight", path, tmp_path / f"{path.stem}.exr", "--light", "0.3,0.2,0.8")
        pictures = [cr.relight(path, [0.3, 0.2, 0.8]) for path in (enc, back)]
        np.testing.assert_allclose(*pictures, atol=2e-3)
    assert name in succeed("info", fit).out


@pytest.mark.parametrize(
    "line",
    [
        ("export", "FIT", "OUT"),
        ("shader", "transfer", "LIGHT", "--out", "OUT", "--map", "FIT"),
        ("render", "FIT", "OUT.png", "--light", "0,0,1"),
        ("reflect", "FIT", "OUT.h5", "--light", "LIGHT"),
    ],
)
def test_what_needs_harmonics_refuses_in_one_line(stack_file, tmp_path, line):
    fit, light = tmp_path / "fit.h5", tmp_path / "light.h5"
    succeed("fit", stack_file, fit, "--method", "uls", "--degree", 3, "--basis", "zernike")
    cr.write_light(light, Light(np.ones((16, 1))))
    there = set(tmp_path.iterdir())
    words = {"FIT": fit, "LIGHT": light, "OUT": tmp_path / "out", "OUT.png": tmp_path / "out.png"}
    words["OUT.h5"] = tmp_path / "out.h5"
    done = call(*(words.get(word, word) for word in line))
    assert done.code == 2
    assert "of basis zernike: fit with --basis sh" in done.err
    assert done.err.count("\n") == 1
    assert set(tmp_path.iterdir()) == there


def test_textures_of_a_map_in_memory_are_refused(device, stack, tmp_path):
    with pytest.raises(InputError, match="of basis hsh"):
        cr.export_textures(cr.fit(stack, "uls", 3, basis="hsh"), tmp_path / "textures", device=device)
    assert not list(tmp_path.iterdir())


def test_gram_schmidt_becomes_a_fit_of_harmonics(stack_file, tmp_path):
    small, fit = tmp_path / "small.h5", tmp_path / "fit.h5"
    succeed("fit", stack_file, small, "--method", "uls", "--degree", 3, "--basis", "gram-schmidt")
    succeed("to-sh", small, fit)
    assert attributes(fit)["clrelight_schema"] == "fit/1"
    directions = reference.hemisphere_quadrature(4)[0]
    one, other = (cr.relight(path, directions) for path in (small, fit))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-5)
    succeed("export", fit, tmp_path / "textures")
    np.testing.assert_array_equal(cr.to_sh(small).coeffs_khwc, cr.read_fit(fit).coeffs_khwc)
    done = call("to-sh", fit, tmp_path / "again.h5")
    assert (done.code, "already" in done.err) == (2, True)


def test_what_does_not_become_harmonics_is_refused(stack):
    with pytest.raises(InputError, match="basis hsh does not span spherical harmonics"):
        cr.to_sh(cr.fit(stack, "uls", 3, basis="hsh"))
    with pytest.raises(InputError, match=r"condition number is \S+, beyond float32"):
        cr.to_sh(cr.fit(stack, "spline", 12, basis="gram-schmidt", lam=0.1))


def test_pack_takes_a_basis(stack_file, tmp_path):
    out = tmp_path / "packed.h5"
    succeed(
        "pack", stack_file, out, "--method", "uls", "--degree", 3, "--basis", "zernike", "--holdout", 5, "--rate", 8
    )
    assert attributes(out)["clrelight_schema"] == "encoded/4"
    found = succeed("psnr", out, stack_file, "--json").json["psnr"]
    fitted = cr.fit(stack_file, "uls", 3, basis="zernike", holdout=5, report=cr.Report())
    assert found["pooled_fitted"] == pytest.approx(cr.measure(fitted, stack_file)["pooled_fitted"], abs=0.5)
    assert basis_of(cr.decode(out).basis).id == "zernike"
