"""What is asked of the normals of a stack, and what is told from some of its pixels before all are computed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import SRGB_GAMMA, SRGB_OFFSET, TRANSFERS
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError, counted
from clrelight.variation.gains import LightGains, estimate_gains
from clrelight.variation.law_choice import Probe, choose_law, held_error
from clrelight.variation.near_lights import NearLights, places
from clrelight.variation.normals import shadow_floor
from clrelight.variation.reflectance import HELD, Law, view_vectors
from clrelight.variation.samples import ProbePixels, SampleReader, in_range, read_probe

_CHOSEN_PIXELS = 1024
"""Pixels that laws and curves are told apart by."""
_GAIN_PIXELS = 2048
_CLEARLY = 0.9
"""Share of the error that another curve than the stack's has to leave to be believed."""
_LEAST_TOLD_BY = 5
"""Lights of which three or more are left, and each is determined by others, when a fourth is left out."""
MOST_FIELD = 150.0


@dataclass(frozen=True)
class Wanted:
    """What is known or asked of a stack beyond its directions.

    Attributes
    ----------
    near : NearLights, optional
        Lights near the surface, instead of the stack's directions.
    gains_ic : ndarray, shape (n_light, 1 or channel), float64, optional
        Intensities of the lights that are still in the samples.
    estimate_gains : bool
        Whether they are told from the samples.
    transfer : str
        ``"stack"``: the curve that the stack names; ``"linear"``, ``"srgb"``, or ``"auto"``: told from the samples.
    field : float, optional
        Degrees that the longer side of the images takes in the camera, 0 of one far away; default: told from gloss.
    """

    near: NearLights | None = None
    gains_ic: NDArray[np.float64] | None = None
    estimate_gains: bool = False
    transfer: str = "stack"
    field: float | None = None

    def __post_init__(self) -> None:
        known = ("stack", "auto", *TRANSFERS)
        if self.transfer not in known:
            raise InputError(f"transfer must be one of {', '.join(known)}, got {self.transfer!r}")
        if self.field is not None and not 0.0 <= self.field <= MOST_FIELD:
            raise InputError(f"the camera's field must be 0 to {MOST_FIELD:g} degrees, got {self.field:g}")


@dataclass(frozen=True)
class UnknownLight:
    """What was told where the light is not known.

    Attributes
    ----------
    degree : int
        Of its harmonics.
    energy : float
        Share of the photographs' energy that the components of the degree hold.
    residual : float
        Of the constraint on a pixel's components: 0 of a convex matte surface.
    gap : float
        Near 0 integrability tells the surface, near 1 it does not.
    concave : bool
        Which of the two surfaces was taken.
    """

    degree: int
    energy: float
    residual: float
    gap: float
    concave: bool


@dataclass(frozen=True)
class Found:
    """What was told from some pixels of a stack.

    Attributes
    ----------
    transfer : str
        The curve by which samples are decoded.
    floor : float
        What shadows hold, as a share of the albedo.
    law : Law, optional
        Of the robust method.
    tried : dict of str to float
        Errors of laws at lights that were left out.
    gains : LightGains, optional
        Where they were estimated.
    gains_ic : ndarray, optional
        By which samples are divided.
    curves : dict of str to float
        Errors of transfer curves, where they were compared.
    rounds : int
        Of normals and heights, under near lights.
    light : UnknownLight, optional
        Where it is not known.
    """

    transfer: str
    floor: float
    law: Law | None = None
    tried: dict[str, float] = field(default_factory=dict)
    gains: LightGains | None = None
    gains_ic: NDArray[np.float64] | None = None
    curves: dict[str, float] = field(default_factory=dict)
    rounds: int = 1
    light: UnknownLight | None = None

    @property
    def better(self) -> str | None:
        """The curve that the samples follow clearly better than the one they were decoded by."""
        other = _other(self.transfer)
        return other if self.curves and self.curves[other] < _CLEARLY * self.curves[self.transfer] else None

    @property
    def is_close(self) -> bool:
        """Whether two curves were hardly told apart."""
        return len(self.curves) > 1 and min(self.curves.values()) > _CLEARLY * max(self.curves.values())


def _other(transfer: str) -> str:
    return next(name for name in TRANSFERS if name != transfer)


