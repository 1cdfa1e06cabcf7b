"""Reflectances about their central directions, and the energy of their coefficients."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients, Resolution, brdf_coefficients
from clrelight.brdf.lafortune import SKIN, Lafortune
from clrelight.brdf.named import BRDF_NAMES, make_brdf
from clrelight.brdf.radial import Lambert, Phong, lobe_factors
from clrelight.errors import InputError
from clrelight.lighting.irradiance import cosine_coefficients
from clrelight.shrm.orders import minimal_orders
from tests.reference import shrm as reference

ENERGIES = {
    0.1: (0.8756, 0.9446, 0.9767, 0.9865, 0.9910, 0.9934),
    0.3: (0.8694, 0.9482, 0.9793, 0.9883, 0.9922, 0.9943),
    0.5: (0.8521, 0.9508, 0.9781, 0.9864, 0.9903, 0.9925),
}


def angles(count=4000, seed=0):
    rng = np.random.default_rng(seed)
    theta_i, theta_o, phi = rng.random((3, count)) * np.array([[np.pi], [np.pi], [2 * np.pi]])
    return theta_i, theta_o, phi


def vectors(theta_i, theta_o, phi):
    """Return light, view and normal in a frame whose z is the reflection vector, the light's azimuth 0.3."""

    def unit(theta, azimuth):
        return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)

    return unit(theta_i, 0.3), unit(theta_o, 0.3 + phi), unit(theta_o / 2, 0.3 + phi)


@pytest.mark.parametrize("s", [0, 1, 2.5, 32, 512])
def test_factors_of_a_lobe_are_integrals(s):
    for l in (0, 1, 2, 5, 12, 30):
        expected = (s + 1) * quad(lambda x, l=l: x**s * eval_legendre(l, x), 0, 1, limit=400)[0]
        assert lobe_factors(s, 30)[l] == pytest.approx(expected, abs=1e-9)


def test_factors_follow_the_paper_and_lambert():
    s, l = 512, np.arange(31)
    np.testing.assert_allclose(lobe_factors(s, 30), np.exp(-l * l / (2 * s)), atol=0.03)
    np.testing.assert_allclose(lobe_factors(1, 30), cosine_coefficients(30) / np.pi, atol=1e-15)


@pytest.mark.parametrize("brdf", [Phong(7.5), Lambert(), Phong(0)], ids=["phong", "lambert", "hemisphere"])
def test_closed_forms_are_those_of_the_sums(brdf):
    class Plain(CentredBrdf):  # not known to be a lobe
        id, has_azimuth = "plain", False

        def evaluate(self, theta_i, theta_o, phi):
            return brdf.evaluate(theta_i, theta_o, phi)

        def to_config(self):
            return {}

    summed = brdf_coefficients(Plain(), 12, 2, Resolution(2000, 8, 1))
    closed = brdf_coefficients(brdf, 12, 2)
    np.testing.assert_allclose(summed.rho_lpqc, closed.rho_lpqc, atol=2e-3)
    np.testing.assert_allclose(summed.energy_c, closed.energy_c, rtol=2e-3)


def test_microfacets_are_those_of_vectors():
    theta_i, theta_o, phi = angles()
    got = Microfacet(0.4).evaluate(theta_i, theta_o, phi)[:, 0]
    np.testing.assert_allclose(got, reference.microfacet(0.4, *vectors(theta_i, theta_o, phi)), atol=1e-12)
    assert got.max() > 0.3


def test_skin_is_that_of_vectors():
    theta_i, theta_o, phi = angles()
    light, view, normal = vectors(theta_i, theta_o, phi)
    side = np.cross(normal, np.array([0.1, 0.9, 0.2]))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    axes = np.stack([side, np.cross(normal, side), normal], axis=-2)
    light, view = (np.einsum("nij,nj->ni", axes, each) for each in (light, view))
    got = SKIN.evaluate(theta_i, theta_o, phi)
    for c in range(3):
        lobes = [[row[c] for row in lobe] for lobe in SKIN.lobes_j3c]
        expected = reference.lafortune(SKIN.diffuse_c[c], lobes, light, view)
        np.testing.assert_allclose(got[:, c], expected, rtol=1e-9, atol=1e-12)
    assert np.isfinite(got).all()


