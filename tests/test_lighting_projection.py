"""Environment maps: where texels look, projection both ways, windows, lobes, and the published tables."""

import json
import struct

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_index
from clrelight.harmonics.latlong import latitude_weights, project_latlong, synthesize_latlong
from clrelight.harmonics.windows import window_factors
from clrelight.images import write_image
from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.light import Light, apply_window, set_coefficients, turn_about_z
from clrelight.lighting.projection import measure_lobes, project_environment
from clrelight.lighting.projection_device import project_latlong_on_device
from tests.reference.basis import real_harmonics
from tests.reference.lighting import band_limited, render
from tests.styles import both_styles, every_width

EPS32 = 2.0**-23
SIZES = {
    "angular": (40, 40),
    "latlong": (20, 40),
    "vertical-cross": (48, 36),
    "horizontal-cross": (36, 48),
    "vertical-strip": (72, 12),
    "horizontal-strip": (12, 72),
}
GRACE = {"cross": ("grace_cross.hdr", "probe", 0.0782), "latlong": ("grace_latlong.exr", "right,down,forward", 9.971)}


def write_dds(path, faces, *, dx10=False, levels=1):
    size = faces.shape[1]
    header = bytearray(128)
    header[:4] = b"DDS "
    struct.pack_into("<7I", header, 4, 124, 0x1007, size, size, 0, 1, levels)
    struct.pack_into("<2I", header, 76, 32, 4)
    header[84:88] = b"DX10" if dx10 else struct.pack("<I", 113)
    struct.pack_into("<2I", header, 108, 0x1008, 0 if dx10 else 0xFE00)
    body = bytes(header) + (struct.pack("<5I", 10, 3, 4, 1, 0) if dx10 else b"")
    for face in faces:
        for level in range(levels):
            small = face[:: 1 << level, :: 1 << level]
            body += np.concatenate([small, np.ones_like(small[..., :1])], axis=2).astype("<f2").tobytes()
    path.write_bytes(body)


@pytest.mark.parametrize("layout", SIZES)
def test_every_layout_looks_where_the_reference_says(tmp_path, device, layout):
    radiance, coeffs_kc = band_limited(2, 3, seed=5)
    write_image(tmp_path / "map.exr", render(radiance, layout, *SIZES[layout]).astype(np.float32))
    environment, notes = read_environment(tmp_path / "map.exr", axes="probe")
    assert notes == []
    directions_t3, weights_t = environment.geometry()
    seen = weights_t > 0
    held = environment.radiance_hwc.reshape(-1, 3)[seen]
    np.testing.assert_allclose(held, radiance(directions_t3[seen]), rtol=4 * EPS32)
    assert weights_t.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    # Sums over angular and cube texels are midpoint rules, with an error of their own for so few texels.
    limit = 4e-6 if layout == "latlong" else 0.05
    assert np.abs(project_environment(environment, 2, device=device).coeffs_kc - coeffs_kc).max() < limit


def test_six_files_and_dds_hold_the_same_cube(tmp_path):
    radiance, _ = band_limited(3, 3, seed=6)
    faces = render(radiance, "vertical-strip", 48, 8).reshape(6, 8, 8, 3).astype(np.float16)
    names = ["px", "nx", "py", "ny", "pz", "nz"]
    for name, face in zip(names, faces, strict=True):
        write_image(tmp_path / f"{name}.exr", face)
        write_image(tmp_path / f"{names.index(name)}.exr", face)
    write_dds(tmp_path / "old.dds", faces)
    write_dds(tmp_path / "new.dds", faces, dx10=True, levels=4)
    shuffled, _ = read_environment([tmp_path / f"{name}.exr" for name in sorted(names)])
    in_order, _ = read_environment([tmp_path / f"{i}.exr" for i in range(6)], layout="cube")
    for environment in (shuffled, in_order, *(read_environment(tmp_path / f"{x}.dds")[0] for x in ("old", "new"))):
        assert environment.layout == "cube"
        np.testing.assert_array_equal(environment.radiance_hwc.reshape(6, 8, 8, 3), faces)


