"""Print what the RTI tools' way reaches at held-out lights: ``python -m benchmarks.rti_baseline STACK.h5 ...``."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.rti_tools import BASES, fit_rti
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.holdout import split_chosen
from clrelight.metrics import psnr_of, summarize_errors
from clrelight.store import open_stack

QUALITIES = (None, 100, 98, 95, 90, 80)


@dataclass(frozen=True)
class RtiQuality:
    """What one setting costs and gives.

    Attributes
    ----------
    basis : str
    quality : int or None
        Of the JPEG planes; None where planes stay float32.
    encoded_bytes : int
        JPEG files, scales, and tables of the basis.
    psnr_pooled, psnr_mean : float
        At the lights held out, of values clipped to [0, peak] in the stack's own transfer, in decibel: of the pooled
        squared error, and the mean over images.
    psnr_pooled_fitted : float
        The first at the fitted lights.
    """

    basis: str
    quality: int | None
    encoded_bytes: int
    psnr_pooled: float
    psnr_mean: float
    psnr_pooled_fitted: float


def measure_rti(
    stack: LightStack,
    fitted_i: NDArray[np.intp],
    held_out_i: NDArray[np.intp],
    basis: str,
    qualities: tuple[int | None, ...] = (95,),
) -> list[RtiQuality]:
    """Fit at some lights, compress at each quality, decode, and compare at both sets of lights.

    Parameters
    ----------
    stack : LightStack
        Read whole into memory as float32.
    fitted_i, held_out_i : ndarray of int
        Lights, as `split_lights` gives them.
    basis : str
        One of `BASES`.
    qualities : tuple
        JPEG qualities, 1 to 100, or None for planes left in float32.

    Returns
    -------
    list of RtiQuality
        One for each quality.

    Raises
    ------
    InputError
        If the basis is unknown, there are fewer lights than functions, a quality is impossible, or Pillow is absent.
    """
    for quality in qualities:
        if quality is not None and not (isinstance(quality, int) and 1 <= quality <= 100):
            raise InputError(f"a JPEG quality must be 1 to 100, got {quality!r}")
    if not (len(fitted_i) and len(held_out_i)):
        raise InputError("there must be lights to fit and lights held out")
    fitted = fit_rti(stack, fitted_i, basis)
    given_ihwc = stack.read_rows(0, stack.image_shape[0])

    def errors(decoded: list[NDArray[np.float32]], lights_i: NDArray[np.intp]) -> NDArray[np.float64]:
        mse = []
        for i in lights_i:
            given_hwc = np.clip(given_ihwc[i] / np.float32(stack.peak), 0, 1)
            difference_hwc = np.clip(fitted.relight(decoded, int(i)), 0, 1) - given_hwc
            mse.append(np.square(difference_hwc[fitted.mask_hw], dtype=np.float64).mean())
        return np.array(mse)

    found = []
    for quality in qualities:
        size, decoded = fitted.compress(quality)
        held_out = summarize_errors(errors(decoded, held_out_i))
        seen = float(psnr_of(float(errors(decoded, fitted_i).mean())))
        found.append(RtiQuality(basis, quality, size, held_out.psnr_pooled, held_out.psnr_mean, seen))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stacks", nargs="+", metavar="STACK.h5")
    parser.add_argument("--holdout", type=int, default=5, help="keep every K-th light out of the fit (default 5)")
    arguments = parser.parse_args()
    print(f"{'stack':16} {'basis':6} {'jpeg':>5} {'kB':>9} {'held out dB':>12} {'mean dB':>8} {'fitted dB':>10}")
    for path in arguments.stacks:
        with open_stack(path) as stack:
            fitted, held_out = split_chosen(stack.directions_i3, arguments.holdout)
            for basis in BASES:
                for found in measure_rti(stack, fitted, held_out, basis, QUALITIES):
                    quality = "float" if found.quality is None else found.quality
                    print(
                        f"{stack.name:16} {basis:6} {quality:>5} {found.encoded_bytes / 1000:9.1f}"
                        f" {found.psnr_pooled:12.2f} {found.psnr_mean:8.2f} {found.psnr_pooled_fitted:10.2f}"
                    )


if __name__ == "__main__":
    main()
