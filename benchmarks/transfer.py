"""Print how fast transfer is beside its own bare rays, and how it compares with a path tracer.

``python -m benchmarks.transfer MESH`` times, in turns: the rays of all vertices as Embree itself takes them, trimesh's
calls on some of them, and whole jobs from the mesh file to the file of functions. With ``--mitsuba`` a scene with holes
is compared with Mitsuba's path tracer (extra ``peers``).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from clrelight.harmonics.basis import evaluate_basis
from clrelight.surface import Surface
from clrelight.threads import on_one_thread
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import make_samples
from clrelight.transfer.transport import transfer_vertices

SAMPLES, DEGREE, BOUNCES = 1024, 4, 3
SOME_RAYS = {"intersects_any": 200_000, "intersects_location": 20_000, "intersects_any, no Embree": 500}
ALBEDO, PATHS, PATH_BOUNCES = 0.6, 1024, (0, 1, 3)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("mesh", type=click.Path(exists=True, dir_okay=False))
@click.option("--rounds", type=click.IntRange(min=1), default=5, show_default=True)
@click.option("--mitsuba", "is_traced", is_flag=True, help="Compare with a path tracer.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(mesh: str, rounds: int, is_traced: bool, markdown: Path | None) -> None:
    """Time transfer beside bare rays, and compare it with a path tracer."""
    parts = {"rays": speed_table(mesh, rounds)}
    if is_traced:
        parts["paths"] = path_table()
    show_parts(parts, markdown)


def speed_table(mesh: str, rounds: int) -> Table:
    """Return seconds of wall clock and processor, rays a second, and the ratio to the same bare rays."""
    surface = read_mesh(mesh)
    starts_r3, directions_r3 = rays_of(surface)
    scene = RayScene(surface)
    count = len(starts_r3)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out.h5")

        def job(kind: str) -> Callable[[], object]:
            asked = {"kind": kind, "degree": DEGREE, "samples": SAMPLES, "bounces": BOUNCES}
            return lambda: cr.transfer(mesh, out=out, report=cr.Report(), **asked)

        runs: dict[str, tuple[Callable[[], object], int]] = {
            "Embree's occlusion, the same rays": (lambda: scene.blocked(starts_r3, directions_r3), count),
            "`transfer`, shadowed, file to file": (job("shadowed"), count),
            f"`transfer`, {BOUNCES} bounces, file to file": (job("interreflected"), count),
            **trimesh_runs(surface, starts_r3, directions_r3, scene),
        }
        for run, _ in runs.values():
            run()  # once before
        wall, processor = {name: [] for name in runs}, {name: [] for name in runs}
        for _ in range(rounds):
            for name, (run, _) in runs.items():
                since, used = time.perf_counter(), time.process_time()
                run()
                wall[name].append(time.perf_counter() - since)
                processor[name].append(time.process_time() - used)
    rows, bare = [], next(iter(runs))
    for name, (_, n_ray) in runs.items():
        best, used = float(np.median(wall[name])), float(np.median(processor[name]))
        per_ray = best / n_ray / (np.median(wall[bare]) / count)
        per_ray_used = used / n_ray / (np.median(processor[bare]) / count)
        rate = f"{n_ray / best / 1e6:.3g}"
        rows.append([name, f"{n_ray:,}", f"{best:.3g}", rate, f"{per_ray:.3g}", f"{per_ray_used:.3g}"])
    return ["", "rays", "seconds", "million rays a second", "time of a ray, to the first", "of the processor"], rows


def rays_of(surface: Surface) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return all rays that shadowed transfer traces, one vertex's after the other's."""
    scene = RayScene(surface)
    directions_s3 = make_samples(SAMPLES).directions_s3.astype(np.float32)
    with on_one_thread():
        vertex_r, sample_r = np.nonzero(surface.normals_v3.astype(np.float32) @ directions_s3.T > 0)
    return scene.starts_v3[vertex_r], directions_s3[sample_r]