def settle(
    stack: LightStack, method: str, wanted: Wanted, device: Device | None, heights_hw: NDArray[np.float32]
) -> Found:
    """Return the curve, gains, floor and law of a stack, from some of its pixels; heights matter under near lights."""
    plain = method == "least-squares"
    transfer = stack.transfer if wanted.transfer == "stack" else wanted.transfer
    if plain and transfer != "auto" and not wanted.estimate_gains:
        return Found(transfer, 0.0, gains_ic=wanted.gains_ic)
    pixels = _Pixels(read_probe(stack), heights_hw)
    curves: dict[str, float] = {}
    is_suspect = wanted.transfer == "stack" and method == "robust" and stack.images_ihwc.dtype == np.uint8
    tells = stack.n_light >= _LEAST_TOLD_BY
    if transfer == "auto" and not tells:
        raise InputError(
            f"{counted(stack.n_light, 'light does', 'lights do')} not tell the transfer curve, {_LEAST_TOLD_BY} would: "
            "name linear or srgb"
        )
    if transfer == "auto" or (is_suspect and tells):
        curves = {name: _curve_error(stack, pixels, name, wanted, device) for name in TRANSFERS}
    if transfer == "auto":
        other = _other(stack.transfer)
        transfer = other if curves[other] < _CLEARLY * curves[stack.transfer] else stack.transfer
    gains, gains_ic = None, wanted.gains_ic
    if wanted.estimate_gains:
        gains = _gains(stack, pixels, transfer, wanted)
        gains_ic = gains.gains_i[:, None]
    probe = _probe(stack, pixels, transfer, wanted, gains_ic)
    law: Law | None = None
    tried: dict[str, float] = {}
    if method == "robust":
        law, tried = choose_law(_some(probe, _CHOSEN_PIXELS), device, wanted.field)
    return Found(transfer, 0.0 if plain else probe.floor, law, tried, gains, gains_ic, curves)


@dataclass(frozen=True)
class _Pixels:
    """Some pixels of a stack, and the heights of all."""

    read: ProbePixels
    heights_hw: NDArray[np.float32]

    @property
    def place_3p(self) -> NDArray[np.float32]:
        """Where they are."""
        return places(self.read.rows_p, self.read.columns_p, self.heights_hw)


def _probe(
    stack: LightStack, pixels: _Pixels, transfer: str, wanted: Wanted, gains_ic: NDArray[np.float64] | None
) -> Probe:
    reader, place_3p, falloff_ip = SampleReader(stack, transfer, gains_ic), None, None
    lights_i3 = stack.directions_i3
    if wanted.near is not None:
        place_3p = pixels.place_3p
        falloff_ip, lights_i3 = wanted.near.falloff(place_3p), wanted.near.positions_i3
    samples_cip, most = reader.even(reader.linear(pixels.read.codes_ipc), falloff_ip)
    samples_cip, exponent = in_range(samples_cip)
    directions_i3 = lights_i3 if wanted.near is None else wanted.near.directions_i3
    floor = shadow_floor(samples_cip, directions_i3) if samples_cip.size else 0.0

    def look(degrees: float) -> NDArray[np.float32]:
        return view_vectors(pixels.read.rows_p, pixels.read.columns_p, stack.image_shape[:2], degrees)

    return Probe(samples_cip, lights_i3, float(np.ldexp(most, -exponent)), floor, look, place_3p)


def _some(probe: Probe, most: int) -> Probe:
    """Return pixels that lie evenly among a probe's."""
    count = probe.samples_cip.shape[2]
    if count <= most:
        return probe
    chosen_p = np.linspace(0, count - 1, most).round().astype(int)
    place_3p = None if probe.place_3p is None else np.ascontiguousarray(probe.place_3p[:, chosen_p])
    samples_cip = np.ascontiguousarray(probe.samples_cip[:, :, chosen_p])
    return Probe(
        samples_cip, probe.lights_i3, probe.most, probe.floor, lambda degrees: probe.look(degrees)[chosen_p], place_3p
    )


def _curve_error(stack: LightStack, pixels: _Pixels, transfer: str, wanted: Wanted, device: Device | None) -> float:
    """Return how far off lights are that were left out, in codes: what a curve explains must not be its own bend."""
    probe = _some(_probe(stack, pixels, transfer, wanted, wanted.gains_ic), _CHOSEN_PIXELS)
    held = HELD
    if transfer == "srgb":
        # How much steeper radiance is than its codes, each relative to itself, at codes as they are seen here.
        code = float(np.quantile(SampleReader(stack, "linear").linear(pixels.read.codes_ipc), 0.7))
        held *= max(SRGB_GAMMA * code / (code + SRGB_OFFSET), 1.0)
    return held_error(probe if device is None else probe.whole(), Law(field=wanted.field or 0.0), device, held)


def _gains(stack: LightStack, pixels: _Pixels, transfer: str, wanted: Wanted) -> LightGains:
    probe = _some(_probe(stack, pixels, transfer, wanted, None), _GAIN_PIXELS)
    if wanted.near is None or probe.place_3p is None:
        return estimate_gains(probe.samples_cip, probe.lights_i3, probe.most)
    return estimate_gains(probe.samples_cip, wanted.near.towards(probe.place_3p), probe.most)
