"""Print what subspaces hold of pictures, and how far lights are off that are found: ``python -m benchmarks.variation``.

Spheres are rendered (`tests.reference.spheres`, which imports nothing of the package) and coded as 8-bit sRGB; objects
and their lights are those of CLRELIGHT_DATA.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import click
import numpy as np
import OpenImageIO as oiio
import scipy.io
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from clrelight.images import read_image
from clrelight.threads import on_one_thread
from clrelight.variation.factoring import lights_from_surface
from clrelight.variation.maps import SampleReader
from clrelight.variation.shading import lights_from_normals
from tests.meshes import icosphere
from tests.reference.spheres import beckmann, lamps, mirrored_lamp, phong, photograph_spheres, srgb_codes

DATA_VARIABLE = "CLRELIGHT_DATA"
LIGHTS, SIZE, BALL = 16, (150, 200), (120.3, 80.6, 40.2)
WINDOWS = ((0.3, 0.5, 0.81), (-0.6, 0.1, 0.79))
HARD = {
    **{"texture": 0.5, "table": 0.4, "windows": WINDOWS, "shade": 0.25},
    **{"exposure": 0.35, "noise": 0.01, "blur": 1.0, "diffuse": 0.15},
}
SPHERES: dict[str, tuple[Any, dict[str, Any]]] = {
    "radius 40 pixels, textured table": (BALL, {}),
    "radius 66": ((100.2, 74.3, 66.4), {}),
    "radius 30": ((60.2, 70.3, 30.4), {}),
    "radius 18": ((60.2, 70.3, 18.4), {}),
    "radius 12": ((60.2, 70.3, 12.4), {}),
    "noise of 3%": (BALL, {"noise": 0.03}),
    "blur of 2 pixels": (BALL, {"blur": 2.0}),
    "rough: highlights of 12°": (BALL, {"roughness": 0.35}),
    "two windows in it": (BALL, {"windows": WINDOWS}),
    "under-exposed, a seventh": (BALL, {"exposure": 0.15}),
    "shines less than it is matte": (BALL, {"diffuse": 0.4}),
    "mirrors the table in its rim": (BALL, {"table": 0.5}),
    "all of it: texture, windows, table, shade, noise": (BALL, HARD),
    "Beckmann's gloss, 8°": (BALL, {"gloss": beckmann, "roughness": 0.1}),
    "Phong's gloss, plastic": (BALL, {"gloss": phong, "roughness": 60.0, "diffuse": 0.2}),
    "chrome, a round lamp of 6°": (BALL, {"gloss": mirrored_lamp, "roughness": 6.0, "table": 0.3}),
    "white cloth, radius 20": ((60.2, 70.3, 20.4), {"ground": 0.8, "texture": 0.1}),
    "dark cloth, radius 20": ((60.2, 70.3, 20.4), {"ground": 0.1, "texture": 0.08, "diffuse": 0.2}),
    "JPEG of quality 75": (BALL, {"jpeg": 75}),
    "JPEG of quality 75, radius 18": ((60.2, 70.3, 18.4), {"jpeg": 75}),
    "camera near, focal length 400 pixels": ((140.3, 90.6, 35.2), {"focal": 400.0}),
    "two spheres": ([(50.3, 70.6, 28.2), (140.4, 60.1, 24.3)], {}),
    "matte, by shading": (BALL, {"matte": True, "diffuse": 0.7, "room": 0.0}),
}
_PIXELS, _SURFACE_PIXELS = 8_000, 20_000


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the tables of a page.")
def main(markdown: Path | None) -> None:
    """Measure subspaces, and lights by spheres and by objects."""
    if DATA_VARIABLE not in os.environ:
        raise click.UsageError(f"{DATA_VARIABLE} must name the folder that holds stacks and meshes")
    root = Path(os.environ[DATA_VARIABLE])
    parts = {"sphere-lights": sphere_table()}
    with on_one_thread():
        parts["object-lights"] = object_table(root / "stacks")
    parts["subspaces"] = subspace_table(root)
    show_parts(parts, markdown)


def apart(found_i3: NDArray[np.float64], known_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return degrees between vectors of any length."""
    length_i = np.linalg.norm(found_i3, axis=1) * np.linalg.norm(known_i3, axis=1)
    return np.degrees(np.arccos(np.clip(np.sum(found_i3 * known_i3, axis=1) / np.maximum(length_i, 1e-12), -1, 1)))


def sphere_table() -> Table:
    """Return how far lights by one sphere are off, the sphere being looked for."""
    rows = []
    for name, (sphere, how) in SPHERES.items():
        spheres = sphere if isinstance(sphere, list) else [sphere]
        lights_i3 = lamps(LIGHTS, 1, least=0.3 if how.get("matte") else 0.1)
        rendering = {key: value for key, value in how.items() if key != "jpeg"}
        codes_ihwc = srgb_codes(photograph_spheres(lights_i3, SIZE, spheres, seed=1, **rendering))
        if "jpeg" in how:
            codes_ihwc = through_jpeg(codes_ihwc, how["jpeg"])
        report = cr.Report()
        options = {"kind": "matte" if how.get("matte") else "glossy", "focal": how.get("focal"), "count": len(spheres)}
        try:
            found = cr.find_lights(cr.LightStack(codes_ihwc, lights_i3, 255.0, "srgb"), report=report, **options)
        except cr.InputError:
            rows.append([name, "not found", "", "", "", ""])
            continue
        off_i = apart(found.directions_i3, lights_i3)[found.directions_i3.any(axis=1)]
        x, y, radius = min(report.facts["spheres"], key=lambda each: abs(each[0] - spheres[0][0]))
        told = [row["uncertain"] for row in report.facts["lights"] if row["uncertain"] is not None]
        rows.append(
            [
                *(name, f"{np.hypot(x - spheres[0][0], y - spheres[0][1]):.2f}", f"{radius - spheres[0][2]:+.2f}"),
                *(f"{np.median(off_i):.2f}", f"{off_i.max():.2f}", f"{np.median(told):.2f}" if told else "–"),
            ]
        )
    headers = ["sphere", "centre off, pixels", "radius off, pixels", "lights off, median °", "at most °", "told ±°"]
    return headers, rows


