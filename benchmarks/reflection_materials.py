"""Tables of docs/shrm.md beside its figures: maps of equal number, codecs, and what pictures tell of materials."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.reflection import AXES, PROBE, shown
from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.measured import MeasuredBrdf, read_brdf
from clrelight.brdf.radial import Lambert, Mirrored, Phong
from clrelight.harmonics.basis import evaluate_basis
from clrelight.lighting.light import Light
from clrelight.lighting.sky import sky_light
from clrelight.reproduction.reflection_stage import Stage, paints, relative
from clrelight.shrm.convolution import complex_light, estimate_material, reflected_coefficients
from clrelight.shrm.estimation import estimate_brdf
from clrelight.shrm.lookup import view_sphere
from clrelight.shrm.observation import Observations, Terms, make_terms, observation_matrix
from clrelight.shrm.recognition import library_pictures, make_library, recognise

DEGREE, ORDER = 10, 3
VIEWS = ((0.0, -1.0, 0.3), (1.0, 0.2, 0.1), (-0.4, 0.5, -0.9))
NOISE = 0.01
_SIZE, _DRAWS, _LOUD = 32, 5, 2.0
Table = tuple[list[str], list[list[str]]]


def storage(data: Path) -> Table:
    """Return errors of fibres by as many maps: coefficients of q = 0, angles of a texture, and Cabral's twelve."""
    stage, brdf, view, size = Stage.grace(data), KajiyaKay(32.0), (0.0, -1.0, 0.25), 64
    truth = stage.truth(brdf, view, size)
    twelve = relative([stage.icosahedron(brdf, view, size)], [truth])
    counts = (6, 9, 12, 18, 24, 33)
    ours = [relative([stage.sphere(stage.shrm(brdf, 30, n - 1), view, size)], [truth]) for n in counts]
    texture = [relative([stage.texture(brdf, view, size, n)], [truth]) for n in counts]
    rows = [["orders P = maps − 1", *(f"{error:.4f}" for error in ours)]]
    rows.append(["3-D texture of so many angles", *(f"{error:.4f}" for error in texture)])
    rows.append(["Cabral's maps", "", "", f"{twelve:.4f}", "", "", ""])
    return ["maps", *map(str, counts)], rows


def codecs(data: Path) -> Table:
    """Return bytes and errors of a reflection map by codecs and by principal axes, from ``shrm bench``."""
    found = shown(["shrm", "bench", str(data / "probes" / PROBE), "--axes", AXES, "--table", "codecs"])["rows"]
    rows = [[r["codec"], f"{r['bytes']}", f"{r['bits']:.3f}", f"{r['error']:.1e}"] for r in found["codecs"]]
    for count, share in enumerate(found["principal"][:-1], start=1):
        if count in (1, 2, 3, 5):
            rows.append([f"{count} principal axes", "", "", f"{max(1.0 - share, 0.0) ** 0.5:.1e}"])
    return ["", "bytes", "bits a coefficient", "error"], rows


def lights(data: Path) -> dict[str, Light]:
    """Return a lamp, Grace Cathedral and an overcast sky, gray and of one norm."""
    grace = Stage.grace(data).light.coeffs_kc[: (DEGREE + 1) ** 2]
    made = {
        "lamp": evaluate_basis(np.array([[0.36, -0.48, 0.8]]), DEGREE).T,
        "Grace Cathedral": grace @ np.array([[0.2126], [0.7152], [0.0722]]),
        "overcast sky": sky_light("overcast", degree=DEGREE).coeffs_kc[:, :1],
    }
    return {name: Light(coeffs_kc / np.linalg.norm(coeffs_kc)) for name, coeffs_kc in made.items()}


def library(data: Path) -> dict[str, CentredBrdf]:
    """Return materials to tell apart: paints, lobes and facets of several widths, skin, matte."""
    named: dict[str, CentredBrdf] = {name: MeasuredBrdf(read_brdf(file)) for name, file in paints(data).items()}
    named |= {f"phong {s}": Phong(float(s)) for s in (4, 8, 16, 32, 64)}
    named |= {f"microfacet {s:g}": Microfacet(s) for s in (0.1, 0.15, 0.2, 0.3, 0.4)}
    return named | {"skin": SKIN, "lambert": Mirrored(Lambert())}


