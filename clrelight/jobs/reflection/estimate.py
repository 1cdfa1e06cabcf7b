"""Reflectances from pictures under known light: their coefficients, or which of known materials they are."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import MAX_ORDER
from clrelight.brdf.expanded import write_coefficients
from clrelight.brdf.named import parse_brdf
from clrelight.conventions import srgb_to_linear
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.images import read_image
from clrelight.jobs.inputs import opened_on, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.reflection.build import LightLike, light_of
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.components import read_normals
from clrelight.shrm.estimation import FoundBrdf, estimate_brdf
from clrelight.shrm.lookup import central_directions, view_sphere
from clrelight.shrm.observation import Observations
from clrelight.shrm.recognition import Recognition, make_library
from clrelight.shrm.recognition import recognise as recognise_among

DEGREE, ORDER = 10, 3
"""F and P that are looked for where nobody says otherwise."""

_RIM = 0.2
"""Cosine between normal and view from which points count: nearer the outline a pixel sees several normals."""

Path = str | os.PathLike[str]
PictureLike = Path | NDArray[Any]


def estimate_reflectance(
    pictures: PictureLike | Sequence[PictureLike],
    light: LightLike,
    out: Path | None = None,
    *,
    views: Sequence[Sequence[float]] | None = None,
    normals: Path | None = None,
    degree: int = DEGREE,
    order: int = ORDER,
    centre: str = "reflection",
    ridge: float | None = None,
    prior: str = "typical",
    transfer: str = "srgb",
    samples: int = 4000,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> FoundBrdf | Report:
    """Return the isotropic reflectance that pictures of one material under known light show.

    Parameters
    ----------
    pictures : path, array or a sequence of them
        A sphere that fills its square picture, seen from afar (as `render_reflection` shows it); with `normals`, any
        convex shape that does not shade itself. Arrays are linear radiance (height, width, channel).
    light : Environment, Light or path of a light file
        In the axes of the views.
    out : path, optional
        A ``.json`` file, which commands take as a reflectance.
    views : rows of three numbers, optional
        Towards the camera of each picture; default: (0, -1, 0.3) of spheres as `render_reflection`, with normals
        (0, 0, 1).
    normals : path, optional
        A picture of normals in the axes of the light, one for all pictures.
    degree, order : int
        F and P.
    centre : str
        ``"reflection"``, ``"normal"`` or ``"tangent"`` (fibres along meridians, without azimuth).
    ridge, prior
        See `shrm.estimation.estimate_brdf`.
    transfer : str
        Curve of pictures of integers: ``"srgb"`` or ``"linear"``.
    samples : int
        Points of all pictures that are taken, drawn by chance but always alike.
    device : Device or str, optional
        Of the projection of maps that are not lat-long.
    progress, report
        As of other verbs.

    Raises
    ------
    InputError
        If pictures do not fit, or do not tell so many coefficients.
    """
    kept = report_for(report)
    orders = _orders(degree, order)
    if out is not None and not path_text(out, "a reflectance to write").lower().endswith(".json"):
        raise InputError(f"a reflectance is written as .json, got {os.fsdecode(out)}")
    with (
        claimed([out], paths_among(light, normals, *_listed(pictures)), kept),
        opened_on(device, kept) as opened,
        stage(progress, "estimating") as tell,
    ):
        since = time.perf_counter()
        seen = observe(pictures, views=views, normals=normals, centre=centre, transfer=transfer, samples=samples)
        since = kept.add("read", since)
        known = light_of(light, orders[0], opened)
        since = kept.add("project", since)
        found = estimate_brdf(
            seen, known.coeffs_kc, *orders, centre=centre, azimuth=centre != "tangent", ridge=ridge, prior=prior
        )
        tell(1, 1)
        since = kept.add("solve", since)
        if out is not None:
            write_coefficients(out, found.coefficients)
            kept.add("write", since)
    kept.facts |= {"file": out, "degree": degree, "order": order, "centre": centre, "points": len(seen.radiance_nc)}
    kept.facts |= {"condition": found.condition_l, "error": found.error_l, "ridge": list(found.ridge)}
    kept.facts |= {"residual": found.residual}
    return found if out is None else kept


def recognise_material(
    pictures: PictureLike | Sequence[PictureLike],
    light: LightLike,
    materials: Sequence[str] | Mapping[str, CentredBrdf],
    *,
    views: Sequence[Sequence[float]] | None = None,
    normals: Path | None = None,
    degree: int = DEGREE,
    order: int = ORDER,
    components: int | None = None,
    transfer: str = "srgb",
    samples: int = 4000,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Recognition:
    """Return which of some materials pictures under known light show, nearest first, whatever their exposure.

    Parameters
    ----------
    pictures, light, views, normals, degree, order, transfer, samples, device
        As of `estimate_reflectance`.
    materials : names, or mapping of names to reflectances
        Texts as of `brdf.named.parse_brdf`: ``microfacet:0.2``, ``skin``, ``paint.brdf``, ``found.json``.
    components : int, optional
        Principal components of the materials that are fitted; default: one fewer than materials.
    progress, report
        As of other verbs.
    """
    kept = report_for(report)
    orders = _orders(degree, order)
    named = materials if isinstance(materials, Mapping) else {text: parse_brdf(text) for text in materials}
    with opened_on(device, kept) as opened, stage(progress, "recognising") as tell:
        since = time.perf_counter()
        library = make_library(named, *orders, components)
        since = kept.add("library", since)
        asked = {"views": views, "normals": normals, "transfer": transfer, "samples": samples}
        seen = observe(pictures, centre=library.centre, **asked)  # type: ignore[arg-type]
        since = kept.add("read", since)
        known = light_of(light, orders[0], opened)
        since = kept.add("project", since)
        found = recognise_among(library, seen, known.coeffs_kc)
        tell(1, 1)
        kept.add("solve", since)
    kept.facts |= {"materials": list(found.names), "distances": found.distance_n, "unexplained": found.unexplained}
    kept.facts |= {"components": len(library.axes_kx), "shares": library.share_k, "points": len(seen.radiance_nc)}
    return found


def observe(
    pictures: PictureLike | Sequence[PictureLike],
    *,
    views: Sequence[Sequence[float]] | None = None,
    normals: Path | None = None,
    centre: str = "reflection",
    transfer: str = "srgb",
    samples: int = 4000,
) -> Observations:
    """Return the points of pictures, as of `estimate_reflectance`."""
    check_transfer(transfer)
    held = _listed(pictures)
    if not held:
        raise InputError("there is no picture to look at")
    if whole(samples, "samples") < 1:
        raise InputError(f"samples must be 1 at least, got {samples}")
    standard = (0.0, 0.0, 1.0) if normals is not None else (0.0, -1.0, 0.3)
    towards = [standard] * len(held) if views is None else list(views)
    if len(towards) != len(held):
        raise InputError(f"{len(held)} pictures have as many views, got {len(towards)}")
    shape = None if normals is None else read_normals(normals)
    parts = [
        _points(picture, np.asarray(view, np.float64), shape, centre, transfer)
        for picture, view in zip(held, towards, strict=True)
    ]
    if len({part[0].shape[1] for part in parts}) > 1:
        raise InputError("some pictures are gray and others are coloured: make them alike")
    radiance_nc, central_n3, views_n3 = (np.concatenate([part[i] for part in parts]) for i in range(3))
    if len(radiance_nc) > samples:
        chosen = np.sort(np.random.default_rng(0).choice(len(radiance_nc), samples, replace=False))
        radiance_nc, central_n3, views_n3 = radiance_nc[chosen], central_n3[chosen], views_n3[chosen]
    return Observations(radiance_nc, central_n3, views_n3)


def _points(
    picture: PictureLike,
    view_3: NDArray[np.float64],
    shape: tuple[NDArray[np.float32], NDArray[np.bool_]] | None,
    centre: str,
    transfer: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return radiance, central directions and views of the points of one picture that face the camera."""
    image_hwc, name = _linear(picture, transfer)
    height, width = image_hwc.shape[:2]
    if shape is None:
        if height != width:
            raise InputError(f"{name} is {width}×{height}: a sphere fills a square; other shapes need normals")
        sphere = view_sphere(height, view_3)
        normals_n3, inside_hw, towards_3 = sphere.normals_n3, sphere.inside_hw, sphere.view_3
    else:
        normals_n3, inside_hw = shape[0].astype(np.float64), shape[1]
        towards_3 = view_sphere(1, view_3).view_3
        if inside_hw.shape != (height, width):
            raise InputError(f"{name} is {width}×{height}, the normals are {inside_hw.shape[1]}×{inside_hw.shape[0]}")
    facing_n = normals_n3 @ towards_3 > _RIM
    if not facing_n.any():
        raise InputError(f"{name} shows no point that faces the camera at {', '.join(f'{v:g}' for v in view_3)}")
    radiance_nc = image_hwc[inside_hw][facing_n].astype(np.float64)
    if not np.isfinite(radiance_nc).all():
        raise InputError(f"{name} holds values that are not finite")
    central_n3 = central_directions(normals_n3[facing_n], towards_3, centre)
    return radiance_nc, central_n3, np.broadcast_to(towards_3, central_n3.shape)


