"""clrelight: fit, compress, relight and measure image stacks of one view under many lights.

The verbs are those of the command line (docs/python.md): `pack`, `unpack`, `ingest`, `fit`, `encode`, `decode`,
`relight`, `measure`, `export`. The names below are imported when first used, so that ``import clrelight`` costs
nothing.
"""

from __future__ import annotations

import sys
from types import ModuleType

TYPE_CHECKING = False  # typing's own would take most of the time of this import, in which Ctrl-C prints a traceback
if TYPE_CHECKING:  # what type checkers see; at run time __getattr__ imports the same names, see _HOMES
    from typing import Any

    from clrelight.brdf.named import make_brdf as make_brdf
    from clrelight.brdf.named import parse_brdf as parse_brdf
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
    from clrelight.jobs.archives import import_archive as import_archive
    from clrelight.jobs.decode import decode as decode
    from clrelight.jobs.encode import encode as encode
    from clrelight.jobs.exchange import export_for_viewers as export_for_viewers
    from clrelight.jobs.export import export as export
    from clrelight.jobs.fit import fit as fit
    from clrelight.jobs.ingest import ingest as ingest
    from clrelight.jobs.light_lists import export_lights as export_lights
    from clrelight.jobs.measure import measure as measure
    from clrelight.jobs.pack import pack as pack
    from clrelight.jobs.preview import preview as preview
    from clrelight.jobs.reflection.build import build_reflection as build_reflection
    from clrelight.jobs.reflection.estimate import estimate_reflectance as estimate_reflectance
    from clrelight.jobs.reflection.estimate import recognise_material as recognise_material
    from clrelight.jobs.reflection.plan import plan_reflection as plan_reflection
    from clrelight.jobs.reflection.render import render_reflection as render_reflection
    from clrelight.jobs.relight import relight as relight
    from clrelight.jobs.report import Note as Note
    from clrelight.jobs.report import Report as Report
    from clrelight.jobs.surface.operators import transfer_operators as transfer_operators
    from clrelight.jobs.surface.reflect import reflect as reflect
    from clrelight.jobs.surface.render import render as render
    from clrelight.jobs.surface.transfer import transfer as transfer
    from clrelight.jobs.target import encode_to_quality as encode_to_quality
    from clrelight.jobs.to_sh import to_sh as to_sh
    from clrelight.jobs.unpack import unpack as unpack
    from clrelight.jobs.update import update_fit as update_fit
    from clrelight.jobs.variation.basis import basis_images as basis_images
    from clrelight.jobs.variation.components import inverse_lighting as inverse_lighting
    from clrelight.jobs.variation.components import principal_components as principal_components
    from clrelight.jobs.variation.find_lights import find_lights as find_lights
    from clrelight.jobs.variation.normals import normals as normals
    from clrelight.jobs.variation.recognition import recognise as recognise
    from clrelight.jobs.variation.subspaces import compare_subspaces as compare_subspaces
    from clrelight.lighting.environment import Environment as Environment
    from clrelight.lighting.environment import read_environment as read_environment
    from clrelight.lighting.expressions import parse_expression as parse_expression
    from clrelight.lighting.lamps import blend_lights as blend_lights
    from clrelight.lighting.lamps import cap_light as cap_light
    from clrelight.lighting.lamps import cast_shadow as cast_shadow
    from clrelight.lighting.lamps import directional_light as directional_light
    from clrelight.lighting.light import Light as Light
    from clrelight.lighting.projection import project_environment as project_environment
    from clrelight.lighting.rotation import rotate_light as rotate_light
    from clrelight.lighting.sampled import multiply_lights as multiply_lights
    from clrelight.lighting.sampled import sample_light as sample_light
    from clrelight.lighting.sky import sky_light as sky_light
    from clrelight.metrics import measure_errors as measure_errors
    from clrelight.metrics import summarize_errors as summarize_errors
    from clrelight.opencl.devices import list_devices as list_devices
    from clrelight.report import write_report as write_report
    from clrelight.shrm.record import Shrm as Shrm
    from clrelight.store import open_fit as open_fit
    from clrelight.store import open_stack as open_stack
    from clrelight.store import read_encoded as read_encoded
    from clrelight.store import read_fit as read_fit
    from clrelight.store import read_light as read_light
    from clrelight.store import read_results as read_results
    from clrelight.store import read_shrm as read_shrm
    from clrelight.store import read_stack as read_stack
    from clrelight.store import write_encoded as write_encoded
    from clrelight.store import write_fit as write_fit
    from clrelight.store import write_light as write_light
    from clrelight.store import write_shrm as write_shrm
    from clrelight.store import write_stack as write_stack
    from clrelight.surface import Surface as Surface
    from clrelight.transfer.cameras import Camera as Camera
    from clrelight.transfer.cameras import Framing as Framing
    from clrelight.transfer.local_light import LocalLights as LocalLights
    from clrelight.transfer.mesh_files import read_mesh as read_mesh
    from clrelight.transfer.near_lights import PointLight as PointLight
    from clrelight.transfer.near_lights import PolygonLight as PolygonLight
    from clrelight.transfer.near_lights import SphereLight as SphereLight
    from clrelight.view.session import write_viewer as write_viewer

