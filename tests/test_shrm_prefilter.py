"""Reflection maps against the printed formulas, against integration over angles, and as tables and back."""

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.brdf.radial import Lambert, Phong, lobe_factors
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.latlong import project_latlong, synthesize_latlong
from clrelight.harmonics.quadrature import product_rule
from clrelight.harmonics.rotation import rotation_blocks, rotation_matrix
from clrelight.harmonics.wigner import complex_coefficients, turn_functions, turn_tables
from clrelight.lighting.irradiance import evaluate_irradiance
from clrelight.lighting.light import Light
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.expansion import METHODS, expand_orders
from clrelight.shrm.explicit import explicit_maps, view_map
from clrelight.shrm.lookup import local_view
from clrelight.shrm.prefilter import build_shrm, to_global, to_local
from clrelight.shrm.record import Shrm, grid_directions
from tests.reference import shrm as reference
from tests.styles import both_styles, every_width

F, P, ROWS, COLUMNS = 6, 3, 5, 15


def random_light(degree=F, channels=3, seed=0):
    return Light(np.random.default_rng(seed).standard_normal(((degree + 1) ** 2, channels)))


def random_brdf(degree=F, order=P, channels=1, seed=1):
    """Return a band-limited reflectance; no surface has it, but the sums must not mind."""
    rho = np.random.default_rng(seed).standard_normal((degree + 1, order + 1, order + 1, channels))
    l, p, q = np.indices(rho.shape[:3])
    rho[q > np.minimum(l, p)] = 0.0
    return BrdfCoefficients(rho, np.ones(channels))


def integrate_local(light, brdf, shrm, views):
    """Return the radiance towards local views at every texel, by a rule that is exact for both functions' product."""
    nodes, weights = product_rule(F, sphere=True)
    radiance = weights[:, None] * (evaluate_basis(nodes, light.degree) @ light.coeffs_kc)
    theta_o, phi_o = np.arccos(views[:, 2]), np.arctan2(views[:, 1], views[:, 0])
    alpha, beta = shrm.angles()
    out = np.empty((len(views), len(alpha), len(beta), light.channels))
    for h, a in enumerate(alpha):
        for w, b in enumerate(beta):
            local = nodes @ reference.frame(a, b)
            theta_i, phi_i = np.arccos(local[:, 2]), np.arctan2(local[:, 1], local[:, 0])
            for v in range(len(views)):
                values = reference.reflectance(brdf.rho_lpqc[..., 0], theta_i, theta_o[v], phi_o[v] - phi_i)
                out[v, h, w] = values @ radiance
    return out


def random_views(count, seed=2):
    views = np.random.default_rng(seed).standard_normal((count, 3))
    return views / np.linalg.norm(views, axis=1, keepdims=True)


@pytest.mark.parametrize("l", [0, 1, 2, 3, 7])
def test_turns_are_those_of_wigner(l):
    """But for the sign of Condon and Shortley, in which m and q each take part."""
    alpha = np.array([0.0, 0.3, 1.2, 2.9, np.pi])
    sign = {m: (-1.0) ** max(m, 0) for m in range(-l, l + 1)}
    for m in range(-l, l + 1):
        for q in range(-l, l + 1):
            got = turn_functions(alpha, l, m, q)[-1]
            np.testing.assert_allclose(got, sign[m] * sign[q] * reference.small_d(l, m, q, alpha), atol=1e-13)


@pytest.mark.parametrize("q", [0, 1, 4])
def test_tables_of_many_orders_are_those_of_one(q):
    alpha = np.array([0.0, 0.3, 1.2, 2.9])
    orders = np.array([0, 1, 4, 6])
    tables = turn_tables(alpha, 6, orders, q)
    for m, plus, minus in zip(orders.tolist(), *tables, strict=True):
        for side, got in ((1, plus), (-1, minus)):
            np.testing.assert_allclose(got[:, max(m, q) :].T, turn_functions(alpha, 6, side * m, q), atol=1e-14)
            assert not got[:, : max(m, q)].any()


def test_turns_stay_orthonormal_at_high_degrees():
    alpha = np.array([0.02, 0.7, 3.0])
    for q in (0, 1, 5):
        rows = np.stack([turn_functions(alpha, 100, m, q)[-1] for m in range(-100, 101)])
        np.testing.assert_allclose((rows**2).sum(axis=0), 1.0, atol=1e-11)