def _linear(picture: PictureLike, transfer: str) -> tuple[NDArray[Any], str]:
    """Return linear radiance of 1 or 3 channels, and what to call the picture."""
    image_hwc: NDArray[Any]
    if isinstance(picture, np.ndarray):
        image_hwc, name = picture, "a picture"
    else:
        name = path_text(picture, "a picture")
        image_hwc = read_image(name)
    if image_hwc.ndim != 3 or image_hwc.shape[2] not in (1, 3):
        raise InputError(f"{name} must be (height, width, 1 or 3), got shape {image_hwc.shape}")
    if image_hwc.dtype.kind == "u":
        codes_hwc = image_hwc.astype(np.float64) / np.iinfo(image_hwc.dtype).max
        return (srgb_to_linear(codes_hwc) if transfer == "srgb" else codes_hwc), name
    return image_hwc, name


def _listed(pictures: Any) -> list[PictureLike]:
    return list(pictures) if isinstance(pictures, list | tuple) else [pictures]


def _orders(degree: int, order: int) -> tuple[int, int]:
    if not 0 <= whole(degree, "the degree F") <= MAX_DEGREE:
        raise InputError(f"the degree F must be 0 to {MAX_DEGREE}, got {degree}")
    if not 0 <= whole(order, "the order P") <= MAX_ORDER:
        raise InputError(f"the order P must be 0 to {MAX_ORDER}, got {order}")
    return degree, order
