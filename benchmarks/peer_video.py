"""The photographs themselves as a video or a volume; between their lights images are interpolated."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.peer_search import Point
from benchmarks.peer_stacks import FittedStack

_PEAK = 1023
_DIRECTION = 4
"""Bytes of a light's direction."""
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_LEAST_SIDE = 64
_TIES = 1e-9


@dataclass(frozen=True)
class Format:
    """How photographs become a video.

    Attributes
    ----------
    encoder, decoder : str
        Of FFmpeg.
    pixels : str
        10 bits a sample.
    halves : bool
        Whether chroma has half the samples along each side.
    options : dict
    coarsest, usual, finest : int
        CRF.
    """

    encoder: str
    decoder: str
    pixels: str
    halves: bool
    options: dict[str, str]
    coarsest: int
    usual: int
    finest: int


FORMATS = {
    "HEVC": Format(
        *("libx265", "hevc", "yuv444p10le", False),
        {"preset": "medium", "tune": "psnr", "x265-params": "info=0:log-level=none:keyint=-1"},
        *(51, 24, 0),
    ),
    "AV1": Format(
        *("libsvtav1", "libdav1d", "yuv420p10le", True),
        {"preset": "5", "svtav1-params": "tune=1:keyint=-1"},
        *(63, 30, 1),
    ),
}