def test_reference_has_the_sign_that_is_stated():
    assert reference.small_d(1, 1, 0, 0.4) == pytest.approx(-np.sin(0.4) / np.sqrt(2), abs=1e-15)


def test_complex_coefficients_give_the_light():
    light = random_light(channels=1)
    printed = reference.complex_light(light.coeffs_kc[:, 0])
    for m in range(F + 1):
        for l, value in zip(range(m, F + 1), complex_coefficients(light.coeffs_kc, m)[:, 0], strict=True):
            assert value * (-1) ** m == pytest.approx(printed[l, m], abs=1e-14)


@pytest.fixture(scope="module")
def printed():
    """Return a light, a reflectance, and the local and global radiance of the printed formulas at some texels."""
    light, brdf = random_light(channels=1), random_brdf()
    known = reference.complex_light(light.coeffs_kc[:, 0])
    shrm = build_shrm(light, brdf, ROWS, COLUMNS)
    alpha, beta = shrm.angles()
    places = [(0, 0), (1, 7), (2, 14), (4, 3)]
    local, world = {}, {}
    for h, w in places:
        for p in range(P + 1):
            orders = range(-p, p + 1)
            rho = brdf.rho_lpqc[..., 0]
            own = [reference.local_coefficient(known, rho, p, q, alpha[h], beta[w]) for q in orders]
            turned = [reference.global_coefficient(own, p, q, alpha[h], beta[w]) for q in orders]
            for q in orders:
                local[h, w, p, q], world[h, w, p, q] = own[q + p], turned[q + p]
    return shrm, places, local, world


@pytest.mark.parametrize("frame", ["local", "global"])
def test_maps_are_those_of_the_printed_formulas(printed, frame):
    shrm, places, *both = printed
    expected = both[frame == "global"]
    maps = (shrm if frame == "local" else to_global(shrm)).maps_khwc[..., 0]
    views = random_views(9)
    theta, phi = np.arccos(views[:, 2]), np.arctan2(views[:, 1], views[:, 0])
    for h, w in places:
        coefficients = {(p, q): expected[h, w, p, q] for p in range(P + 1) for q in range(-p, p + 1)}
        radiance = reference.radiance(coefficients, theta, phi)
        assert np.abs(radiance.imag).max() < 1e-12
        np.testing.assert_allclose(evaluate_basis(views, P) @ maps[:, h, w], radiance.real, atol=1e-12)
        for p in range(P + 1):
            for q in range(1, p + 1):  # as `Shrm` says, without the sign of Condon and Shortley
                value = (-1) ** q * expected[h, w, p, q] * np.sqrt(2)
                assert maps[p * (p + 1) + q, h, w] == pytest.approx(value.real, abs=1e-12)
                assert maps[p * (p + 1) - q, h, w] == pytest.approx(-value.imag, abs=1e-12)


@pytest.mark.parametrize("method", ["fft", "product"])
def test_local_maps_equal_integration_over_angles(method):
    light, brdf, views = random_light(), random_brdf(), random_views(4)
    shrm = build_shrm(light, brdf, ROWS, COLUMNS, method=method)
    expected = integrate_local(light, brdf, shrm, views)
    np.testing.assert_allclose(explicit_maps(shrm, views), expected, atol=1e-12 * np.abs(expected).max())


@both_styles
@pytest.mark.parametrize("frame", ["local", "global"])
def test_kernels_are_within_1e5(device, frame):
    light, brdf, views = random_light(), random_brdf(), random_views(4)
    shrm = build_shrm(light, brdf, ROWS, COLUMNS, method="device", device=device, frame=frame)
    assert shrm.maps_khwc.dtype == np.float32
    exact = build_shrm(light, brdf, ROWS, COLUMNS, frame=frame)
    got, expected = explicit_maps(shrm, views), explicit_maps(exact, views)
    np.testing.assert_allclose(got, expected, atol=1e-5 * np.abs(expected).max())
    if frame == "local":
        true = integrate_local(light, brdf, shrm, views)
        np.testing.assert_allclose(got, true, atol=1e-5 * np.abs(true).max())