@pytest.mark.parametrize("words", ["right,forward,up", "left,forward,up", "forward,left,down", "up,back,right"])
def test_axes_name_the_directions_that_become_x_y_z(words):
    view = {"right": 0, "left": 0, "forward": 1, "back": 1, "up": 2, "down": 2}
    _, matrix = layouts.parse_axes(words)
    for axis, word in enumerate(words.split(",")):
        toward = np.zeros(3)
        toward[view[word]] = -1.0 if word in ("left", "back", "down") else 1.0
        np.testing.assert_array_equal(matrix @ toward, np.eye(3)[axis])


@pytest.mark.parametrize("text", ["", "right,left,up", "right,up", "x,y,z", "right,forward,up,up"])
def test_axes_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="three directions"):
        layouts.parse_axes(text)


@pytest.mark.parametrize(("height", "width", "degree"), [(13, 13, 6), (14, 27, 6), (1, 1, 0), (61, 61, 30)])
def test_band_limited_light_comes_back_exactly_from_the_fewest_samples(height, width, degree):
    rng = np.random.default_rng(1)
    coeffs_kc = rng.standard_normal(((degree + 1) ** 2, 3))
    radiance_hwc = synthesize_latlong(coeffs_kc, height, width)
    back_kc = project_latlong(radiance_hwc, degree)  # float64 in, so that only the method's own error is left
    np.testing.assert_allclose(back_kc, coeffs_kc, atol=1e-12 * (degree + 1) ** 2)


def test_synthesis_is_the_sum_of_the_basis():
    coeffs_kc = np.random.default_rng(2).standard_normal((25, 2))
    directions_t3, _ = layouts.texel_geometry("latlong", 9, 18)
    expected = real_harmonics(directions_t3, 4) @ coeffs_kc
    np.testing.assert_allclose(synthesize_latlong(coeffs_kc, 9, 18).reshape(-1, 2), expected, atol=1e-12)


@pytest.mark.parametrize("height", [1, 2, 3, 8, 31])
def test_row_weights_integrate_polynomials_below_their_number(height):
    z_h = np.cos(np.pi * (np.arange(height) + 0.5) / height)
    weight_h = latitude_weights(height)
    assert (weight_h > 0).all()
    for power in range(height):
        assert weight_h @ z_h**power == pytest.approx(2 / (power + 1) if power % 2 == 0 else 0.0, abs=1e-13)


@pytest.mark.parametrize("axes", ["right,forward,up", "left,forward,up", "forward,left,down", "back,right,up"])
@pytest.mark.parametrize("channels", [1, 3])
def test_both_methods_agree_with_the_plain_sum(device, axes, channels):
    rng = np.random.default_rng(3)
    environment = Environment(rng.random((34, 68, channels), np.float32) ** 8, "latlong", axes)
    directions_t3, weights_t = environment.geometry()
    weighted_tc = weights_t[:, None] * environment.radiance_hwc.reshape(-1, channels).astype(np.float64)
    basis_tk = real_harmonics(directions_t3, 12)
    expected_kc = basis_tk.T @ weighted_tc
    bound_kc = 64 * EPS32 * (np.abs(basis_tk).T @ weighted_tc)
    for method in ("separable", "separable-device", "direct"):
        made = project_environment(environment, 12, method=method, device=device)
        assert made.config["method"] == method
        assert (np.abs(made.coeffs_kc - expected_kc) <= bound_kc).all()


@both_styles
@pytest.mark.parametrize("channels", [1, 3])
def test_azimuths_on_the_device_at_sizes_around_its_blocks(device, channels):
    """Widths that fold by four, by two and not at all, one block of columns and a little more, rows."""
    rng = np.random.default_rng(5)
    for height, width, degree in (
        (1, 1, 0),
        (3, 2, 2),
        (5, 12, 3),
        (11, 1020, 4),
        (13, 1028, 9),
        (4, 513, 2),
        (24, 66, 5),
    ):
        radiance_hwc = rng.random((height, width, channels), np.float32) ** 6
        expected_kc = project_latlong(radiance_hwc.astype(np.float64), degree)
        got_kc = project_latlong_on_device(radiance_hwc, degree, device)
        # Sums over all texels of |y_lm| below sqrt((2 l + 1) / 4 pi) times their solid angle.
        bound = 40 * EPS32 * np.sqrt(2 * degree + 1) * np.pi * radiance_hwc.max()
        np.testing.assert_allclose(got_kc, expected_kc, atol=bound)


