"""`spectrum` of values as displayed: fitted on the sRGB curve, turned into radiance in many directions, fitted there.

A highlight is smoother, and a shadow as important as a light, on the curve by which people see. What lights add is
radiance, so that is what coefficients are of: with W the weights of `spectrum` at points all over the hemisphere and S
least squares at these points, ``c = S decode(W code)``. No linear map of samples, but two with a curve between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit.columns import launch_columns
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.leave_out_error import Trials
from clrelight.fit.places import spread_points
from clrelight.fit.plan import FitPlan, Lighting, is_sphere
from clrelight.fit.registry import Columns, FitMethod, Shrunk, register
from clrelight.fit.samples import Samples
from clrelight.fit.spectrum import SpectrumFit, describe
from clrelight.fit.zonal import LARGEST_DEGREE, power_variances
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.matmul import ENCODED, SampleCurve
from clrelight.threads import on_one_thread

_BRIGHTEST = 1.25
"""Of the curve; as the kernel has it."""
_RIDGE, _SLOPE, _LEAST_VARIANCE = 1e-6, 2.0, 1e-4
"""Of the least squares over points: its weight, the power by which variances fall with the degree, and their bound."""
_POINTS_A_COEFFICIENT, _POINTS = 2, 60
"""With fewer points than coefficients, such as four for a light, 0.05 dB are lost on most stacks and 3 on mirrors."""


@register
@dataclass(frozen=True)
class CurvedSpectrumFit(SpectrumFit):
    """``c = S decode(A' Y_t' (Y A Y' + N)^-1 code)``: kriging of values on the sRGB curve, radiance of what they say.

    Of integer images only, none of which is brighter than `_BRIGHTEST`. Attributes are those of `SpectrumFit`, learnt
    from values as displayed.
    """

    id = "spectrum-curve"
    title = "Spectrum, curve"
    summary = "spectrum fitted to values as displayed (sRGB curve), then turned into radiance"

    @property
    def is_linear(self) -> bool:
        """See `FitMethod`."""
        return False

    def curve_of(self, stack: LightStack) -> SampleCurve:
        """Return how kernels read values as displayed, in units of the peak."""
        return SampleCurve(stack.peak, "linear" if stack.transfer == "srgb" else ENCODED)

    def refusal(self, samples: Samples) -> str | None:
        """Return why values cannot be fitted as displayed, None where they can."""
        if (dtype := samples.source.images_ihwc.dtype).kind != "u":
            return f"{self.id} fits integer code values; these images are {dtype}: take spectrum"
        stack = samples.stack
        most = stack.peak * (_BRIGHTEST if stack.transfer == "srgb" else srgb_to_linear(np.float64(_BRIGHTEST)))
        if (brightest := stack.images_ihwc.max()) > most:
            told = f"under a peak of {stack.peak:g}, one is {brightest}"
            return f"{self.id} fits code values up to {most:.0f} {told}: take spectrum"
        return None

    def view(self, trials: Trials) -> Trials:
        """See `SpectrumFit`."""
        linear = trials.samples.stack.transfer == "linear"
        return CurvedTrials(show_samples(trials.samples), trials.weights, trials.sampling, linear)

    def relit(
        self, model: KrigingModel, samples: Samples, degree: int, targets_t3: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `SpectrumFit`."""
        weights_ti, series_kt = plan_series(model, degree)
        radiance_kp = series_kt @ decode(weights_ti @ samples.radiance_ip)
        return linear_to_srgb(np.maximum(evaluate_basis(targets_t3, degree) @ radiance_kp, 0.0))

    def settle(self, lighting: Lighting, degree: int, samples: Samples) -> FitMethod:
        """Return the method with every parameter found; InputError of images that are not integers, or too bright."""
        if (refusal := self.refusal(samples)) is not None:
            raise InputError(refusal)
        return super().settle(lighting, degree, show_samples(samples))

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return W and S."""
        with on_one_thread():
            model = self.model(lighting)
            weights_ti, series_kt = plan_series(model, degree)
        energy_i = 4.0 * np.pi * lighting.solid_angles_i / lighting.solid_angles_i.sum()
        return FitPlan(weights_ti, series_kt, np.ones(len(weights_ti)), energy_i, 1.0, describe(model, degree))

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Turn values on the curve into radiance, in place."""
        launch_columns(device, "fit/decode_curve.cl", "decode_rq", columns.z_rq, *columns.z_rq.shape, defines={})
        return Shrunk()

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return radiance in units of the value on the curve."""
        return decode(z_rp) / np.where(z_rp == 0.0, 1.0, z_rp)


def decode(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return radiance of values on the curve, of any sign, as the kernel does."""
    return srgb_to_linear(np.minimum(value, _BRIGHTEST))


def show_samples(samples: Samples) -> Samples:
    """Return the same pixels as they are displayed, as a stack that is linear in them."""
    stack = samples.stack
    if stack.transfer == "srgb":
        return Samples.holding(replace(stack, transfer="linear"))
    shown = linear_to_srgb(stack.images_ihwc / np.float64(stack.peak)).astype(np.float32)
    return Samples.holding(replace(stack, images_ihwc=shown, peak=1.0))


def plan_series(model: KrigingModel, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the weights of samples at points, and the least squares that makes coefficients of values there.

    Returns
    -------
    ndarray, shape (n_point, n_light)
    ndarray, shape (n_coeff, n_point)
        0 above `LARGEST_DEGREE`.
    """
    kept = min(degree, LARGEST_DEGREE)
    n_coeff = coefficient_count(kept)
    points = spread_points(_POINTS_A_COEFFICIENT * n_coeff + _POINTS, is_sphere(model.places.directions_g3))
    basis_tk = evaluate_basis(points, kept)
    ridge_k = _RIDGE / np.maximum(power_variances(_SLOPE), _LEAST_VARIANCE)[degrees_of_coefficients(kept)]
    moments_kk = basis_tk.T @ basis_tk / len(points) + np.diag(ridge_k)
    series_kt = np.linalg.solve(moments_kk, basis_tk.T / len(points))
    return model.weights_at(points), np.pad(series_kt, ((0, coefficient_count(degree) - n_coeff), (0, 0)))


@dataclass
class CurvedTrials(Trials):
    """Trials of values as displayed; errors are in the stack's own code values, as those of other methods."""

    encoded: bool = False
    """Whether the stack's own are linear."""

    def show(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `Trials`; what it is given is on the curve."""
        shown = np.clip(radiance, 0.0, 1.0)
        return srgb_to_linear(shown) if self.encoded else shown
