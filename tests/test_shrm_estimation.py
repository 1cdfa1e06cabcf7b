"""Reflectances from pictures under known light: their equations, errors, files, and which material it is."""

import json

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.expanded import ExpandedBrdf, own_energy, read_coefficients, write_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.named import make_brdf, parse_brdf
from clrelight.brdf.radial import Lambert, Mirrored, Phong
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.jobs.reflection.build import build_reflection
from clrelight.jobs.reflection.estimate import estimate_reflectance, observe, recognise_material
from clrelight.jobs.reflection.render import render_reflection
from clrelight.lighting.light import Light
from clrelight.lighting.sky import sky_light
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.estimation import estimate_brdf
from clrelight.shrm.explicit import explicit_maps
from clrelight.shrm.lookup import view_sphere
from clrelight.shrm.observation import Observations, make_terms, observation_matrix
from clrelight.shrm.prefilter import build_shrm
from clrelight.shrm.recognition import library_pictures, make_library, recognise
from clrelight.shrm.record import grid_directions

F, P = 5, 2
VIEWS = ((0.0, -1.0, 0.3), (1.0, 0.2, 0.1), (-0.4, 0.5, -0.9))


def noise(channels=1, seed=0, degree=F):
    return Light(np.random.default_rng(seed).standard_normal(((degree + 1) ** 2, channels)))


def ball(light, brdf, views=VIEWS, *, degree=F, order=P, size=48):
    """Return observations of a sphere: what coefficients up to F and P make of the light, no map in between."""
    rho = brdf_coefficients(brdf, degree, order)
    terms = make_terms(degree, order)
    radiance, central, towards = [], [], []
    for view in views:
        sphere = view_sphere(size, np.asarray(view), brdf.centre)
        facing = sphere.normals_n3 @ sphere.view_3 > 0.2
        central.append(sphere.central_n3[facing])
        towards.append(np.broadcast_to(sphere.view_3, central[-1].shape))
        values = []
        for c in range(max(light.channels, rho.channels)):
            matrix = observation_matrix(light.coeffs_kc[:, min(c, light.channels - 1)], terms, central[-1], towards[-1])
            values.append(matrix @ terms.unknowns(rho.rho_lpqc)[:, min(c, rho.channels - 1)])
        radiance.append(np.stack(values, axis=1))
    return Observations(*(np.concatenate(each) for each in (radiance, central, towards)))


def noisy(seen, part, seed=1):
    size = np.sqrt((seen.radiance_nc**2).mean())
    rng = np.random.default_rng(seed)
    more = seen.radiance_nc + part * size * rng.standard_normal(seen.radiance_nc.shape)
    return Observations(more, seen.central_n3, seen.views_n3)


@pytest.mark.parametrize("brdf", [Microfacet(0.5), KajiyaKay(3), Phong(5)], ids=["facets", "fibres", "lobe"])
def test_equations_are_those_of_reflection_maps(brdf):
    light, rho = noise(), brdf_coefficients(brdf, F, P)
    maps = explicit_maps(build_shrm(light, rho, 4, 12, frame="global"), np.array([[0.36, -0.48, 0.8]]))[0]
    central = grid_directions(4, 12).reshape(-1, 3)
    views = np.broadcast_to([0.36, -0.48, 0.8], central.shape)
    terms = make_terms(F, P)
    matrix = observation_matrix(light.coeffs_kc[:, 0], terms, central, views)
    np.testing.assert_allclose(matrix @ terms.unknowns(rho.rho_lpqc)[:, 0], maps.ravel(), atol=1e-12)
    assert np.sum(terms.unknowns(rho.rho_lpqc) ** 2) == pytest.approx(own_energy(rho.rho_lpqc)[0])
    np.testing.assert_allclose(terms.coefficients(terms.unknowns(rho.rho_lpqc)), rho.rho_lpqc, atol=1e-15)


def scattered(light, brdf, count=1500):
    """Return observations of as many views as points."""
    rng = np.random.default_rng(7)
    central, views = (unit(rng.standard_normal((count, 3))) for _ in range(2))
    terms, rho = make_terms(F, P), brdf_coefficients(brdf, F, P)
    values = terms.unknowns(rho.rho_lpqc)
    channels = [observation_matrix(light_k, terms, central, views) for light_k in light.coeffs_kc.T]
    count = max(rho.channels, light.channels)
    radiance = [channels[min(c, light.channels - 1)] @ values[:, min(c, rho.channels - 1)] for c in range(count)]
    return Observations(np.stack(radiance, axis=1), central, views)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("prior", ["typical", "none"])
