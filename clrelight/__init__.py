"""clrelight: fit, compress, relight and measure image stacks of one view under many lights.

The verbs are those of the command line (docs/python.md): `ingest`, `fit`, `encode`, `decode`, `relight`, `measure`,
`export`. The names below are imported when first used, so that ``import clrelight`` costs nothing.
"""

from __future__ import annotations

import sys
from types import ModuleType

TYPE_CHECKING = False  # typing's own would take most of the time of this import, in which Ctrl-C prints a traceback
if TYPE_CHECKING:  # what type checkers see; at run time __getattr__ imports the same names, see _HOMES
    from typing import Any

    from clrelight.codec import Encoded as Encoded
    from clrelight.codec import codec_class as codec_class
    from clrelight.dataset import CoefficientMap as CoefficientMap
    from clrelight.dataset import LightStack as LightStack
    from clrelight.device import open_device as open_device
    from clrelight.errors import DeviceError as DeviceError
    from clrelight.errors import InputError as InputError
    from clrelight.experiment import run_experiment as run_experiment
    from clrelight.export import export_textures as export_textures
    from clrelight.harmonics.rotation import rotation_matrix as rotation_matrix
    from clrelight.ingest import ingest_folder as ingest_folder
    from clrelight.jobs.decode import decode as decode
    from clrelight.jobs.encode import encode as encode
    from clrelight.jobs.export import export as export
    from clrelight.jobs.fit import fit as fit
    from clrelight.jobs.ingest import ingest as ingest
    from clrelight.jobs.measure import measure as measure
    from clrelight.jobs.relight import relight as relight
    from clrelight.jobs.report import Note as Note
    from clrelight.jobs.report import Report as Report
    from clrelight.jobs.target import encode_to_quality as encode_to_quality
    from clrelight.lighting.environment import Environment as Environment
    from clrelight.lighting.environment import read_environment as read_environment
    from clrelight.lighting.lamps import blend_lights as blend_lights
    from clrelight.lighting.lamps import cap_light as cap_light
    from clrelight.lighting.lamps import cast_shadow as cast_shadow
    from clrelight.lighting.lamps import directional_light as directional_light
    from clrelight.lighting.light import Light as Light
    from clrelight.lighting.projection import project_environment as project_environment
    from clrelight.lighting.rotation import rotate_light as rotate_light
    from clrelight.lighting.sky import sky_light as sky_light
    from clrelight.metrics import measure_errors as measure_errors
    from clrelight.metrics import summarize_errors as summarize_errors
    from clrelight.opencl.devices import list_devices as list_devices
    from clrelight.report import write_report as write_report
    from clrelight.store import open_fit as open_fit
    from clrelight.store import open_stack as open_stack
    from clrelight.store import read_encoded as read_encoded
    from clrelight.store import read_fit as read_fit
    from clrelight.store import read_light as read_light
    from clrelight.store import read_results as read_results
    from clrelight.store import write_encoded as write_encoded
    from clrelight.store import write_fit as write_fit
    from clrelight.store import write_light as write_light
    from clrelight.store import write_stack as write_stack

__version__ = "0.1.0"

_HOMES = {
    "CoefficientMap": "clrelight.dataset",
    "DeviceError": "clrelight.errors",
    "Encoded": "clrelight.codec",
    "Environment": "clrelight.lighting.environment",
    "InputError": "clrelight.errors",
    "Light": "clrelight.lighting.light",
    "LightStack": "clrelight.dataset",
    "Note": "clrelight.jobs.report",
    "Report": "clrelight.jobs.report",
    "blend_lights": "clrelight.lighting.lamps",
    "cap_light": "clrelight.lighting.lamps",
    "cast_shadow": "clrelight.lighting.lamps",
    "codec_class": "clrelight.codec",
    "decode": "clrelight.jobs.decode",
    "directional_light": "clrelight.lighting.lamps",
    "encode": "clrelight.jobs.encode",
    "encode_to_quality": "clrelight.jobs.target",
    "export": "clrelight.jobs.export",
    "export_textures": "clrelight.export",
    "fit": "clrelight.jobs.fit",
    "ingest": "clrelight.jobs.ingest",
    "ingest_folder": "clrelight.ingest",
    "list_devices": "clrelight.opencl.devices",
    "measure": "clrelight.jobs.measure",
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
    "relight": "clrelight.jobs.relight",
    "rotate_light": "clrelight.lighting.rotation",
    "rotation_matrix": "clrelight.harmonics.rotation",
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


class _Verb:
    """Keeps a name the verb, although the module of this name is loaded beside it and would take its place."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, package: ModuleType | None, kind: type) -> Any:
        return __getattr__(self._name)

    def __set__(self, package: ModuleType, module: ModuleType) -> None:
        pass


class _Package(ModuleType):
    """The package, whose verbs of the names of its modules stay verbs."""

    export, fit, ingest, relight = map(_Verb, ("export", "fit", "ingest", "relight"))


sys.modules[__name__].__class__ = _Package