def test_views_run_to_the_horizon():
    """About the reflection vector theta_o reaches pi, where the view grazes: half of the lobe is left."""
    there = Microfacet(0.3).evaluate(np.array([0.05, 0.05]), np.array([np.pi, np.pi]), np.array([0.1, np.pi]))
    assert there[0, 0] > 0.7
    assert there[1, 0] == 0.0


@pytest.mark.parametrize("sigma", ENERGIES)
def test_energy_of_microfacets(sigma):
    shares_lp = brdf_coefficients(Microfacet(sigma), 100, 5).shares()[..., 0]
    np.testing.assert_allclose(shares_lp[-1], ENERGIES[sigma], atol=1e-3)


@pytest.mark.parametrize(
    ("sigma", "orders"), [(0.1, (23, 2)), (0.2, (11, 2)), (0.3, (7, 2)), (0.4, (5, 2)), (0.5, (4, 2))]
)
def test_least_orders_of_microfacets(sigma, orders):
    found = minimal_orders(brdf_coefficients(Microfacet(sigma), 40, 4), 0.03)
    assert np.abs(np.subtract(found, orders)).max() <= 1


def test_energy_of_skin_and_fibres():
    np.testing.assert_allclose(brdf_coefficients(SKIN, 60, 4).shares()[-1, -1], (0.974, 0.967, 0.971), atol=2e-3)
    fibres = brdf_coefficients(KajiyaKay(32), 60, 8)
    assert fibres.shares()[-1, -1, 0] == pytest.approx(0.9733, abs=2e-4)
    assert not fibres.has_azimuth


def zonal(l, theta):
    return np.sqrt((2 * l + 1) / (4 * np.pi)) * eval_legendre(l, np.cos(theta))


@pytest.mark.parametrize("sigma", [3e-3, 6e-4])
def test_narrow_microfacets_become_a_mirror(sigma):
    """``integral rho dL`` tends to ``N . V`` at the mirrored view: half vectors have a quarter of the lights' area."""
    found_lp = brdf_coefficients(Microfacet(sigma), 6, 3).rho_lpqc[:, :, 0, 0]
    for p in range(4):
        whole = quad(lambda t, p=p: np.cos(t / 2) * zonal(p, t) * np.sin(t), 0, np.pi)[0]
        expected_l = [2 * np.pi * zonal(l, 0.0) * whole for l in range(7)]
        np.testing.assert_allclose(found_lp[:, p], expected_l, atol=2e-3 + 30 * sigma, rtol=0)


@pytest.mark.parametrize("exponent", [4e3])
def test_narrow_fibres_become_a_ridge(exponent):
    found_lp = brdf_coefficients(KajiyaKay(exponent), 6, 3).rho_lpqc[:, :, 0, 0]
    for l in range(7):
        for p in range(4):
            along = quad(lambda t, l=l, p=p: zonal(l, t) * zonal(p, t) * np.sin(t) ** 2, 0, np.pi)[0]
            expected = 4 * np.pi**2 * np.sqrt(2 * np.pi / exponent) * along
            assert found_lp[l, p] == pytest.approx(expected, abs=30 / exponent * np.sqrt(1 / exponent) * 4 * np.pi)


@pytest.mark.parametrize("exponent", [1e8, 1e300, 1.7e308])
def test_phong_of_any_exponent_has_an_energy(exponent):
    held = brdf_coefficients(Phong(exponent), 3, 0)
    np.testing.assert_allclose(held.rho_lpqc[:, 0, 0, 0], np.sqrt(2 * np.arange(4) + 1), rtol=1e-6)
    assert held.energy_c[0] == pytest.approx(exponent, rel=1e-6)


@pytest.mark.parametrize("brdf", [Microfacet(1e-6), KajiyaKay(1e6)])
def test_lobes_that_no_sum_sees_are_refused(brdf):
    """Their maps were black, without a word."""
    with pytest.raises(InputError, match="too narrow"):
        brdf_coefficients(brdf, 3, 2)
    brdf_coefficients(brdf, 3, 2, Resolution(8, 8, 8))  # the caller's own choice
    with pytest.raises(InputError, match=r"they take 8e\+150 angles"):  # not all its digits
        brdf_coefficients(Microfacet(1e-300), 3, 2)


