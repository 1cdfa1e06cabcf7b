"""The registry of fits: what one is, and how it is found by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.configurable import Configurable
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import unknown
from clrelight.fit.plan import FitPlan, Lighting
from clrelight.fit.samples import Samples
from clrelight.matmul import SampleCurve
from clrelight.opencl.arguments import DeviceArray

_REGISTRY: dict[str, type[FitMethod]] = {}


@dataclass(frozen=True)
class Columns:
    """The columns of one tile on the device.

    Attributes
    ----------
    source_ip : DeviceArray, shape (n_light, P)
        Code values.
    curve : SampleCurve
        What turns them into radiance.
    z_rq : DeviceArray, shape (rank, Q), float32, or float64 in double precision
        Components, Q being P padded; `FitMethod.shrink` changes them in place.
    energy_q : DeviceArray, shape (Q,), of the same type
        The bound E_c.
    singular_r : DeviceArray, shape (rank,), of the same type
    precision : str
        One of `clrelight.fit.precision.PRECISIONS`.
    exponent_p : ndarray, shape (P,), int, or None
        Samples are 2 to minus this times the stack's (`clrelight.fit.scaling`); None: they are the same.
    """

    source_ip: DeviceArray
    curve: SampleCurve
    z_rq: DeviceArray
    energy_q: DeviceArray
    singular_r: DeviceArray
    precision: str
    exponent_p: NDArray[np.intc] | None = None


@dataclass(frozen=True)
class Shrunk:
    """What a shrink leaves beside the components: a map of lambda or of ranks, where the method has one.

    `unmet_q` is int32 and not 0 where a column cannot have what the method promises (`FitMethod.unmet`).
    """

    lambda_q: DeviceArray | None = None
    rank_q: DeviceArray | None = None
    unmet_q: DeviceArray | None = None


OnePass = Callable[[DeviceArray, DeviceArray], Shrunk]
"""Takes code values, shape (n_light, P), fills coefficients, shape (n_coeff, P), and returns the maps beside them."""


class FitMethod(Configurable, ABC):
    """A way to fit coefficients. Subclasses are frozen dataclasses with an `id`; their fields are the options.

    A fit is ``coefficients = synthesis shrink(analysis samples)``: two matrices from `plan`, and between them
    something per column, which linear methods do without.
    """

    kind: ClassVar[str] = "method"
    summary: ClassVar[str]
    title: ClassVar[str]
    has_lambda: ClassVar[bool] = False
    has_rank: ClassVar[bool] = False
    settled_from: ClassVar[int] = 0
    """`settle` finds the same at all degrees up to this one."""
    takes_bases: ClassVar[bool] = False
    """Whether it fits other bases than spherical harmonics too (`clrelight.bases`)."""
    unmet: ClassVar[str] = ""
    """What a user is told of a pixel that `Shrunk.unmet_q` marks."""
    is_regression: ClassVar[bool] = True
    """Whether leaving a light out changes nothing but that the others alone are fitted."""

    @property
    def is_linear(self) -> bool:
        """Whether coefficients are ``synthesis analysis samples``, with nothing between for a column."""
        return type(self).shrink is FitMethod.shrink

    @property
    def is_refined(self) -> bool:
        """Whether mixed precision solves some columns again in float64; where not, it is single precision."""
        return False

    def arithmetic(self, precision: str, device: Device) -> str:
        """Return the precision that all columns are computed in where this one is asked for."""
        return precision

    def note_precision(self, plan: FitPlan, precision: str) -> str | None:
        """Return what a user should know about this precision of a fit, where there is anything."""
        return None

    def settle(self, lighting: Lighting, degree: int, samples: Samples) -> FitMethod:
        """Return the method with every option set that it leaves to the data; `samples` are read where needed only."""
        return self

    @abstractmethod
    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices for these lights; InputError where the method cannot fit this degree to them."""

    def curve_of(self, stack: LightStack) -> SampleCurve | None:
        """Return how kernels read a stack's samples where it is not as radiance."""
        return None

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Queue the change of the components in place."""
        return Shrunk()

    def one_pass(self, device: Device, plan: FitPlan, curve: SampleCurve, precision: str) -> OnePass | None:
        """Return a way from samples to coefficients without the steps between, where there is one for this request."""
        return None

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return what `shrink` multiplies each component with, in float64 on the host.

        With it the fit's values are ``f = B (g z)``, ``B = Y synthesis``, and the weight of a sample in its own fit is
        ``H_ii = sum_r B_ir g_r analysis_ri``, which is what prediction at unseen lights needs.

        Parameters
        ----------
        plan : FitPlan
        z_rp : ndarray, shape (rank, P), float64
            ``analysis beta`` of some columns.
        energy_p : ndarray, shape (P,), float64
            Their bound E_c.

        Returns
        -------
        ndarray, shape (rank, P) or (rank, 1), float64
        """
        if type(self).shrink is not FitMethod.shrink:
            raise NotImplementedError(f"{self.id} shrinks components, so it must say by how much")
        return np.ones((len(z_rp), 1))

    def allocate_maps(self, device: Device, columns: int) -> Shrunk:
        """Return the maps that `shrink` fills, uninitialised."""
        return Shrunk(
            device.empty((columns,), np.float32) if self.has_lambda else None,
            device.empty((columns,), np.int32) if self.has_rank else None,
        )


def register(method: type[FitMethod]) -> type[FitMethod]:
    """Enter a method class under its id (a class decorator); ValueError if the id is taken."""
    if method.id in _REGISTRY:
        raise ValueError(f"a fit {method.id!r} is registered already: {_REGISTRY[method.id]!r}")
    _REGISTRY[method.id] = method
    return method


def method_ids() -> list[str]:
    """Return the known ids, in the order of registration."""
    return list(_REGISTRY)


def method_class(method_id: str) -> type[FitMethod]:
    """Return the class of an id; InputError lists the known ones."""
    if method_id not in _REGISTRY:
        raise unknown("method", method_id, method_ids())
    return _REGISTRY[method_id]