@pytest.mark.parametrize("brdf", [Microfacet(0.5), SKIN], ids=["facets", "skin"])
def test_many_views_give_the_reflectance_back(brdf, prior):
    light = noise(3)
    found = estimate_brdf(scattered(light, brdf), light.coeffs_kc, F, P, ridge=0.0, prior=prior)
    expected = np.broadcast_to(brdf_coefficients(brdf, F, P).rho_lpqc, (F + 1, P + 1, P + 1, 3))
    np.testing.assert_allclose(found.coefficients.rho_lpqc, expected, atol=1e-9)
    assert found.residual < 1e-6  # of squares that cancel
    assert found.condition_l.min() == 1.0


def test_one_view_is_filled_by_what_is_typical():
    """A sphere's picture sees two of four dimensions: what others of its kind are like tells most of the rest."""
    light, brdf = noise(), Microfacet(0.5)
    expected, seen = brdf_coefficients(brdf, F, P).rho_lpqc, noisy(ball(light, brdf, VIEWS[:1]), 0.01)
    off = {}
    for prior in ("typical", "none"):
        found = estimate_brdf(seen, light.coeffs_kc, F, P, prior=prior)
        off[prior] = np.linalg.norm(found.coefficients.rho_lpqc - expected) / np.linalg.norm(expected)
    assert off["typical"] < 0.15 < 0.4 * off["none"], off


def test_stated_errors_are_those_of_noise():
    light, brdf = noise(), Microfacet(0.5)
    seen, expected = scattered(light, brdf, 600), brdf_coefficients(brdf, F, P).rho_lpqc
    off, said = np.zeros(F + 1), np.zeros(F + 1)
    twice = np.where(np.arange(P + 1) == 0, 1.0, 2.0)
    for seed in range(8):
        found = estimate_brdf(noisy(seen, 0.02, seed), light.coeffs_kc, F, P, ridge=0.0)
        square = (found.coefficients.rho_lpqc - expected) ** 2
        off += np.einsum("lpqc,q->l", square, twice) / own_energy(expected)[0]
        said += found.error_l**2
    np.testing.assert_allclose(np.sqrt(off / said), 1.0, atol=0.5)
    assert found.residual == pytest.approx(0.02, rel=0.2)


def test_validation_damps_noise():
    """Under soft light without a ridge noise takes over; the ridge that validation prefers keeps it down."""
    light, brdf = sky_light("overcast", degree=F), Microfacet(0.5)
    light = Light(light.coeffs_kc[:, :1] + 1e-3)
    seen, expected = ball(light, brdf, VIEWS[:1]), brdf_coefficients(brdf, F, P).rho_lpqc

    def off(ridge):
        found = estimate_brdf(noisy(seen, 0.02), light.coeffs_kc, F, P, ridge=ridge, prior="none")
        return np.linalg.norm(found.coefficients.rho_lpqc - expected) / np.linalg.norm(expected)

    assert off(None) < min(1.0, 0.1 * off(0.0))


def test_sharp_light_tells_more():
    """The same noise hurts least under a lamp, more under light with some detail, most under an overcast sky."""
    brdf, errors, conditions = Microfacet(0.5), {}, {}
    lights = {
        "lamp": Light(evaluate_basis(np.array([[0.36, -0.48, 0.8]]), F).T),
        "overcast": Light(sky_light("overcast", degree=F).coeffs_kc[:, :1]),
    }
    for name, light in lights.items():
        seen = noisy(ball(light, brdf), 0.01)
        found = estimate_brdf(seen, light.coeffs_kc, F, P)
        expected = brdf_coefficients(brdf, F, P).rho_lpqc
        errors[name] = np.linalg.norm(found.coefficients.rho_lpqc - expected) / np.linalg.norm(expected)
        conditions[name] = found.condition_l.max()
    assert errors["lamp"] < 0.5 * errors["overcast"]
    assert conditions["lamp"] < 2.0 < conditions["overcast"]