def trimesh_runs(
    surface: Surface, starts_r3: NDArray[np.float32], directions_r3: NDArray[np.float32], scene: RayScene
) -> dict[str, tuple[Callable[[], object], int]]:
    """Return trimesh's calls on some of the rays, spread over all vertices."""
    import trimesh
    from trimesh.ray import ray_triangle

    # In the scene's own units, so that the rays are the same.
    local_v3 = surface.vertices_v3 - 0.5 * (surface.vertices_v3.min(axis=0) + surface.vertices_v3.max(axis=0))
    held = trimesh.Trimesh(local_v3 / surface.diagonal, surface.faces_f3, process=False)
    runs: dict[str, tuple[Callable[[], object], int]] = {}
    for name, wanted in SOME_RAYS.items():
        chosen_r = np.linspace(0, len(starts_r3) - 1, wanted).astype(np.intp)
        some_r3 = starts_r3[chosen_r].astype(np.float64), directions_r3[chosen_r].astype(np.float64)
        tracer = ray_triangle.RayMeshIntersector(held) if "no Embree" in name else held.ray
        call = getattr(tracer, name.partition(",")[0])
        try:
            call(some_r3[0][:10], some_r3[1][:10])
        except ImportError:  # rtree
            click.echo(f"note: trimesh's {name} needs a package that is not installed, and is left out", err=True)
            continue
        runs[f"trimesh `{name}`"] = (lambda call=call, some_r3=some_r3: call(*some_r3)), wanted
    return runs


def path_table() -> Table:
    """Return how far vertices' radiance is from Mitsuba's, in their joint noise, at 0, 1, ... bounces."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    scene = holed_scene()
    chosen_v = np.flatnonzero(clear_vertices(scene))[::21]
    light_k = np.array([3.0, 0.6, 1.0, -0.5, 0.4, 0.2, -0.3, 0.3, 0.4])
    rows = []
    for bounces in PATH_BOUNCES:
        ours_av = np.stack([_ours(scene, bounces, light_k, seed)[chosen_v] for seed in range(4)])
        theirs_av = np.stack([_theirs(mi, scene, chosen_v, bounces, light_k, seed) for seed in range(4)])
        noise = np.sqrt(theirs_av.var(axis=0, ddof=1).mean() / 4)
        own = np.sqrt(ours_av.var(axis=0, ddof=1).mean() / 4)
        off_v = ours_av.mean(axis=0) - theirs_av.mean(axis=0)
        apart, joint = np.sqrt(np.mean(off_v**2)), np.hypot(noise, own)
        level = theirs_av.mean()
        rows.append(
            [
                *(str(bounces), f"{level:.4f}", f"{off_v.mean() / level:+.2%}"),
                *(f"{apart / level:.2%}", f"{noise / level:.2%}", f"{own / level:.2%}", f"{apart / joint:.2f}"),
            ]
        )
    headers = ["bounces", "mean radiance", "means apart", "rms apart", "noise of Mitsuba's", "of ours", "rms to noise"]
    return headers, rows


def holed_scene() -> Surface:
    """Return a room of fine cells with a hole in its lid and a ball in it, seen from within."""
    from tests.meshes import icosphere, joined, open_box, quad

    lid = [
        quad((-1, 1, 1), (2, 0, 0), (0, -0.7, 0), 8, 24),
        quad((-1, -0.3, 1), (2, 0, 0), (0, -0.7, 0), 8, 24),
        quad((-1, 0.3, 1), (0.7, 0, 0), (0, -0.6, 0), 8, 8),
    ]
    return joined(open_box(24), *lid, icosphere(4, 0.3, (0.2, -0.1, 0.4)), name="room")


def clear_vertices(scene: Surface) -> NDArray[np.bool_]:
    """Return which vertices lie on no edge of the room: there a path tracer's point is on one face or the other."""
    at_v3 = np.abs(scene.vertices_v3 - [0, 0, 0.5])
    on_ball_v = np.linalg.norm(scene.vertices_v3 - [0.2, -0.1, 0.4], axis=1) < 0.31
    flat_v = np.sum(at_v3 > np.array([0.99, 0.99, 0.49]), axis=1) == 1
    near_v = np.sum(at_v3 > np.array([0.95, 0.95, 0.45]), axis=1) == 1
    return on_ball_v | (flat_v & near_v)