@pytest.mark.parametrize("channels", [(1, 1), (3, 1), (1, 3), (3, 3)])
@pytest.mark.parametrize("method", ["fft", "product"])
def test_global_maps_equal_local_ones(channels, method):
    light, brdf = random_light(channels=channels[0]), random_brdf(channels=channels[1])
    local = build_shrm(light, brdf, ROWS, COLUMNS, method=method)
    world = build_shrm(light, brdf, ROWS, COLUMNS, frame="global", method=method)
    size = np.abs(local.maps_khwc).max()
    np.testing.assert_allclose(to_global(local).maps_khwc, world.maps_khwc, atol=1e-12 * size)
    np.testing.assert_allclose(to_local(world).maps_khwc, local.maps_khwc, atol=1e-12 * size)
    assert local.channels == max(channels)
    for view in random_views(3):
        np.testing.assert_allclose(view_map(world, view), local_view(local, view), atol=1e-12 * size)


@pytest.mark.parametrize("method", ["fft", "product"])
@pytest.mark.parametrize("frame", ["local", "global"])
def test_float32_is_within_1e5(method, frame):
    light, brdf = random_light(), random_brdf()
    single = build_shrm(light, brdf, ROWS, COLUMNS, frame=frame, method=method, dtype=np.float32)
    assert single.maps_khwc.dtype == np.float32
    exact = build_shrm(light, brdf, ROWS, COLUMNS, frame=frame)
    np.testing.assert_allclose(single.maps_khwc, exact.maps_khwc, atol=1e-5 * np.abs(exact.maps_khwc).max())
    with pytest.raises(InputError, match="float32 or float64"):
        build_shrm(light, brdf, ROWS, COLUMNS, dtype=np.float16)


def test_global_maps_are_smooth_over_the_poles():
    """Local coefficients of q > 0 turn about a pole with the azimuth; maps of one view run through it."""
    light, brdf = random_light(channels=1), random_brdf()
    local = build_shrm(light, brdf, 200, 40)
    view = random_views(1)[0]
    top = view_map(to_global(local), view)[0, :, 0]
    assert np.ptp(top) < 0.05 * np.abs(view_map(to_global(local), view)).max()
    assert np.ptp(local.maps_khwc[3, 0]) > np.abs(local.maps_khwc[3, 0]).max()


def test_a_phong_map_is_the_light_blurred():
    light, brdf = random_light(), brdf_coefficients(Phong(9), F, 0)
    shrm = build_shrm(light, brdf, 16)
    l = np.repeat(np.arange(F + 1), 2 * np.arange(F + 1) + 1)
    expected = synthesize_latlong(lobe_factors(9, F)[l, None] * light.coeffs_kc, 16, 32)
    np.testing.assert_allclose(explicit_maps(shrm, random_views(1))[0], expected, atol=1e-12)


def test_a_lambert_map_is_irradiance():
    light = random_light()
    shrm = build_shrm(light, brdf_coefficients(Lambert(), 2, 0), 16)
    normals = grid_directions(16, 32).reshape(-1, 3)
    expected = evaluate_irradiance(light, normals).reshape(16, 32, 3) / np.pi
    np.testing.assert_allclose(explicit_maps(shrm, random_views(1))[0], expected, atol=1e-12)


def test_turned_light_turns_the_map():
    """One global map serves a light that turns: the view turns back."""
    light, brdf = random_light(), random_brdf()
    turn = rotation_matrix("euler", (20.0, 50.0, -70.0))
    blocks = rotation_blocks(turn, F)
    turned = np.concatenate([blocks[l] @ light.coeffs_kc[l * l : (l + 1) ** 2] for l in range(F + 1)])
    view, places = random_views(1)[0], grid_directions(ROWS, COLUMNS).reshape(-1, 3)
    expected = view_map(build_shrm(Light(turned), brdf, ROWS, COLUMNS, frame="global"), view).reshape(-1, 3)
    still = build_shrm(light, brdf, 4 * F, frame="global")
    # The map of a view is band-limited to F + P, so its own coefficients give it anywhere.
    coeffs = project_latlong(view_map(still, view @ turn), F + P)
    np.testing.assert_allclose(evaluate_basis(places @ turn, F + P) @ coeffs, expected, atol=1e-10)


