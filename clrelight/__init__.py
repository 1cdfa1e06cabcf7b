"""clrelight: fit, compress, relight and measure image stacks of one view under many lights.

The names below are imported when first used, so that ``import clrelight`` costs nothing.
"""

from __future__ import annotations

import sys
from types import ModuleType

TYPE_CHECKING = False  # typing's own would take most of the time of this import, in which Ctrl-C prints a traceback
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "CoefficientMap": "clrelight.dataset",
    "Environment": "clrelight.lighting.environment",
    "Light": "clrelight.lighting.light",
    "LightStack": "clrelight.dataset",
    "blend_lights": "clrelight.lighting.lamps",
    "cap_light": "clrelight.lighting.lamps",
    "cast_shadow": "clrelight.lighting.lamps",
    "codec_class": "clrelight.codec",
    "decode": "clrelight.codec",
    "directional_light": "clrelight.lighting.lamps",
    "encode": "clrelight.codec",
    "encode_to_quality": "clrelight.experiment.target",
    "export_textures": "clrelight.export",
    "fit": "clrelight.fit.run",
    "ingest_folder": "clrelight.ingest",
    "list_devices": "clrelight.device",
    "measure_errors": "clrelight.metrics",
    "open_device": "clrelight.device",
    "open_fit": "clrelight.store",
    "open_stack": "clrelight.store",
    "project_environment": "clrelight.lighting.projection",
    "read_encoded": "clrelight.store",
    "read_environment": "clrelight.lighting.environment",
    "read_fit": "clrelight.store",
    "read_light": "clrelight.store",
    "read_results": "clrelight.store",
    "relight": "clrelight.relight",
    "rotate_light": "clrelight.lighting.rotation",
    "rotation_matrix": "clrelight.lighting.rotation",
    "run_experiment": "clrelight.experiment",
    "sky_light": "clrelight.lighting.sky",
    "summarize_errors": "clrelight.metrics",
    "write_encoded": "clrelight.store",
    "write_fit": "clrelight.store",
    "write_light": "clrelight.store",
    "write_report": "clrelight.report",
    "write_stack": "clrelight.store",
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    importlib.import_module(_HOMES[name])
    return getattr(sys.modules[_HOMES[name]], name)


def __dir__() -> list[str]:
    return __all__


class _Package(ModuleType):
    """Keep `fit` and `relight` the functions, although modules of these names are loaded beside them."""

    @property
    def fit(self) -> Any:
        """See `clrelight.fit.run.fit`."""
        return __getattr__("fit")

    @fit.setter
    def fit(self, module: ModuleType) -> None:
        pass

    @property
    def relight(self) -> Any:
        """See `clrelight.relight.relight`."""
        return __getattr__("relight")

    @relight.setter
    def relight(self, module: ModuleType) -> None:
        pass


sys.modules[__name__].__class__ = _Package