def _ours(scene: Surface, bounces: int, light_k: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    from dataclasses import replace

    gray = replace(scene, albedo_vc=np.full((scene.n_vertex, 1), ALBEDO, np.float32))
    coeffs_kvc = transfer_vertices(gray, 2, "interreflected", SAMPLES, bounces=bounces, seed=seed)
    return light_k @ coeffs_kvc[:, :, 0].astype(np.float64)


def _theirs(
    mi: object, scene: Surface, chosen_v: NDArray[np.intp], bounces: int, light_k: NDArray[np.float64], seed: int
) -> NDArray[np.float64]:
    """Return the radiance that leaves vertices along their normals, by paths."""
    mesh = mi.Mesh("room", scene.n_vertex, len(scene.faces_f3), has_vertex_normals=True, props=_bsdf(mi))
    held = mi.traverse(mesh)
    held["vertex_positions"] = scene.vertices_v3.astype(np.float32).ravel()
    held["vertex_normals"] = scene.normals_v3.astype(np.float32).ravel()
    held["faces"] = scene.faces_f3.astype(np.uint32).ravel()
    held.update()
    sensors = {}
    face_v = np.empty(scene.n_vertex, np.intp)
    face_v[scene.faces_f3.ravel()] = np.repeat(np.arange(len(scene.faces_f3)), 3)
    for number, vertex in enumerate(chosen_v):
        # A hair beside the vertex: a ray to the vertex itself may pass between its faces.
        centre_3 = scene.vertices_v3[scene.faces_f3[face_v[vertex]]].mean(axis=0)
        point_3 = scene.vertices_v3[vertex] + 0.02 * (centre_3 - scene.vertices_v3[vertex])
        normal_3 = scene.normals_v3[vertex]
        look = mi.ScalarTransform4f().look_at(
            origin=(point_3 + 1e-3 * normal_3).tolist(), target=point_3.tolist(), up=_beside(normal_3).tolist()
        )
        sensors[f"s{number:05}"] = {"type": "radiancemeter", "to_world": look, "film": _film(1)}
    whole = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": bounces + 2, "rr_depth": 1000},
            "light": {"type": "envmap", "bitmap": mi.Bitmap(_picture(light_k)), "scale": 1.0},
            "mesh": mesh,
            "sensor": {"type": "batch", "film": _film(len(chosen_v)), **sensors},
        }
    )
    return np.asarray(mi.render(whole, spp=PATHS, seed=seed), np.float64).reshape(-1)[: len(chosen_v)]


def _film(width: int) -> dict[str, object]:
    box = {"type": "box"}
    return {"type": "hdrfilm", "width": width, "height": 1, "rfilter": box, "pixel_format": "luminance"}


def _bsdf(mi: object) -> object:
    props = mi.Properties()
    props["mesh_bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": ALBEDO}})
    return props


def _picture(light_k: NDArray[np.float64], height: int = 512) -> NDArray[np.float32]:
    """Return the light as Mitsuba lays out the sphere: y up, and -z in the middle of the turn's beginning."""
    v, u = (np.indices((height, 2 * height)) + 0.5) / height
    theta, phi = np.pi * v, np.pi * u
    directions_p3 = np.stack(
        [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], axis=-1
    ).reshape(-1, 3)
    radiance_p = evaluate_basis(directions_p3, 2) @ light_k
    return np.repeat(radiance_p.reshape(height, 2 * height, 1), 3, axis=2).astype(np.float32)


def _beside(normal_3: NDArray[np.float64]) -> NDArray[np.float64]:
    axis_3 = np.eye(3)[int(np.abs(normal_3).argmin())]
    return np.cross(normal_3, axis_3)


if __name__ == "__main__":
    main()