def through_jpeg(codes_ihwc: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return photographs as a camera's JPEG files of a quality hold them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.jpg"
        coded = []
        for codes_hwc in codes_ihwc:
            spec = oiio.ImageSpec(codes_hwc.shape[1], codes_hwc.shape[0], 3, "uint8")
            spec.attribute("Compression", f"jpeg:{quality}")
            out = oiio.ImageOutput.create(str(path))
            if not (out.open(str(path), spec) and out.write_image(np.ascontiguousarray(codes_hwc)) and out.close()):
                raise RuntimeError(out.geterror())
            coded.append(read_image(path))
    return np.stack(coded)


def object_table(root: Path) -> Table:
    """Return how far lights by an object are off those that were measured."""
    rows = []
    for name in ("cat", "bear", "pot1"):
        folder = root / "diligent" / f"{name}PNG"
        stack = cr.ingest(folder, report=cr.Report())
        normals = scipy.io.loadmat(folder / "Normal_gt.mat")["Normal_gt"]
        rows.append(_object_row(f"DiLiGenT {name}, normals scanned", stack, normals, None))
    for label, folder, lights, curve in (
        ("`loewenkopf`, normals found", root / "loewenkopf" / "jpg", root / "loewenkopf" / "dirs.lp", "srgb"),
        ("`psbox_cat`, normals found", root / "psbox_cat", None, "linear"),
    ):
        stack = cr.ingest(folder, lights=lights, transfer=curve, report=cr.Report())
        found = cr.normals(stack, report=cr.Report())
        rows.append(_object_row(label, stack, found.normals_hw3, found.albedo_hwc.mean(axis=2)))
    headers = ["object", "lights", "known normals, median °", "known normals and albedo", "nothing known", "uneven by"]
    return headers, rows


def _object_row(
    name: str, stack: cr.LightStack, normals_hw3: NDArray, albedo_hw: NDArray[np.floating] | None
) -> list[str]:
    height, width, channel = stack.image_shape
    grey_ihw = SampleReader(stack).linear(np.asarray(stack.images_ihwc).reshape(stack.n_light, -1, channel))
    grey_ihw = grey_ihw.mean(axis=0).reshape(stack.n_light, height, width)
    inside_hw = np.linalg.norm(normals_hw3, axis=2) > 0.5
    if stack.mask_hw is not None:
        inside_hw &= stack.mask_hw
    pixels = np.flatnonzero(inside_hw)[:: max(1, int(inside_hw.sum()) // _PIXELS)]
    samples_ip = grey_ihw.reshape(stack.n_light, -1)[:, pixels]
    normals_p3 = normals_hw3.reshape(-1, 3)[pixels]
    plain_i = apart(lights_from_normals(samples_ip, normals_p3).lights_i3, stack.directions_i3)
    painted = "–"
    if albedo_hw is not None:
        found = lights_from_normals(samples_ip, normals_p3, albedo_hw.ravel()[pixels])
        painted = f"{np.median(apart(found.lights_i3, stack.directions_i3)):.1f}"
    step = max(1, int(np.sqrt(inside_hw.sum() / _SURFACE_PIXELS)))
    together = lights_from_surface(grey_ihw[:, ::step, ::step], inside_hw[::step, ::step])
    off_i = apart(together.lights_i3, stack.directions_i3)
    return [
        *(name, str(stack.n_light), f"{np.median(plain_i):.1f}", painted),
        *(f"{np.median(off_i):.1f}", f"{together.uneven:.0%}"),
    ]


def subspace_table(root: Path) -> Table:
    """Return the share of energy and of variance that each subspace holds."""
    loewenkopf = root / "stacks" / "loewenkopf"
    sources = {
        "a sphere": icosphere(5),
        "bunny": cr.read_mesh(root / "meshes" / "probulator_bunny.obj", up="y"),
        "`loewenkopf`": cr.ingest(
            loewenkopf / "jpg", lights=loewenkopf / "dirs.lp", transfer="linear", report=cr.Report()
        ),
        "DiLiGenT cat": cr.ingest(root / "stacks" / "diligent" / "catPNG", report=cr.Report()),
    }
    held = {name: cr.compare_subspaces(each, report=cr.Report()) for name, each in sources.items()}
    names = list(dict.fromkeys(each.name for found in held.values() for each in found))
    names.sort(key=[each.name for each in held["a sphere"]].index)
    epstein = {"mean and 3 components": "– / .90", "mean and 5 components": "– / .94"}
    rows = []
    for name in names:
        cells = [next((each for each in found if each.name == name), None) for found in held.values()]
        shares = ["–" if each is None else f"{each.energy:.3f} / {each.variance:.3f}" for each in cells]
        rows.append([name, *shares, epstein.get(name, "")])
    return ["energy / variance", *held, "Epstein's faces"], rows


if __name__ == "__main__":
    main()
