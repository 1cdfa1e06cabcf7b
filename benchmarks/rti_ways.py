"""Ways to keep a stack, ours by method, degree and options and those of RTI tools; what they give at unseen lights."""

from __future__ import annotations

import contextlib
import functools
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.rti_stacks import Case
from benchmarks.rti_tools import BASES, fit_rti
from benchmarks.similarity import Score, score_images
from clrelight.codec import codec_class, decode, encode
from clrelight.conventions import linear_to_srgb
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit import method_ids
from clrelight.jobs.fit import fit
from clrelight.relight import relight

BITS_PER_PIXEL = (1.0, 4.0, 16.0)
"""Sizes that klt is asked for."""
JPEG_QUALITIES = (30, 75, 95)

_RTI = {
    "ptm": "PTM",
    "hsh4": "HSH order 1",
    "hsh9": "HSH order 2",
    "hsh16": "HSH order 3",
    "pca9": "PCA 9 + RBF",
    "pca18": "PCA 18 + RBF",
    "pca27": "PCA 27 + RBF",
    "rbf": "all photographs, linear RBF",
}
_FITS = ("auto", "spectrum", "spline:15:lam=1e-3", "spline:15:lam=3e-4", "cls:4")
_BASES = ("ptm", "hsh9", "hsh16", "pca9", "pca27", "rbf")

Relit = Callable[[int], NDArray]
"""From the index of a light to its image (height, width, channel) in units of the peak, as displayed."""


@dataclass(frozen=True)
class Way:
    """One way, as the command line names it: a basis of `BASES`, or ``method[:degree[:option=value,...]]``."""

    text: str

    @property
    def is_fit(self) -> bool:
        """Whether it is ours."""
        return self.text not in BASES

    @property
    def label(self) -> str:
        """What tables call it."""
        if not self.is_fit:
            return _RTI.get(self.text, self.text)
        method, degree, options = self.parts
        settings = ", ".join(f"{'λ' if name == 'lam' else name} {value:g}" for name, value in options.items())
        return f"{method}{'' if degree == 'auto' else f' {degree}'}{f', {settings}' if settings else ''}"

    @property
    def parts(self) -> tuple[str, int | str, dict[str, float]]:
        """Method, degree and options of a fit; InputError where it is none."""
        method, _, rest = self.text.partition(":")
        degree, _, settings = rest.partition(":")
        if method not in ("auto", *method_ids()):
            known = ", ".join(("auto", *method_ids(), *BASES))
            raise InputError(f"a way is method:degree:option=value,... or a basis; {method!r} is none of {known}")
        try:
            options = {name: float(value) for name, value in (pair.split("=") for pair in settings.split(",") if pair)}
            return method, "auto" if degree in ("", "auto") else int(degree), options
        except ValueError:
            form = "method:degree:option=value,..., such as spline:15:lam=1e-3"
            raise InputError(f"a way is {form}, not {self.text!r}") from None


@dataclass(frozen=True)
class Coded:
    """One compressed size of a way."""

    setting: str
    byte_count: int
    score: Score


@dataclass(frozen=True)
class Found:
    """What a way gives on one stack at the unseen lights.

    Attributes
    ----------
    values : int
        Numbers kept of each pixel.
    seconds : float
        From the stack in memory to the model.
    what : str
        What was taken, where it was for the way to choose.
    score : Score, optional
        None where the way cannot do this stack; `what` says why.
    coded : list of Coded
    example : ndarray, optional
        The image of `Case.example_light`.
    """

    values: int
    seconds: float
    what: str
    score: Score | None
    coded: list[Coded] = field(default_factory=list)
    example: NDArray | None = None


def default_ways() -> list[str]:
    """Return the ways of the benchmark, those of our fits that are registered."""
    return [*(text for text in _FITS if text.split(":")[0] in ("auto", *method_ids())), *_BASES]


def measure_way(way: Way, case: Case, device: Device, *, coded: bool) -> Found:
    """Fit the seen lights of a stack and compare at the others; with `coded`, compressed to three sizes too.

    A size that cannot be had, such as fewer bytes than the side tables of a tiny picture, is left out.
    """
    since = time.perf_counter()
    try:
        model = _fit(way, case, device) if way.is_fit else _fit_basis(way, case)
        seconds = time.perf_counter() - since
        score = _score(case, model.relit, with_ssim=True)
    except InputError as error:
        return Found(0, time.perf_counter() - since, str(error), None)
    smaller = []
    for setting, code in model.sizes.items() if coded else ():
        with contextlib.suppress(InputError):
            size, relit = code()
            smaller.append(Coded(setting, size, _score(case, relit, with_ssim=False)))
    shown = np.clip(model.relit(case.example_light), 0.0, 1.0)
    return Found(model.values, seconds, model.what, score, smaller, shown)


def photograph(case: Case, light: int) -> NDArray:
    """Return a photograph in units of the peak, as displayed."""
    return np.clip(case.stack.images_ihwc[light] / np.float32(case.stack.peak), 0.0, 1.0)


@dataclass(frozen=True)
class _Model:
    """What a way made of the seen lights: its images, and by setting how to get bytes and the images that come back."""

    values: int
    what: str
    relit: Relit
    sizes: dict[str, Callable[[], tuple[int, Relit]]]


def _fit(way: Way, case: Case, device: Device) -> _Model:
    method, degree, options = way.parts
    fitted = fit(case.seen, method, degree, **options, device=device)
    height, width, channel = case.stack.image_shape

    def images(coefficients: CoefficientMap) -> Relit:
        def relit(light: int) -> NDArray:
            radiance_hwc = relight(coefficients, case.stack.directions_i3[light : light + 1], device=device)[0]
            clipped = np.clip(radiance_hwc, 0.0, 1.0)
            return linear_to_srgb(clipped, np.float32) if case.stack.transfer == "srgb" else clipped

        return relit

    def code(bits: float) -> tuple[int, Relit]:
        budget = int(bits * height * width / 8)
        codec = codec_class("klt").from_config({"byte_budget": budget}).for_transfer(case.stack.transfer)
        encoded = encode(fitted.coeffs_khwc, codec, device, fitted.basis, fitted.fitted_lights)
        decoded = replace(fitted, coeffs_khwc=decode(encoded.to_bytes(), device))
        return encoded.encoded_bytes, images(decoded)

    what = f"{fitted.method} {fitted.degree} {json.dumps(dict(fitted.config))}"
    sizes = {f"klt {bits:g}": functools.partial(code, bits) for bits in BITS_PER_PIXEL}
    return _Model(fitted.n_coeff * channel, what, images(fitted), sizes)


def _fit_basis(way: Way, case: Case) -> _Model:
    found = fit_rti(case.stack, case.fitted_i, way.text)

    def code(quality: int) -> tuple[int, Relit]:
        size, decoded = found.compress(quality)
        return size, functools.partial(found.relight, decoded)

    sizes = {f"JPEG {quality}": functools.partial(code, quality) for quality in JPEG_QUALITIES}
    values = sum(plane.shape[2] for plane in found.planes)
    return _Model(values, "", functools.partial(found.relight, found.planes), sizes)


def _score(case: Case, relit: Relit, *, with_ssim: bool) -> Score:
    pairs = ((relit(int(light)), photograph(case, int(light))) for light in case.unseen_i)
    return score_images(pairs, case.mask_hw, with_ssim=with_ssim)