@every_width
def test_azimuths_at_every_width_of_vectors(device):
    radiance_hwc = np.random.default_rng(6).random((9, 68, 3), np.float32)
    expected_kc = project_latlong(radiance_hwc.astype(np.float64), 4)
    np.testing.assert_allclose(
        project_latlong_on_device(radiance_hwc, 4, device), expected_kc, atol=40 * EPS32 * 3 * np.pi
    )


@pytest.mark.parametrize("texels", [(1, 1), (15, 15), (16, 16), (17, 17), (61, 61)])
@pytest.mark.parametrize("degree", [0, 1, 5])
def test_direct_projection_at_sizes_around_its_blocks(device, texels, degree):
    rng = np.random.default_rng(4)
    environment = Environment(rng.random((*texels, 3), np.float32), "angular", "up,back,right")
    directions_t3, weights_t = environment.geometry()
    basis_tk = real_harmonics(directions_t3, degree)
    weighted_tc = weights_t[:, None] * environment.radiance_hwc.reshape(-1, 3).astype(np.float64)
    made = project_environment(environment, degree, device=device).coeffs_kc
    assert (np.abs(made - basis_tk.T @ weighted_tc) <= 40 * EPS32 * ((np.abs(basis_tk) + 1e-9).T @ weighted_tc)).all()


def test_direct_projection_of_a_high_degree_near_the_pole(device):
    environment = Environment(np.ones((8, 8, 1), np.float32), "angular", "camera")
    directions_t3, weights_t = environment.geometry()
    basis_tk = real_harmonics(directions_t3, 100)
    made = project_environment(environment, 100, device=device).coeffs_kc[:, 0]
    assert (np.abs(made - basis_tk.T @ weights_t) <= 450 * EPS32 * (np.abs(basis_tk).T @ weights_t + 1e-3)).all()


def test_a_constant_map_has_one_coefficient(device):
    for layout, shape in (("latlong", (16, 32)), ("angular", (32, 32)), ("cube", (48, 8))):
        made = project_environment(Environment(np.full((*shape, 1), 2.0, np.float32), layout), 0, device=device)
        assert made.coeffs_kc[0, 0] == pytest.approx(2 * np.sqrt(4 * np.pi), rel=4e-6)


def test_windows_keep_the_mean_and_only_damp():
    light = Light(np.random.default_rng(0).standard_normal((49, 3)), config={"layout": "latlong"})
    for window in ("gaussian", "hann", "lanczos"):
        for width in (None, 3.0, 100.0):
            factors = window_factors(window, 6, width)
            assert factors[0] == 1.0
            assert (np.diff(factors) <= 1e-15).all()
            assert (factors >= 0).all()
            made = apply_window(light, window, width)
            for l in range(7):
                span = slice(l * l, (l + 1) ** 2)
                np.testing.assert_allclose(made.coeffs_kc[span], factors[l] * light.coeffs_kc[span])
            assert made.config == {"layout": "latlong", "window": window, "window_width": width or 7.0}
    assert window_factors("hann", 6, 3.0)[2] == pytest.approx(0.25)
    assert window_factors("lanczos", 6, 2.0)[1] == pytest.approx(2 / np.pi)
    assert window_factors("gaussian", 6, 2.0)[1] == pytest.approx(np.exp(-1))
    with pytest.raises(InputError, match="gaussian, hann, lanczos"):
        window_factors("box", 6)
    with pytest.raises(InputError, match="positive"):
        window_factors("hann", 6, 0.0)


