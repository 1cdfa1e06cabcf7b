"""klt, its peers, and what each takes at the qualities that klt has at some rates."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from benchmarks.peer_coders import NAMES, plane_coders
from benchmarks.peer_planes import PlanePeer, PlaneSet, principal_planes, raw_planes
from benchmarks.peer_search import CODING, HELD_OUT, SEEN, Match, Point, match
from benchmarks.peer_stacks import FittedStack
from benchmarks.peer_video import FORMATS, PhotographPeer, video_peer, volume_peer
from benchmarks.rti_tools import BASES, fit_rti
from clrelight.codec import codec_class, decode, encode
from clrelight.codec.encoded import Encoded
from clrelight.device import Device
from clrelight.errors import InputError

RATES = (0.02, 0.1, 0.3)
KLT, RTI = "klt", "RTI planes, JPEG"
_RAW = ("JPEG 2000", "HTJ2K")
"""Codecs that get the raw maps too, which take several times the bytes of principal planes with any."""
_OF_PHOTOGRAPHS = (*(f"{name} video" for name in FORMATS), "SPERR volume")
WAYS = (
    *(f"{name}, principal planes" for name in NAMES),
    *(f"{name}, raw planes" for name in _RAW),
    RTI,
    *(way for name in _OF_PHOTOGRAPHS for way in (name, f"{name}, between lights")),
)
"""All that klt is compared with."""
_QUALITIES = (5, 100)
_PART = 544
"""Side of a part that klt codes as it does a whole map of so many pixels or more: in several units."""


@dataclass(frozen=True)
class Row:
    """A way on one stack at one quality.

    Attributes
    ----------
    stack, way : str
    rate : float
        Bits per coefficient at which klt set the quality.
    equal : str
        Which PSNR is equal.
    psnr : float
        At which bytes are compared: klt's, or the best of a way that does not reach it.
    reached : bool
        Whether the way reaches klt's.
    byte_count, klt_bytes : float
        At that PSNR.
    point : Point
        The setting nearest to it.
    """

    stack: str
    way: str
    rate: float
    equal: str
    psnr: float
    reached: bool
    byte_count: float
    klt_bytes: float
    point: Point

    @property
    def ratio(self) -> float:
        """Bytes over those of klt."""
        return self.byte_count / self.klt_bytes


@dataclass
class Measurement:
    """What has been measured, and what was left out and why."""

    rows: list[Row] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


class KltCurve:
    """klt on one stack by its rate; each rate is coded once."""

    def __init__(self, stack: FittedStack, device: Device) -> None:
        self._stack, self._device = stack, device
        self.encoded: dict[float, Encoded] = {}
        self.at = functools.cache(self._at)

    def _at(self, rate: float) -> Point:
        """Return the point at a rate; seconds hold the search for the step."""
        coeffs_khwc, device = self._stack.coeffs_khwc, self._device
        codec = codec_class("klt").from_config({"rate": rate})
        since = time.perf_counter()
        encoded = encode(coeffs_khwc, codec, device, lights_i3=self._stack.seen_lights)
        ended = time.perf_counter()
        decoded_khwc = decode(encoded, device)
        seconds = (ended - since, time.perf_counter() - ended)
        self.encoded[rate] = encoded
        return Point(encoded.encoded_bytes, self._stack.score_coefficients(decoded_khwc), *seconds, f"{rate:g} bit")

    def build_kernels(self) -> None:
        """Code a part of the map, for seconds hold no building of kernels."""
        part_khwc = np.ascontiguousarray(self._stack.coeffs_khwc[:, :_PART, :_PART])
        decode(encode(part_khwc, codec_class("klt").from_config({"rate": 0.1}), self._device), self._device)

    def bytes_at(self, measure: str, psnr: float) -> float:
        """Return the bytes at a PSNR that may be below those of the rates."""
        found = match(lambda place: self.at(2.0**place), measure, psnr, -6.0, (-11.0, 1.0), 1.5)
        return found.byte_count if found.byte_count is not None else float(found.nearest.byte_count)


def measure_stack(
    stack: FittedStack,
    device: Device,
    measurement: Measurement,
    tell: Callable[[Row], None],
    rates: tuple[float, ...] = RATES,
    wanted: Callable[[str], bool] = lambda way: True,
) -> None:
    """Add the rows of a stack, klt's first at each rate, of ways that are wanted; `tell` gets each as it comes."""
    curve = KltCurve(stack, device)
    curve.build_kernels()

    def add(row: Row) -> None:
        measurement.rows.append(row)
        tell(row)

    for rate in rates:
        point = curve.at(rate)
        size = float(point.byte_count)
        add(Row(stack.name, KLT, rate, CODING, point.psnr[CODING], True, size, size, point))
    for row in _plane_rows(stack, curve, rates, measurement, wanted):
        add(row)
    for way, equal, find in _other_ways(stack, measurement, wanted):
        for rate in rates:
            add(_row(stack.name, way, rate, equal, find(curve.at(rate).psnr[equal], equal), curve, rates))


