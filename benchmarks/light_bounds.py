"""Print how well any estimator can tell lights by a sphere's highlights: ``python -m benchmarks.light_bounds``.

The bound of Cramér and Rao for the spheres of `benchmarks.variation`: no estimator without bias has a smaller variance
than the inverse of Fisher's information, ``J' W J``, W being one over the variance of each sample (noise, steps of
8-bit codes, what JPEG changes; clipped samples tell nothing) and J the renderer's derivatives by all that nobody
knows: the sphere's place and radius, blur, roughness, matte part and room, and of each photograph the light and the
highlight's height. The table behind is known, or unknown in each of its pixels but the same under all lamps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.lighting import Table, show_parts
from tests.reference.spheres import lamps, photograph_spheres, srgb_codes

Sphere = tuple[float, float, float]
Coder = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]

LIGHTS, ASKED = 16, 0.5
"""Photographs; degrees that lights are asked to be within."""
_REACH, _DRAWS, _BEHIND = 1.3, 400, 0.01
"""What is looked at, of the radius; draws of errors; share of the table in a pixel from which on it is unknown."""
_STEPS = {"roughness": 0.04, "diffuse": 0.02, "room": 0.01, "blur": 0.05}
_PIXELS, _ANGLE = 0.25, np.radians(0.5)
_CLIPPED, _CODE = 0.997, 1.0 / 255.0


def bound_table(
    rows: dict[str, tuple[Any, dict[str, Any]]], lights_i3: NDArray[np.float64], coder: Callable[[int], Coder]
) -> Table:
    """Return the least errors of each row that is one glossy sphere seen from afar, in degrees."""
    cells = []
    for name, (sphere, how) in rows.items():
        if isinstance(sphere, list) or how.get("matte") or how.get("focal"):
            continue
        told = []
        for is_known in (True, False):
            found = least_errors(sphere, how, lights_i3, is_known, coder(how["jpeg"]) if "jpeg" in how else None)
            told += [f"{found[0]:.2f}", f"{found[1]:.2f}", f"{found[2]:.0%}"]
        cells.append([name, *told])
        click.echo(" ".join(cells[-1]), err=True)
    above = f"above {ASKED:g}°"
    return ["sphere", "table known, median °", "at most °", above, "unknown, median °", "at most °", above], cells


def least_errors(
    sphere: Sphere, how: dict[str, Any], lights_i3: NDArray[np.float64], is_known: bool, coder: Coder | None = None
) -> tuple[float, float, float]:
    """Return the median and the greatest error of the lights in the mean over draws of errors that the bound allows.

    And in which share of the draws the greatest is above `ASKED`.

    Parameters
    ----------
    sphere : (float, float, float)
        x, y and radius in pixels; it is rendered in a picture just around it.
    how : dict
        Of `photograph_spheres`.
    lights_i3 : ndarray, shape (n_light, 3), float64
    is_known : bool
        Whether the table behind is known.
    coder : callable, optional
        What is done to codes after rendering.
    """
    view = _View(sphere, how, lights_i3)
    slopes_ipk, variance_ip = view.slopes(), view.variance(coder)
    weighted_ipk = slopes_ipk / np.sqrt(variance_ip)[:, :, None]
    if not is_known:
        _forget_table(weighted_ipk, view, variance_ip)
    columns_nk = weighted_ipk.reshape(-1, weighted_ipk.shape[2])
    scale_k = np.sqrt(np.sum(columns_nk**2, axis=0)) + 1e-12
    # Values that hardly show (the width of a highlight that is all clipped) get as much room as they want.
    information_kk = (columns_nk / scale_k).T @ (columns_nk / scale_k) + 1e-9 * np.eye(len(scale_k))
    covariance_kk = np.linalg.inv(information_kk) / np.outer(scale_k, scale_k)
    first = slopes_ipk.shape[2] - 3 * len(lights_i3)
    angles = np.ravel([[first + 3 * i, first + 3 * i + 1] for i in range(len(lights_i3))])
    drawn = np.random.default_rng(0).multivariate_normal(
        np.zeros(len(angles)), covariance_kk[np.ix_(angles, angles)], size=_DRAWS, method="eigh"
    )
    off_di = np.degrees(np.hypot(drawn[:, ::2], drawn[:, 1::2]))
    most_d = off_di.max(axis=1)
    return float(np.median(off_di, axis=1).mean()), float(most_d.mean()), float(np.mean(most_d > ASKED))


class _View:
    """A sphere in a picture just around it, and the renderer's derivatives there."""

    def __init__(self, sphere: Sphere, how: dict[str, Any], lights_i3: NDArray[np.float64]) -> None:
        x, y, radius = sphere
        side = int(2.0 * (_REACH + 0.15) * radius) + 8
        self.sphere = (side // 2 + x % 1.0, side // 2 + y % 1.0, radius)
        self.size, self.lights_i3 = (side, side), lights_i3
        self.noise = float(how.get("noise", 0.005))
        known = {"roughness": 0.2, "diffuse": 0.05, "room": 0.02, "blur": 0.7}
        self.how = known | {key: value for key, value in how.items() if key not in ("jpeg", "noise")}
        y_hw, x_hw = np.mgrid[:side, :side]
        away_hw = np.hypot(x_hw - self.sphere[0], y_hw - self.sphere[1])
        self.pixels = np.flatnonzero(away_hw < _REACH * radius + 2.0)
        self.behind_p = ndimage.gaussian_filter((away_hw > radius).astype(float), self.how["blur"]).ravel()[self.pixels]

    def shown(self, lights_i3: NDArray[np.float64] | None = None, sphere: Sphere | None = None, **more: Any) -> NDArray:
        """Return pictures without noise, (n_light, height, width)."""
        lights_i3 = self.lights_i3 if lights_i3 is None else lights_i3
        how = {**self.how, "noise": 0.0, "seed": 1, **more}
        return photograph_spheres(lights_i3, self.size, [sphere or self.sphere], **how)

    def picked(self, pictures_ihw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what is looked at, (n_light, P)."""
        return pictures_ihw.reshape(len(pictures_ihw), -1)[:, self.pixels]

    def slopes(self) -> NDArray[np.float64]:
        """Return derivatives, (n_light, P, values): of all photographs, then two angles and a height of each."""

        def between(more: NDArray, less: NDArray, step: float) -> NDArray[np.float64]:
            return (self.picked(more) - self.picked(less)) / (2.0 * step)

        shared = []
        for k in range(3):
            ends = [tuple(v + sign * _PIXELS * (n == k) for n, v in enumerate(self.sphere)) for sign in (1.0, -1.0)]
            shared.append(between(*(self.shown(sphere=end) for end in ends), _PIXELS))  # type: ignore[arg-type]
        for name, step in _STEPS.items():
            step = step * (self.how[name] if name == "roughness" else 1.0)
            ends_hw = [self.shown(**{name: self.how[name] + sign * step}) for sign in (1.0, -1.0)]
            shared.append(between(*ends_hw, step))
        count = len(self.lights_i3)
        slopes_ipk = np.zeros((count, len(self.pixels), len(shared) + 3 * count))
        slopes_ipk[:, :, : len(shared)] = np.stack(shared, axis=2)
        across_i3 = np.cross(self.lights_i3, [1.0, 0.3, 0.2])
        across_i3 /= np.linalg.norm(across_i3, axis=1, keepdims=True)
        own = []
        for turn_i3 in (across_i3, np.cross(self.lights_i3, across_i3)):
            # Lamps are of unknown brightness: what tells of a light is where its highlight is, not how bright all is.
            ends_hw = [self._highlights(self.lights_i3 + sign * _ANGLE * turn_i3) for sign in (1.0, -1.0)]
            own.append(between(*ends_hw, _ANGLE))
        own.append(self.picked(self._highlights(self.lights_i3)))
        for i in range(count):
            for n, each_ip in enumerate(own):
                slopes_ipk[i, :, len(shared) + 3 * i + n] = each_ip[i]
        return slopes_ipk

    def _highlights(self, lights_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        lights_i3 = lights_i3 / np.linalg.norm(lights_i3, axis=1, keepdims=True)
        return self.shown(lights_i3) - self.shown(lights_i3, gloss=lambda normals, *_: np.zeros(normals.shape[:-1]))

    def variance(self, coder: Coder | None) -> NDArray[np.float64]:
        """Return the variance of each sample, (n_light, P), infinite where it is clipped."""
        shown_ihw = self.shown()
        # How much radiance a step of the code is.
        slope_ihw = np.where(
            shown_ihw <= 0.0031308, 1.0 / 12.92, 2.4 / 1.055 * np.maximum(shown_ihw, 1e-6) ** (1 - 1 / 2.4)
        )
        variance_ihw = self.noise**2 + (slope_ihw * _CODE) ** 2 / 12.0
        if coder is not None:
            rng = np.random.default_rng(3)
            codes_ihwc = srgb_codes(np.clip(shown_ihw + self.noise * rng.standard_normal(shown_ihw.shape), 0.0, 1.0))
            changed_ihw = (coder(codes_ihwc).astype(float) - codes_ihwc).mean(axis=3) * _CODE * slope_ihw
            variance_ihw = variance_ihw + ndimage.uniform_filter(changed_ihw**2, (1, 8, 8))
        return self.picked(np.where(shown_ihw > _CLIPPED, np.inf, variance_ihw))


def _forget_table(weighted_ipk: NDArray[np.float64], view: _View, variance_ip: NDArray[np.float64]) -> None:
    """Take off what goes with the lamps as the table does, in pixels that show it."""
    along_ip = np.maximum(view.lights_i3[:, 2:], 0.0) / np.sqrt(variance_ip)
    along_ip *= view.behind_p > _BEHIND
    along_ip /= np.maximum(np.linalg.norm(along_ip, axis=0), 1e-12)
    weighted_ipk -= along_ip[:, :, None] * np.einsum("ip,ipk->pk", along_ip, weighted_ipk)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--only", multiple=True, help="Rows by their names; default: all.")
@click.option("--markdown", type=click.Path(dir_okay=False, path_type=Path), help="Replace the table of a page.")
def main(only: Sequence[str], markdown: Path | None) -> None:
    """Print the bounds of the spheres of ``benchmarks.variation``."""
    from benchmarks.variation import SPHERES, through_jpeg

    rows = {name: each for name, each in SPHERES.items() if not only or name in only}
    table = bound_table(rows, lamps(LIGHTS, 1), lambda quality: lambda codes: through_jpeg(codes, quality))
    show_parts({"sphere-bounds": table}, markdown)


if __name__ == "__main__":
    main()