def shortest_path(directions_i3: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return an order of the lights along a short way: the nearest next, then turned around in parts while it helps."""
    apart_ii = np.arccos(np.clip(directions_i3 @ directions_i3.T, -1.0, 1.0))
    order = [int(np.argmin(directions_i3[:, 2]))]
    left = set(range(len(directions_i3))) - set(order)
    while left:
        order.append(min(left, key=lambda i: apart_ii[order[-1], i]))
        left.remove(order[-1])
    better = True
    while better:
        better = False
        for i in range(len(order) - 1):
            for j in range(i + 2, len(order)):
                behind = (
                    apart_ii[order[i + 1], order[j + 1]] - apart_ii[order[j], order[j + 1]]
                    if j + 1 < len(order)
                    else 0.0
                )
                if apart_ii[order[i], order[j]] - apart_ii[order[i], order[i + 1]] + behind < -1e-9:
                    order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1]
                    better = True
    return np.array(order, np.intp)


class PhotographPeer:
    """Photographs of the fitted lights in the order of a short path, and images at all lights from what is decoded."""

    def __init__(self, stack: FittedStack) -> None:
        from scipy.interpolate import RBFInterpolator

        self._stack = stack
        order = shortest_path(stack.stack.directions_i3[stack.fitted_i])
        self._shown_i = stack.fitted_i[order]
        seen_i3 = stack.stack.directions_i3[self._shown_i]
        weigh = RBFInterpolator(seen_i3, np.eye(len(seen_i3)), kernel="linear", smoothing=_TIES)
        self._weights_ii = weigh(stack.stack.directions_i3).astype(np.float32)
        self._weights_ii[self._shown_i] = np.eye(len(seen_i3), dtype=np.float32)

    @property
    def photographs(self) -> NDArray[np.float32]:
        """Of the fitted lights, in units of the peak."""
        return self._stack.stack.images_ihwc[self._shown_i] / np.float32(self._stack.stack.peak)

    def point(self, size: int, decoded_ihwc: NDArray[np.float32], seconds: tuple[float, float], setting: str) -> Point:
        """Return the point of decoded photographs."""

        def relit(rows: slice) -> NDArray[np.float32]:
            part_ihwc = np.clip(decoded_ihwc[:, rows], 0.0, 1.0)
            images_ip = self._weights_ii @ part_ihwc.reshape(len(part_ihwc), -1)
            return images_ip.reshape(-1, *part_ihwc.shape[1:])

        return Point(size + _DIRECTION * len(decoded_ihwc), self._stack.score(relit), *seconds, setting)


def video_peer(photographs: PhotographPeer, name: str) -> Callable[[float], Point]:
    """Return what codes the photographs as a video, by minus the CRF; ImportError without PyAV."""
    import av  # noqa: F401

    os.environ.setdefault("SVT_LOG", "1")
    form = FORMATS[name]

    @functools.cache
    def evaluate(quality: float) -> Point:
        frames = to_frames(photographs.photographs, form.halves)
        height, width = photographs.photographs.shape[1:3]
        since = time.perf_counter()
        packets = _encode(form, frames, -int(quality))
        encoded = time.perf_counter()
        back = _decode(form, packets)
        seconds = (encoded - since, time.perf_counter() - encoded)
        decoded_ihwc = from_frames(back, form.halves)[:, :height, :width]
        return photographs.point(sum(map(len, packets)), decoded_ihwc, seconds, f"CRF {-int(quality)}")

    return evaluate


def to_frames(images_ihwc: NDArray[np.float32], halves: bool) -> list[list[NDArray[np.uint16]]]:
    """Return Y, Cb and Cr (BT.709, full range, 10 bits) of each image, with even sides of at least 64."""
    frames = []
    for image_hwc in images_ihwc:
        rows, columns = (max(_LEAST_SIDE, side + side % 2) - side for side in image_hwc.shape[:2])
        padded_hwc = np.pad(image_hwc, ((0, rows), (0, columns), (0, 0)), "edge")
        luma_hw = padded_hwc @ _LUMA
        blue_hw = (padded_hwc[..., 2] - luma_hw) / (2.0 * (1.0 - _LUMA[2]))
        red_hw = (padded_hwc[..., 0] - luma_hw) / (2.0 * (1.0 - _LUMA[0]))
        if halves:
            blue_hw, red_hw = (
                each.reshape(each.shape[0] // 2, 2, each.shape[1] // 2, 2).mean(axis=(1, 3))
                for each in (blue_hw, red_hw)
            )
        planes = (luma_hw, blue_hw + 512.0 / _PEAK, red_hw + 512.0 / _PEAK)
        frames.append([np.clip(np.rint(_PEAK * plane), 0, _PEAK).astype(np.uint16) for plane in planes])
    return frames


def from_frames(frames: list[list[NDArray[np.uint16]]], halves: bool) -> NDArray[np.float32]:
    """Return the images of frames, not clipped."""
    images = []
    for luma, *chroma in frames:
        luma_hw = luma / _PEAK
        blue_hw, red_hw = ((plane.astype(np.float64) - 512.0) / _PEAK for plane in chroma)
        if halves:
            blue_hw, red_hw = _twice(blue_hw), _twice(red_hw)
        image_hwc = np.empty((*luma_hw.shape, 3), np.float32)
        image_hwc[..., 0] = luma_hw + 2.0 * (1.0 - _LUMA[0]) * red_hw
        image_hwc[..., 2] = luma_hw + 2.0 * (1.0 - _LUMA[2]) * blue_hw
        image_hwc[..., 1] = (luma_hw - _LUMA[0] * image_hwc[..., 0] - _LUMA[2] * image_hwc[..., 2]) / _LUMA[1]
        images.append(image_hwc)
    return np.stack(images)


def _twice(plane_hw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a plane of twice the samples, linear between the middles of the cells."""
    for axis in (0, 1):
        before, after = (np.take(plane_hw, _clipped(plane_hw.shape[axis], shift), axis) for shift in (-1, 1))
        pairs = np.stack([0.75 * plane_hw + 0.25 * before, 0.75 * plane_hw + 0.25 * after], axis + 1)
        shape = list(plane_hw.shape)
        shape[axis] *= 2
        plane_hw = pairs.reshape(shape)
    return plane_hw


def _clipped(count: int, shift: int) -> NDArray[np.intp]:
    return np.clip(np.arange(count) + shift, 0, count - 1)


def _encode(form: Format, frames: list[list[NDArray[np.uint16]]], crf: int) -> list[bytes]:
    import av

    context = av.CodecContext.create(form.encoder, "w")
    context.height, context.width = frames[0][0].shape
    context.pix_fmt, context.time_base, context.framerate = form.pixels, Fraction(1, 25), Fraction(25, 1)
    context.options = {**form.options, "crf": str(crf)}
    context.color_range = 2
    context.open()
    _take_no_precedence()
    packets: list[bytes] = []
    for number, planes in enumerate(frames):
        frame = av.VideoFrame(context.width, context.height, form.pixels)
        for target, plane in zip(frame.planes, planes, strict=True):
            padded = np.zeros((target.height, target.line_size // 2), np.uint16)
            padded[:, : plane.shape[1]] = plane
            target.update(padded)
        frame.pts, frame.time_base = number, context.time_base
        packets += [bytes(packet) for packet in context.encode(frame)]
    return packets + [bytes(packet) for packet in context.encode(None)]


def _take_no_precedence() -> None:
    """Give all threads the usual scheduling again.

    SVT-AV1 runs in real time where it may, as for root: nothing else would, and its seconds were not those of others.
    """
    threads = Path("/proc/self/task")
    if hasattr(os, "sched_setscheduler") and threads.is_dir():
        for thread in threads.iterdir():
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))


def _decode(form: Format, packets: list[bytes]) -> list[list[NDArray[np.uint16]]]:
    import av

    context = av.CodecContext.create(form.decoder, "r")
    frames = []
    for content in [*packets, None]:
        for frame in context.decode(None if content is None else av.Packet(content)):
            planes = [np.frombuffer(p, np.uint16).reshape(p.height, -1)[:, : p.width].copy() for p in frame.planes]
            frames.append(planes)
    return frames


def volume_peer(photographs: PhotographPeer) -> Callable[[float], Point]:
    """Return what codes the photographs as volumes by SPERR, one for each of three rotated colours, by decibel.

    The axes are the lights along their path, rows and columns. ImportError without imagecodecs.
    """
    import imagecodecs

    images_ihwc = photographs.photographs
    flat = images_ihwc.reshape(-1, images_ihwc.shape[3])[::7].astype(np.float64)
    turn_dc = np.linalg.eigh(flat.T @ flat)[1].T.astype(np.float32)

    @functools.cache
    def evaluate(quality: float) -> Point:
        turned = np.ascontiguousarray(np.moveaxis(photographs.photographs @ turn_dc.T, 3, 0))
        error = 10.0 ** (-quality / 20.0)
        levels = [20.0 * math.log10(max(float(np.ptp(volume)), error) / error) for volume in turned]
        since = time.perf_counter()
        streams = [
            imagecodecs.sperr_encode(volume, max(level, 1.0), "psnr", numthreads=2)
            for volume, level in zip(turned, levels, strict=True)
        ]
        encoded = time.perf_counter()
        back = np.stack([imagecodecs.sperr_decode(stream, numthreads=2) for stream in streams])
        seconds = (encoded - since, time.perf_counter() - encoded)
        decoded_ihwc = np.moveaxis(back, 0, 3) @ turn_dc
        size = sum(map(len, streams)) + turn_dc.nbytes
        return photographs.point(size, decoded_ihwc, seconds, f"{quality:.1f} dB")

    return evaluate