def _row(stack: str, way: str, rate: float, equal: str, found: Match, curve: KltCurve, rates: tuple[float, ...]) -> Row:
    psnr = curve.at(rate).psnr[equal]
    if found.byte_count is not None:
        # At lights that no fit has seen, more bytes can be worse.
        klt_bytes = min(curve.at(r).byte_count for r in rates if curve.at(r).psnr[equal] >= psnr)
        return Row(stack, way, rate, equal, psnr, True, found.byte_count, float(klt_bytes), found.nearest)
    psnr, size = found.nearest.psnr[equal], float(found.nearest.byte_count)
    return Row(stack, way, rate, equal, psnr, False, size, curve.bytes_at(equal, psnr), found.nearest)


def _plane_rows(
    stack: FittedStack,
    curve: KltCurve,
    rates: tuple[float, ...],
    measurement: Measurement,
    wanted: Callable[[str], bool],
) -> Iterator[Row]:
    try:
        coders = plane_coders()
    except ImportError:
        measurement.left_out[", ".join(NAMES)] = "imagecodecs is not installed"
        return

    def find(peer: PlanePeer, rate: float) -> Match:
        target = curve.at(rate).psnr[CODING]
        return match(peer.evaluate, CODING, target, target, (target - 12.0, target + 12.0), 0.5, most=4)

    for rate in rates:
        planes: PlaneSet = principal_planes(stack, curve.encoded[rate])
        if not len(planes.planes_jhw):
            continue
        for coder in coders:
            way = f"{coder.name}, principal planes"
            if not wanted(way):
                continue
            yield _row(stack.name, way, rate, CODING, find(PlanePeer(coder, planes), rate), curve, rates)
    for coder in (coder for coder in coders if coder.name in _RAW):
        way = f"{coder.name}, raw planes"
        if not wanted(way):
            continue
        planes = raw_planes(stack)
        peer = PlanePeer(coder, planes)
        for rate in rates:
            yield _row(stack.name, way, rate, CODING, find(peer, rate), curve, rates)


def _other_ways(
    stack: FittedStack, measurement: Measurement, wanted: Callable[[str], bool]
) -> Iterator[tuple[str, str, Callable[[float, str], Match]]]:
    """Yield ways that take photographs, which PSNR is equal, and what finds their bytes."""
    if wanted(RTI):
        try:
            yield RTI, HELD_OUT, _rti(stack)
        except InputError as error:
            measurement.left_out[RTI] = str(error)
    photographs = PhotographPeer(stack)
    makers: dict[str, tuple[Callable[[], Callable[[float], Point]], tuple[float, float, float, bool]]] = {
        f"{name} video": (
            functools.partial(video_peer, photographs, name),
            (-form.coarsest, -form.usual, -form.finest, True),
        )
        for name, form in FORMATS.items()
    }
    makers["SPERR volume"] = (functools.partial(volume_peer, photographs), (5.0, 35.0, 70.0, False))
    for name, (make, (low, usual, high, whole)) in makers.items():
        ways = {name: SEEN, f"{name}, between lights": HELD_OUT}
        if not any(map(wanted, ways)):
            continue
        try:
            evaluate = make()
        except ImportError as error:
            measurement.left_out[name] = f"{error.name or error} is not installed"
            continue

        def find(
            psnr: float,
            equal: str,
            evaluate: Callable[[float], Point] = evaluate,
            places: tuple[float, float, float, bool] = (low, usual, high, whole),
        ) -> Match:
            low, usual, high, whole = places
            return match(evaluate, equal, psnr, usual, (low, high), 8.0, whole=whole, most=6)

        yield from ((way, equal, find) for way, equal in ways.items() if wanted(way))


def _rti(stack: FittedStack) -> Callable[[float, str], Match]:
    """Return what finds the least bytes of all bases of RTI tools."""
    fits = {}
    for basis in BASES:
        try:
            fits[basis] = fit_rti(stack.stack, stack.fitted_i, basis)
        except InputError:  # fewer lights than functions
            continue
    if not fits:
        raise InputError(f"no basis of RTI tools can do with {len(stack.fitted_i)} lights")
    fits[next(iter(fits))].compress(_QUALITIES[0])  # without Pillow this is an InputError

    @functools.cache
    def evaluate(basis: str, quality: int) -> Point:
        fitted = fits[basis]
        since = time.perf_counter()
        size, planes = fitted.compress(quality)
        seconds = time.perf_counter() - since
        images_ihwc = np.stack([fitted.relight(planes, int(light)) for light in stack.unseen_i])
        # Coding and decoding are one function there.
        return Point(size, stack.score_unseen(images_ihwc), seconds, math.nan, f"{basis}, JPEG {quality}")

    def find(psnr: float, equal: str) -> Match:
        found = []
        for basis in fits:
            best = evaluate(basis, _QUALITIES[1])
            if best.psnr[equal] < psnr:
                found.append(Match(None, best))
                continue
            way = functools.partial(evaluate, basis)
            found.append(match(lambda q, way=way: way(int(q)), equal, psnr, 90, _QUALITIES, 15, whole=True, most=6))
        reaching = [each for each in found if each.byte_count is not None]
        if reaching:
            return min(reaching, key=lambda each: each.byte_count or math.inf)
        return max(found, key=lambda each: each.nearest.psnr[equal])

    return find
