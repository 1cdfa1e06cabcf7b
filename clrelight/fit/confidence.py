"""The PSNR that a fit by `spectrum` is expected to reach under every light of the hemisphere, as a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit.expectation import expect_at
from clrelight.fit.leave_out_error import Trials
from clrelight.fit.registry import FitMethod
from clrelight.fit.samples import Samples
from clrelight.fit.spectrum import SpectrumFit
from clrelight.threads import on_one_thread

SIZE = 128
"""Height and width of the picture in pixels."""


def map_confidence(stack: LightStack, method: FitMethod, weights: str, sampling: str) -> NDArray[np.float32]:
    """Return the expected PSNR in dB under each light direction, (SIZE, SIZE, 1): the hemisphere seen from above.

    x goes right, y up; the centre is the zenith, the disc's rim the horizon. 0 outside.

    Parameters
    ----------
    stack : LightStack
        The lights that were fitted.
    method : FitMethod
        A settled `SpectrumFit`.
    weights, sampling : str
        As in `clrelight.fit.fit`.

    Raises
    ------
    InputError
        If the method has no variance to tell it from.
    """
    if not isinstance(method, SpectrumFit):
        raise InputError(f"a confidence map shows the variance that spectrum has; {method.id} has none")
    centre = (np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0
    x_hw, y_hw = np.meshgrid(centre, -centre)
    inside_hw = x_hw**2 + y_hw**2 <= 1.0
    x, y = x_hw[inside_hw], y_hw[inside_hw]
    trials = method.view(Trials.make(Samples(stack), weights, sampling))
    psnr_hw1 = np.zeros((SIZE, SIZE, 1), np.float32)
    with on_one_thread():
        directions_t3 = np.stack([x, y, np.sqrt(1.0 - x**2 - y**2)], axis=1)
        psnr_hw1[inside_hw, 0] = expect_at(method.model(trials.lighting), trials, directions_t3)
    return psnr_hw1
