"""Glossy operators coded by clustered PCA, and what they show of a lobe: ``python -m benchmarks.glossy``.

PSNR of operators has their largest entry as the peak; that of radiance the brightest, at vertices that face the eye,
over some eyes and a clear sky. The armadillo is left out where ``CLRELIGHT_DATA`` is not set.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from clrelight.dataset import CoefficientMap
from clrelight.device import Device, open_device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.quadrature import product_rule
from clrelight.sampling import make_pattern
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Brdf, Ggx, Phong
from clrelight.transfer.lobes import frames_of
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.operator_plan import EXTENSIONS, extension_matrix
from clrelight.transfer.operators import transfer_operators
from clrelight.transfer.reflection import reflect

CLUSTERS = (1, 4, 16)
COMPONENTS = 8
GLOSSY = Phong(diffuse=0.3, specular=0.6, exponent=20.0)
VIEWS = 12
FRAMES = (("global", "global"), ("local", "global"), ("local", "local"))
SHOWN: dict[str, Brdf] = {
    "phong:5": Phong(exponent=5.0),
    "phong:20": Phong(exponent=20.0),
    "phong:100": Phong(exponent=100.0),
    "ggx:0.5": Ggx(specular=0.9, roughness=0.5),
}
NODES = 40


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--samples", type=click.IntRange(min=16), default=1024, show_default=True, help="Rays of each vertex.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(samples: int, markdown: Path | None) -> None:
    """Measure clustered PCA of operators, and how much of a lobe operators show."""
    show_parts({"lobes": lobe_table(), "cpca": cpca_table(samples, open_device(None))}, markdown)


def scenes() -> dict[str, Surface]:
    """Return a bumpy sphere and a torus of some thousand vertices, and the armadillo where its file is at hand."""
    import trimesh

    ball = trimesh.creation.icosphere(4)
    x, y, z = ball.vertices.T
    ball.vertices *= (1.0 + 0.12 * np.sin(7.0 * x) * np.sin(7.0 * y) * np.sin(7.0 * z))[:, None]
    found = {"bumpy sphere": ball, "torus": trimesh.creation.torus(1.0, 0.4, 64, 40)}
    made = {
        name: Surface(mesh.vertices, np.asarray(mesh.faces, np.int32), np.asarray(mesh.vertex_normals), name=name)
        for name, mesh in found.items()
    }
    if "CLRELIGHT_DATA" in os.environ:
        made["armadillo"] = read_mesh(Path(os.environ["CLRELIGHT_DATA"]) / "meshes" / "armadillo.ply")
    return made


def cpca_table(samples: int, device: Device) -> Table:
    """Return PSNRs of operators and of radiance for each scene, frame and number of clusters."""
    light_kc = cr.sky_light("clear", 35, 120, degree=4).coeffs_kc
    eyes_i3 = make_pattern("uniform", VIEWS, sphere=True)
    rows = []
    for name, surface in scenes().items():
        for views, light in FRAMES:
            tangents = None if views == "global" else frames_of(surface.normals_v3)[:, 0]
            framed = replace(surface, tangents_v3=tangents)
            operators = transfer_operators(framed, GLOSSY, 4, samples=samples, light_frame=light)
            exact_iv = radiance(operators, light_kc, eyes_i3)
            row = [name, str(surface.n_vertex), f"{views}, {light}", f"{operators.coeffs_khwc.nbytes / 1e6:.1f}"]
            for clusters in CLUSTERS:
                encoded = cr.encode(operators, "cpca", clusters=clusters, components=COMPONENTS, device=device)
                decoded = replace(cr.decode(encoded, device=device), surface=framed)
                of_entries = psnr(decoded.coeffs_khwc - operators.coeffs_khwc, np.abs(operators.coeffs_khwc).max())
                of_radiance = psnr(radiance(decoded, light_kc, eyes_i3) - exact_iv, exact_iv.max())
                row.append(f"{of_entries:.1f}, {of_radiance:.1f} ({encoded.encoded_bytes / 1000:.0f})")
            rows.append(row)
    wanted = [f"{clusters} cluster{'s' * (clusters > 1)}" for clusters in CLUSTERS]
    return ["scene", "vertices", "views, light in frames", "MB", *wanted], rows


def radiance(operators: CoefficientMap, light_kc: np.ndarray, eyes_i3: np.ndarray) -> np.ndarray:
    """Return what the vertices that face each eye send to it, one after the other."""
    normals_v3 = operators.surface.normals_v3
    return np.concatenate([reflect(operators, light_kc, eye).reshape(-1)[normals_v3 @ eye > 0.05] for eye in eyes_i3])


def psnr(error: np.ndarray, peak: float) -> float:
    return float(10.0 * np.log10(peak**2 / np.mean(np.square(error, dtype=np.float64))))


def lobe_table() -> Table:
    """Return how near operators come to the reflection of band-limited light, and how large their entries are."""
    nodes_q3, weights_q = product_rule(NODES)
    rows = []
    for name, brdf in SHOWN.items():
        for degree in (4, 5):
            basis_qk = evaluate_basis(nodes_q3, degree)
            right_qk = basis_qk * (weights_q * nodes_q3[:, 2])[:, None]
            exact_qk = np.concatenate(
                [
                    brdf.gloss(nodes_q3[None], part_q3[:, None])[..., 0] @ right_qk
                    for part_q3 in np.array_split(nodes_q3, 16)
                ]
            )
            moments_ok = (basis_qk * weights_q[:, None]).T @ exact_qk
            row = [name, f"{coefficient_count(degree)}×{coefficient_count(degree)}"]
            for extension in EXTENSIONS:
                operator_ok = extension_matrix(degree, extension) @ moments_ok
                error_qk = basis_qk @ operator_ok - exact_qk
                share = (weights_q @ error_qk**2).sum() / (weights_q @ exact_qk**2).sum()
                row.append(f"{-10.0 * np.log10(share):.1f} dB, {np.square(operator_ok).sum():.3g}")
            rows.append(row)
    return ["BRDF", "operator", *EXTENSIONS], rows


if __name__ == "__main__":
    main()