def balls(light: Light, brdf: CentredBrdf, terms: Terms, views: tuple = VIEWS) -> Observations:
    """Return spheres of coefficients up to `DEGREE` and `ORDER` from some views."""
    values_jc = terms.unknowns(brdf_coefficients(brdf, DEGREE, ORDER).rho_lpqc)
    radiance, central, towards = [], [], []
    for view in views:
        sphere = view_sphere(_SIZE, np.asarray(view))
        facing_n = sphere.normals_n3 @ sphere.view_3 > 0.2
        central.append(sphere.central_n3[facing_n])
        towards.append(np.broadcast_to(sphere.view_3, central[-1].shape))
        matrix_nj = observation_matrix(light.coeffs_kc[:, 0], terms, central[-1], towards[-1])
        radiance.append(matrix_nj @ np.broadcast_to(values_jc, (len(terms), 3)))
    return Observations(*(np.concatenate(each) for each in (radiance, central, towards)))


def noisy(seen: Observations, part: float, seed: int) -> Observations:
    """Return observations with normal noise of a part of their RMS."""
    size = part * float(np.sqrt(np.mean(seen.radiance_nc**2)))
    noise_nc = size * np.random.default_rng(seed).standard_normal(seen.radiance_nc.shape)
    return Observations(seen.radiance_nc + noise_nc, seen.central_n3, seen.views_n3)


def _field_error(light: Light) -> float:
    """Return the error of microfacets, 0.3, of norm 1, by equal noise in each coefficient of the light field."""
    rho_lpq = brdf_coefficients(Microfacet(0.3), DEGREE, ORDER).rho_lpqc[..., 0]
    material_kj = np.zeros(((DEGREE + 1) ** 2, (ORDER + 1) ** 2), np.complex128)
    for l, p in np.ndindex(DEGREE + 1, ORDER + 1):
        for q in range(-min(l, p), min(l, p) + 1):
            material_kj[l * (l + 1) + q, p * (p + 1) + q] = rho_lpq[l, p, abs(q)]
    material_kj /= np.linalg.norm(material_kj)
    known_k = complex_light(light.coeffs_kc[:, 0])
    rng = np.random.default_rng(0)
    blocks = [each + 1e-3 * rng.standard_normal(each.shape) for each in reflected_coefficients(known_k, material_kj)]
    found = estimate_material(blocks, known_k).rho_kj
    # Of an isotropic material only n = q counts.
    return float(np.linalg.norm((found - material_kj)[material_kj != 0.0]))


def materials(data: Path) -> Table:
    """Return, under each light, what noise makes of a reflectance that is estimated, and how often materials are known.

    Estimated: microfacets, 0.3, from the whole light field (frequency-space-environment-maps, eq. 37), and from three
    spheres' pictures with 1% noise; recognised: each material of the library five times, of one picture with twice
    as much noise as radiance.
    """
    terms, known = make_terms(DEGREE, ORDER), library(data)
    table = make_library(known, DEGREE, ORDER)
    wanted = brdf_coefficients(Microfacet(0.3), DEGREE, ORDER).rho_lpqc
    rows = []
    for name, light in lights(data).items():
        seen = balls(light, Microfacet(0.3), terms)
        found = [estimate_brdf(noisy(seen, NOISE, seed), light.coeffs_kc, DEGREE, ORDER) for seed in range(3)]
        size = np.sqrt(3.0) * np.linalg.norm(wanted)
        off = np.mean([np.linalg.norm(each.coefficients.rho_lpqc - wanted) / size for each in found])
        right, pictures = 0, None
        for material, brdf in known.items():
            seen = balls(light, brdf, terms, VIEWS[:1])
            pictures = pictures or library_pictures(table, seen, light.coeffs_kc)
            for seed in range(_DRAWS):
                told = recognise(table, noisy(seen, _LOUD, seed), light.coeffs_kc, pictures)
                right += told.names[0] == material
        conditions = found[0].condition_l[[0, 1, 2, 3, 4, 6, 8, 10]]
        rows.append([name, *(f"{each:.3g}" for each in conditions), f"{_field_error(light):.3f}", f"{off:.3f}"])
        rows[-1].append(f"{right} of {_DRAWS * len(known)}")
    return [
        "light",
        *(f"l = {l}" for l in (0, 1, 2, 3, 4, 6, 8, 10)),
        "light field",
        "three pictures",
        "recognised",
    ], rows


TABLES: dict[str, Callable[[Path], Table]] = {"storage": storage, "codecs": codecs, "materials": materials}