def test_files_make_reflectances(tmp_path):
    rho = brdf_coefficients(Microfacet(0.5), F, P)
    write_coefficients(tmp_path / "a.json", rho)
    held = make_brdf(str(tmp_path / "a.json"))
    np.testing.assert_array_equal(held.coefficients.rho_lpqc, rho.rho_lpqc)
    assert (held.centre, held.channels, held.has_azimuth, held.is_radial) == ("reflection", 1, True, False)
    np.testing.assert_array_equal(brdf_coefficients(held, 3, 1).rho_lpqc, rho.cut(3, 1).rho_lpqc)
    assert brdf_coefficients(held, 40, 9).degree == F
    angles = np.random.default_rng(0).random((3, 20))
    np.testing.assert_array_equal(held.evaluate(*angles), rho.evaluate(*angles))
    assert held.evaluate(angles[0][:, None], angles[1], np.zeros(1)).shape == (20, 20, 1)
    light = noise()
    made = build_reflection(light, held, epsilon=0.1)
    again = build_reflection(light, Microfacet(0.5), degree=made.degree, order=made.order)
    np.testing.assert_allclose(made.maps_khwc, again.maps_khwc, atol=2e-3 * np.abs(again.maps_khwc).max())
    nodes, weights = product_rule(20, sphere=True)
    central, view = grid_directions(3, 12).reshape(-1, 3), np.array([[0.0, 0.6, 0.8]])
    radiance = weights[:, None] * (evaluate_basis(nodes, F) @ light.coeffs_kc)
    expected = explicit_maps(build_shrm(light, rho, 3, 12, frame="global"), view)[0].reshape(-1, 1)
    np.testing.assert_allclose(integrate_directions(nodes, radiance, held, central, view), expected, atol=1e-10)
    assert isinstance(held, CentredBrdf)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda held: held.pop("rho_lpqc"), "is damaged"),
        (lambda held: held.update(rho_lpqc=[[1, 2], [3]]), "is damaged"),
        (lambda held: held.update(rho_lpqc=[[[["a"]]]]), "is damaged"),
        (lambda held: held.update(centre="half"), "is damaged"),
        (lambda held: held.update(config=3), "is damaged"),
        (lambda held: held.update(energy=[1, 2]), "coefficients of a reflectance are"),
        (lambda held: held.update(rho_lpqc=[[[[float("nan")]]]], energy=[1.0]), "finite"),
        (lambda held: held.update(clrelight_schema="fit/1"), "expected brdf-coefficients/1"),
    ],
)
def test_damaged_files_are_refused(tmp_path, change, said):
    file = tmp_path / "a.json"
    write_coefficients(file, brdf_coefficients(Microfacet(0.5), 2, 1))
    held = json.loads(file.read_text())
    change(held)
    file.write_text(json.dumps(held))
    with pytest.raises(InputError, match=said) as refused:
        read_coefficients(file)
    assert "\n" not in str(refused.value)
    for content in (b"", b"\xff\xfe\x00", b"[" * 100_000, b"{}", b"[1]"):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"no JSON|no coefficients"):
            read_coefficients(file)
    with pytest.raises(InputError, match="cannot read"):
        make_brdf(str(tmp_path / "none.json"))


def test_texts_name_reflectances():
    assert parse_brdf("microfacet:0.3") == Microfacet(0.3)
    assert parse_brdf("phong:8") == Phong(8.0)
    assert parse_brdf("skin") is SKIN
    for text, said in (
        ("microfacet:x", "takes a number behind the colon"),
        ("microfacet:0", "above 0"),
        ("phong:-1", "at least 0"),
        ("skin:3", "takes no number"),
        ("chrome", "a reflectance is lambert"),
    ):
        with pytest.raises(InputError, match=said):
            parse_brdf(text)


def test_lambert_about_the_mirrored_view_is_lambert():
    theta_i, theta_o, phi = np.random.default_rng(0).random((3, 50)) * 3
    from clrelight.brdf.centred import reflection_cosines

    expected = np.maximum(reflection_cosines(theta_i, theta_o, phi).light_normal, 0.0) / np.pi
    np.testing.assert_allclose(Mirrored(Lambert()).evaluate(theta_i, theta_o, phi)[:, 0], expected, atol=1e-12)


MATERIALS = {
    **{f"microfacet:{s:g}": Microfacet(s) for s in (0.2, 0.3, 0.5)},
    **{f"phong:{s}": Phong(s) for s in (4, 16, 64)},
    "lambert": Lambert(),
    "skin": SKIN,
}


@pytest.mark.parametrize("components", [None, 5])
def test_materials_are_recognised_whatever_the_exposure(components):
    light = noise(3, degree=8)
    library = make_library(MATERIALS, 8, 3, components)
    assert library.share_k.sum() == pytest.approx(1.0, abs=1e-12 if components is None else 0.05)
    np.testing.assert_allclose(library.axes_kx @ library.axes_kx.T, np.eye(len(library.axes_kx)), atol=1e-12)
    pictures = None
    for name, brdf in MATERIALS.items():
        alike = Mirrored(brdf) if isinstance(brdf, Lambert) else brdf
        seen = ball(light, alike, VIEWS[:1], degree=8, order=3, size=32)
        pictures = pictures or library_pictures(library, seen, light.coeffs_kc)
        dim = Observations(3e-3 * noisy(seen, 0.02).radiance_nc, seen.central_n3, seen.views_n3)
        found = recognise(library, dim, light.coeffs_kc, pictures)
        assert found.names[0] == name, (name, found)
        assert (np.diff(found.distance_n) >= 0).all()