@pytest.mark.parametrize(
    ("brdf", "degree", "order"), [(Microfacet(0.5), 24, 12), (KajiyaKay(8), 24, 12), (Phong(20), 24, 0)]
)
def test_real_reflectances_come_near_integration(brdf, degree, order):
    """Against the formula itself, under a smooth light: what is left is the order's own error."""
    light = random_light(4, channels=1)
    shrm = build_shrm(light, brdf_coefficients(brdf, degree, order), 8, 2 * degree + 1, frame="global")
    nodes, weights = product_rule(60, sphere=True)
    radiance = weights[:, None] * (evaluate_basis(nodes, 4) @ light.coeffs_kc)
    view = random_views(1)[0]
    central = grid_directions(*shrm.maps_khwc.shape[1:3]).reshape(-1, 3)
    truth = integrate_directions(nodes, radiance, brdf, central, view).reshape(8, -1, 1)
    error = np.linalg.norm(view_map(shrm, view) - truth) / np.linalg.norm(truth)
    assert error < 0.05  # microfacets end at the horizon with an edge, of which P = 12 lacks 0.15% of the energy


@every_width
@pytest.mark.parametrize("channels", [1, 3])
def test_waves_become_columns_at_every_width(device, channels):
    """Against the sum as written, at columns that fold by four, by two and not at all, around whole vectors."""
    rng = np.random.default_rng(9)
    for height, count, orders, columns in (
        (1, 1, 1, 1),
        (2, 4, 2, 6),
        (3, 1, 5, 60),
        (2, 4, 4, 64),
        (1, 4, 9, 68),
        (2, 1, 8, 61),
    ):
        shape = height, count, orders, channels
        sums_hkmc = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
        beta_w = 1.5 * np.pi - 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
        waves_mw = np.exp(1j * np.outer(np.arange(orders), beta_w))
        expected = np.einsum("hkmc,mw->khwc", sums_hkmc.astype(np.complex128), waves_mw).real
        bound = (orders + 4) * 2.0**-23 * np.abs(sums_hkmc).sum(axis=2).max()
        np.testing.assert_allclose(expand_orders(sums_hkmc, columns, "device", device), expected, atol=bound)


def test_orders_beyond_the_columns_look_like_coarser_ones():
    """A global map has F + P orders, of which narrow maps hold fewer."""
    rng = np.random.default_rng(10)
    for columns in (1, 2, 3, 4, 7, 8):
        sums_hkmc = rng.standard_normal((2, 1, 9, 1)) + 1j * rng.standard_normal((2, 1, 9, 1))
        expected = expand_orders(sums_hkmc, columns, "product")
        np.testing.assert_allclose(expand_orders(sums_hkmc, columns, "fft"), expected, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_sizes_at_the_edge(method, device):
    for light, brdf, rows, columns in ((0, 0, 1, 1), (0, 2, 1, 3), (3, 1, 1, 7), (2, 3, 7, 5)):
        shrm = build_shrm(
            random_light(light), random_brdf(light, brdf), rows, columns, method=method, device=device, frame="global"
        )
        assert shrm.maps_khwc.shape == ((brdf + 1) ** 2, rows, columns, 3)
        exact = to_global(build_shrm(random_light(light), random_brdf(light, brdf), rows, columns, method="product"))
        np.testing.assert_allclose(shrm.maps_khwc, exact.maps_khwc, atol=2e-5)


def test_what_cannot_be_is_refused():
    light, brdf = random_light(), random_brdf()
    for bad, said in (
        ({"method": "magic"}, "method must be one of"),
        ({"width": 12}, "more than 12 columns"),
        ({"method": "device"}, "needs an open device"),
        ({"frame": "sideways"}, "frame must be one of"),
    ):
        with pytest.raises(InputError, match=said):
            build_shrm(light, brdf, 8, **bad)
    with pytest.raises(InputError, match="1 row and column"):
        build_shrm(light, brdf, 0, 4)
    with pytest.raises(InputError, match="must be finite"):
        Shrm(np.full((1, 2, 2, 1), np.nan), "local", 0)
    with pytest.raises(InputError, match="square"):
        Shrm(np.zeros((2, 2, 2, 1)), "local", 0)
    with pytest.raises(InputError, match="float32 or float64"):
        Shrm(np.zeros((1, 2, 2, 2)), "local", 0)
    with pytest.raises(InputError, match="global reflection map"):
        view_map(build_shrm(light, brdf, 8), np.array([0.0, 0.0, 1.0]))