__version__ = "0.1.0"

_MODULES = {
    "brdf.named": "make_brdf parse_brdf",
    "codec": "Encoded codec_class",
    "dataset": "CoefficientMap LightStack",
    "device": "open_device",
    "errors": "DeviceError InputError",
    "experiment": "run_experiment",
    "export": "export_textures",
    "harmonics.rotation": "rotation_matrix",
    "ingest": "ingest_folder",
    "jobs.archives": "import_archive",
    "jobs.decode": "decode",
    "jobs.encode": "encode",
    "jobs.exchange": "export_for_viewers",
    "jobs.light_lists": "export_lights",
    "jobs.export": "export",
    "jobs.variation.find_lights": "find_lights",
    "jobs.fit": "fit",
    "jobs.ingest": "ingest",
    "jobs.measure": "measure",
    "jobs.surface.operators": "transfer_operators",
    "jobs.variation.normals": "normals",
    "jobs.pack": "pack",
    "jobs.preview": "preview",
    "jobs.variation.recognition": "recognise",
    "jobs.surface.reflect": "reflect",
    "jobs.reflection.build": "build_reflection",
    "jobs.reflection.estimate": "estimate_reflectance recognise_material",
    "jobs.reflection.plan": "plan_reflection",
    "jobs.reflection.render": "render_reflection",
    "jobs.relight": "relight",
    "jobs.surface.render": "render",
    "jobs.report": "Note Report",
    "jobs.variation.subspaces": "compare_subspaces",
    "jobs.target": "encode_to_quality",
    "jobs.to_sh": "to_sh",
    "jobs.surface.transfer": "transfer",
    "jobs.unpack": "unpack",
    "jobs.update": "update_fit",
    "jobs.variation.basis": "basis_images",
    "jobs.variation.components": "inverse_lighting principal_components",
    "lighting.environment": "Environment read_environment",
    "lighting.expressions": "parse_expression",
    "lighting.lamps": "blend_lights cap_light cast_shadow directional_light",
    "lighting.light": "Light",
    "lighting.projection": "project_environment",
    "lighting.rotation": "rotate_light",
    "lighting.sampled": "multiply_lights sample_light",
    "lighting.sky": "sky_light",
    "metrics": "measure_errors summarize_errors",
    "opencl.devices": "list_devices",
    "report": "write_report",
    "shrm.record": "Shrm",
    "store": "open_fit open_stack read_encoded read_fit read_light read_results read_shrm read_stack "
    "write_encoded write_fit write_light write_shrm write_stack",
    "surface": "Surface",
    "transfer.cameras": "Camera Framing",
    "transfer.local_light": "LocalLights",
    "transfer.mesh_files": "read_mesh",
    "transfer.near_lights": "PointLight PolygonLight SphereLight",
    "view.session": "write_viewer",
}
_HOMES = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names.split()}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        from difflib import get_close_matches

        near = "".join(f"; did you mean {each!r}?" for each in get_close_matches(name, _HOMES, 1))
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{near}")
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

    export, fit, ingest, relight, transfer = map(_Verb, ("export", "fit", "ingest", "relight", "transfer"))


sys.modules[__name__].__class__ = _Package
