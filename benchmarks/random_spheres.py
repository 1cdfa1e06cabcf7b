"""How far lights are off that are found by spheres nobody tuned to: ``python -m benchmarks.random_spheres``.

Every scene is drawn at random from its seed: radius of 12 to 200 pixels, place (cut off by the picture's edge too),
gloss, lamp of 0 to 5 degrees, fill lamps that move with it, windows that stay, ground from dark to clipped, plain,
patterned or rough, the ball's shadow on it and its glow in the ball, colours, exposure, blur, noise, JPEG, curve,
camera. Rendered here, in float64 (`tests.reference.spheres` and NumPy), so that nothing of the package is in it.

A light is *good* within `GOOD` degrees. Beyond, the command has to say so: a light further off than `GOOD` and three of
its own standard deviations, and not in doubt, is *silent*.
"""

from __future__ import annotations

import resource
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

import clrelight as cr
from benchmarks.lighting import Table, show_parts
from benchmarks.random_sphere_scenes import draw_scene, photograph
from benchmarks.variation import apart

GOOD = 0.5
_CLASSES = {
    "0 to 20": (0.0, 20.0),
    "20 to 40": (20.0, 40.0),
    "40 to 80": (40.0, 80.0),
    "80 on": (80.0, np.inf),
    "all": (0.0, np.inf),
}
Array = NDArray[np.float64]


def judge(seed: int) -> dict[str, Any]:
    """Return how far a scene's lights are off, and what was told of them."""
    scene = draw_scene(seed)
    codes_ihwc = photograph(scene)
    told: dict[str, Any] = {"seed": seed, "radius": scene.spheres[0][2], "gloss": scene.gloss, "count": len(codes_ihwc)}
    report, since = cr.Report(), _spent()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = cr.find_lights(
                cr.LightStack(codes_ihwc, scene.lights_i3, 255.0, scene.transfer),
                report=report,
                count=len(scene.spheres),
                focal=scene.focal,
            )
    except cr.InputError as error:
        return told | {"refused": str(error), "seconds": _spent() - since}
    seen_i = found.directions_i3.any(axis=1)
    x, y, radius = min(report.facts["spheres"], key=lambda each: abs(each[0] - scene.spheres[0][0]))
    doubted = [row["uncertain"] if row["uncertain"] is not None else np.nan for row in report.facts["lights"]]
    return told | {
        "centre": [x - scene.spheres[0][0], y - scene.spheres[0][1], radius - scene.spheres[0][2]],
        "off": np.where(seen_i, apart(found.directions_i3, scene.lights_i3), np.nan).tolist(),
        "told": [float(each) for each in doubted],
        "doubtful": [bool(row.get("doubt")) for row in report.facts["lights"]],
        "notes": list(report.notes),
        "outline": report.facts["outlines"],
        "seconds": _spent() - since,
    }


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def table(seeds: Sequence[int]) -> Table:
    """Return what share of scenes and lights is good, by classes of radius."""
    told = []
    for seed in seeds:
        told.append(judge(seed))
        click.echo(_line(told[-1]), err=True)
    rows = []
    for name, (least, most) in _CLASSES.items():
        some = [each for each in told if least <= each["radius"] < most]
        found = [each for each in some if "off" in each]
        if not some:
            continue
        marks = np.concatenate([_marks(each) for each in found]) if found else np.zeros((0, 4))
        wholly = sum(bool(_marks(each)[:, 1].all()) for each in found)
        rows.append(
            [
                *(name, str(len(some)), str(len(some) - len(found)), str(wholly), str(len(marks))),
                *(f"{share:.1%}" for share in (marks[:, 1:].mean(axis=0) if len(marks) else np.zeros(3))),
                f"{np.quantile(marks[:, 0], 0.5):.2f}, {np.quantile(marks[:, 0], 0.95):.2f}" if len(marks) else "–",
            ]
        )
    headers = ["radius, pixels", "scenes", "refused", "all lights good", "lights", "good", "told of", "silent"]
    return [*headers, "off, median and 95% °"], rows


def _marks(told: dict[str, Any]) -> Array:
    """Return of each light found how far it is off, and whether it is good, told of, silent: (lights, 4)."""
    off_i, told_i, doubtful_i = (np.asarray(told[name], np.float64) for name in ("off", "told", "doubtful"))
    good_i = off_i <= GOOD
    told_of_i = ~good_i & ((doubtful_i > 0.0) | (off_i <= 3.0 * np.nan_to_num(told_i)))
    marks_i4 = np.stack([off_i, good_i, told_of_i, ~good_i & ~told_of_i], axis=1)
    return np.asarray(marks_i4[np.isfinite(off_i)])


def _line(told: dict[str, Any]) -> str:
    head = f"{told['seed']} radius {told['radius']:.1f}, {told['gloss']}, {told['count']} lights: "
    if "refused" in told:
        return head + told["refused"]
    marks = _marks(told)
    return head + (
        f"{np.median(marks[:, 0]):.2f}, at most {marks[:, 0].max():.2f}°, told ±{np.nanmedian(told['told']):.2f}°, "
        f"{int(marks[:, 2].sum())} told of, {int(marks[:, 3].sum())} silent, {told['seconds']:.1f} s of processor"
    )


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--first", type=int, default=0, show_default=True, help="Seed of the first scene.")
@click.option("--count", type=int, default=100, show_default=True, help="Scenes.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(first: int, count: int, markdown: Path | None) -> None:
    """Print how far lights of random scenes are off."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        show_parts({"random-spheres": table(range(first, first + count))}, markdown)


if __name__ == "__main__":
    main()