def test_lobes_of_a_light_that_is_known():
    z = coefficient_index(1, 0)
    coeffs_kc = np.zeros((4, 1))
    coeffs_kc[0], coeffs_kc[z] = np.sqrt(4 * np.pi), np.sqrt(4 * np.pi / 3) * 2  # 1 + 2 z: below 0 where z < -1/2
    lobes = measure_lobes(Light(coeffs_kc))
    assert lobes.mean == pytest.approx(1.0)
    assert lobes.minimum == pytest.approx(-1.0, abs=1e-3)
    assert lobes.share == pytest.approx(0.25, abs=0.02)
    coeffs_kc[z] = 0
    assert measure_lobes(Light(coeffs_kc)).share == 0.0


@pytest.mark.parametrize("window", ["gaussian", "hann", "lanczos"])
def test_a_window_lessens_the_negative_lobes_of_a_small_lamp(device, window):
    radiance = np.zeros((64, 128, 1), np.float32)
    radiance[20, 30] = 1000.0
    plain = project_environment(Environment(radiance, "latlong"), 8, device=device)
    assert measure_lobes(apply_window(plain, window)).minimum > 0.6 * measure_lobes(plain).minimum


def test_turning_about_z_is_turning_the_map():
    rng = np.random.default_rng(7)
    radiance_hwc = rng.random((16, 32, 3), np.float32)
    plain = project_environment(Environment(radiance_hwc, "latlong"), 6)
    # Columns run clockwise seen from above, so a turn by one column moves them to the left.
    turned = project_environment(Environment(np.roll(radiance_hwc, -3, axis=1), "latlong"), 6)
    np.testing.assert_allclose(turn_about_z(plain, 3 * 2 * np.pi / 32).coeffs_kc, turned.coeffs_kc, atol=1e-6)
    x_axis, y_axis = Light(np.eye(4)[3:].T.copy()), Light(np.eye(4)[1:2].T.copy())
    np.testing.assert_allclose(turn_about_z(x_axis, np.pi / 2).coeffs_kc, y_axis.coeffs_kc, atol=1e-15)


def test_coefficients_can_be_set_and_grow_the_light():
    light = set_coefficients(Light(np.ones((4, 3))), {(1, -1): (0.5,), (2, 2): (1.0, 2.0, 3.0)})
    assert light.degree == 2
    np.testing.assert_array_equal(light.coeffs_kc[:, 1], [1, 0.5, 1, 1, 0, 0, 0, 0, 2])
    with pytest.raises(InputError, match="at most 1"):
        set_coefficients(light, {(1, 2): (0.0,)})
    with pytest.raises(InputError, match="1 or 3 numbers"):
        set_coefficients(light, {(1, 1): (0.0, 1.0)})


def table(real_data, name):
    return np.array(json.loads((real_data / "probes" / "sh_tables.json").read_text())[name])


def probe_table(real_data, device, file, axes, method="auto"):
    environment, _ = read_environment(real_data / "probes" / file, axes=axes)
    return project_environment(environment, 2, method=method, device=device).coeffs_kc


@pytest.mark.parametrize("which", GRACE)
def test_grace_has_the_published_coefficients(real_data, device, which):
    file, axes, scale = GRACE[which]
    ours = scale * probe_table(real_data, device, file, axes)
    assert np.abs(ours - table(real_data, "grace_listing")).max() < 0.006
    # Figure 2 prints two digits of these numbers, so half a digit is its own.
    assert np.abs(ours - table(real_data, "grace_figure2")).max() < 0.006 + 0.005


def test_both_files_of_grace_agree(real_data, device):
    cross, latlong = (scale * probe_table(real_data, device, file, axes) for file, axes, scale in GRACE.values())
    assert np.abs(cross - latlong).max() < 0.004


@pytest.mark.parametrize(
    ("file", "name", "scale"), [("beach_probe.hdr", "beach", 0.398), ("galileo_cross.dds", "galileo", 0.2)]
)
def test_beach_and_galileo_have_the_published_coefficients(real_data, device, file, name, scale):
    assert np.abs(scale * probe_table(real_data, device, file, "probe") - table(real_data, name)).max() < 0.01