def test_jobs_take_pictures(tmp_path):
    """From a sphere's picture to coefficients, to its name, and to another light."""
    light = noise(3, degree=8)
    shrm = build_reflection(light, Microfacet(0.5), degree=8, order=3)
    pictures = [render_reflection(shrm, size=64, view=view) for view in VIEWS]
    report = estimate_reflectance(pictures, light, tmp_path / "a.json", views=VIEWS, degree=8, order=3, samples=1500)
    expected = brdf_coefficients(Microfacet(0.5), 8, 3).rho_lpqc
    off = np.linalg.norm(read_coefficients(tmp_path / "a.json").rho_lpqc - expected) / np.linalg.norm(
        np.broadcast_to(expected, (9, 4, 4, 3))
    )
    assert off < 0.1
    assert (len(report.facts["condition"]), report.facts["points"]) == (9, 1500)
    found = recognise_material(pictures[0], light, MATERIALS, degree=8, samples=1500)
    assert found.names[0] == "microfacet:0.5"
    gray = observe([picture.mean(axis=2, keepdims=True) for picture in pictures], views=VIEWS)
    assert gray.radiance_nc.shape == (4000, 1)


def test_normals_say_the_shape(tmp_path):
    from clrelight.images import write_image

    light, view = noise(degree=8), (0.0, 0.0, 1.0)
    shrm = build_reflection(light, Microfacet(0.5), degree=8, order=3)
    sphere = view_sphere(64, np.asarray(view))
    write_image(tmp_path / "n.exr", sphere.picture(sphere.normals_n3).astype(np.float32))
    picture = render_reflection(shrm, size=64, view=view)
    found = estimate_reflectance(picture, light, normals=tmp_path / "n.exr", degree=4, order=2)
    plain = estimate_reflectance(picture, light, views=[view], degree=4, order=2)
    np.testing.assert_allclose(found.coefficients.rho_lpqc, plain.coefficients.rho_lpqc, atol=1e-4)


def test_what_cannot_be_is_refused(tmp_path):
    light, picture = noise(), np.ones((16, 16, 1), np.float32)
    for words, said in (
        ({"pictures": picture[:8]}, "a sphere fills a square"),
        ({"pictures": []}, "no picture"),
        ({"pictures": [picture, np.ones((16, 16, 3))]}, "gray and others"),
        ({"pictures": np.full((16, 16, 1), np.nan)}, "not finite"),
        ({"pictures": np.ones((16, 16))}, r"1 or 3\)"),
        ({"views": [(0, 0, 1), (1, 0, 0)]}, "as many views"),
        ({"views": [(0, 0, 0)]}, "not 0"),
        ({"degree": 9}, "the light has degree 5"),
        ({"degree": 101}, "must be 0 to"),
        ({"order": 33}, "must be 0 to"),
        ({"order": 12}, "do not tell the"),
        ({"ridge": -1.0}, "at least 0"),
        ({"centre": "half"}, "centre must be one of"),
        ({"out": tmp_path / "a.h5"}, "written as .json"),
        ({"light": Light(np.eye(36)[:, :1])}, "nothing of degree 1"),
        ({"light": Light(np.zeros((36, 1)))}, "nothing can be told"),
        ({"prior": "flat"}, "a prior is one of"),
        ({"samples": 0}, "samples must be"),
        ({"transfer": "log"}, "transfer"),
    ):
        asked = {"pictures": picture, "light": light, "degree": 5, "order": 1, **words}
        with pytest.raises(InputError, match=said) as refused:
            estimate_reflectance(**asked)
        assert "\n" not in str(refused.value)
    for materials, components, said in (
        ({"skin": SKIN}, None, "two at least"),
        ({"skin": SKIN, "fibres": KajiyaKay()}, None, "share a central direction"),
        ({"skin": SKIN, "a": Microfacet()}, 2, "have 1 to 1"),
    ):
        with pytest.raises(InputError, match=said):
            recognise_material(picture, light, materials, degree=5, order=1, components=components)
    with pytest.raises(InputError, match="black"):
        recognise_material(0 * picture, light, {"skin": SKIN, "a": Microfacet()}, degree=5, order=1)
    assert not list(tmp_path.iterdir())
    assert ExpandedBrdf(brdf_coefficients(SKIN, 2, 1)).to_config()["brdf"] == "lafortune"