def test_coefficients_give_the_reflectance_back():
    theta_i, theta_o, phi = angles(300)
    made = brdf_coefficients(Microfacet(0.5), 20, 10)
    error = made.evaluate(theta_i, theta_o, phi) - Microfacet(0.5).evaluate(theta_i, theta_o, phi)
    lit = np.sin(theta_i) * np.sin(theta_o)
    assert np.sqrt((lit * error[:, 0] ** 2).sum() / lit.sum()) < 0.02


def test_band_limited_coefficients_are_exact():
    """What is a sum of few harmonics comes back from the three sums to rounding."""
    rng = np.random.default_rng(3)
    rho = rng.standard_normal((7, 4, 4, 1))
    l, p, q = np.indices(rho.shape[:3])
    rho[q > np.minimum(l, p)] = 0.0
    made = BrdfCoefficients(rho, np.ones(1))

    class Sum(CentredBrdf):
        id = "sum"

        def evaluate(self, theta_i, theta_o, phi):
            theta_i, theta_o, phi = np.broadcast_arrays(theta_i, theta_o, phi)
            values = made.evaluate(theta_i.ravel(), theta_o.ravel(), phi.ravel())
            return values.reshape(*theta_i.shape, 1)

        def to_config(self):
            return {}

    again = brdf_coefficients(Sum(), 6, 3, Resolution(40, 40, 12))
    np.testing.assert_allclose(again.rho_lpqc, rho, atol=1e-12)
    twice = np.where(np.arange(4) == 0, 1.0, 2.0)
    assert again.energy_c[0] == pytest.approx(float(np.einsum("lpqc,q->", rho**2, twice)), rel=1e-12)
    values = made.evaluate(*angles(50))[:, 0]
    np.testing.assert_allclose(values, reference.reflectance(rho[..., 0], *angles(50)), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "numbers", "said"),
    [
        ("microfacet", {"sigma": 0.0}, "above 0"),
        ("microfacet", {"sigma": -0.1}, "above 0"),
        ("microfacet", {"sigma": float("nan")}, "above 0"),
        ("microfacet", {"exponent": 3}, "takes sigma, got exponent"),
        ("phong", {"exponent": -1}, "at least 0"),
        ("kajiya-kay", {"exponent": -1}, "at least 0"),
        ("lambert", {"sigma": 0.2}, "takes no number"),
        ("velvet", {}, "a reflectance is lambert"),
        ("none.brdf", {}, "cannot read"),
    ],
)
def test_bad_reflectances_are_refused(name, numbers, said):
    with pytest.raises(InputError, match=said) as refused:
        make_brdf(name, **numbers)
    assert "\n" not in str(refused.value)


def test_bad_lobes_and_orders_are_refused():
    with pytest.raises(InputError, match="exponents of Lafortune"):
        Lafortune((0.1,), (((-1.0,), (1.0,), (-2.0,)),))
    with pytest.raises(InputError, match="as many channels as kd"):
        Lafortune((0.1, 0.2, 0.3), (((-1.0,), (1.0,)),))
    with pytest.raises(InputError, match="kd at least 0"):
        Lafortune((-0.1,), ())
    for degree, order in ((-1, 0), (101, 0), (3, -1), (3, 33)):
        with pytest.raises(InputError, match="must be 0 to"):
            brdf_coefficients(Microfacet(), degree, order)
    with pytest.raises(InputError, match="less than 1 - epsilon"):
        minimal_orders(brdf_coefficients(Microfacet(0.1), 5, 1), 0.03)
    with pytest.raises(InputError, match="epsilon"):
        minimal_orders(brdf_coefficients(Lambert(), 5, 1), 0.0)


def test_every_name_makes_one():
    theta_i, theta_o, phi = angles(20)
    for name in BRDF_NAMES:
        brdf = make_brdf(name)
        assert brdf.evaluate(theta_i, theta_o, phi).shape == (20, brdf.channels)
        assert brdf.to_config()["brdf"] == brdf.id
