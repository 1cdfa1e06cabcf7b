"""The scenes that can be rendered, and the options that each takes: what commands and experiments ask."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

PATTERNS = ("uniform", "grid", "scattered")  # noise-resistant-fitting, fig. 2
DTYPES = ("uint8", "float16", "float32")


@dataclass(frozen=True)
class Option:
    """An option of a scene.

    Attributes
    ----------
    name : str
    default : int or str
        Its type is the option's.
    help : str
        For `clrelight synth`.
    choices : tuple of str
        What a text may be.
    least, most : int
        Limits of a number.
    """

    name: str
    default: int | str
    help: str
    choices: tuple[str, ...] = ()
    least: int = 0
    most: int = (1 << 31) - 1

    @property
    def kind(self) -> type:
        """Whole number or text: int or str."""
        return type(self.default)


@dataclass(frozen=True)
class Scene:
    """A scene.

    Attributes
    ----------
    name : str
        What commands and tables call it.
    summary : str
        A sentence or two for `clrelight synth`.
    example : str
        Options of an example.
    options : tuple of Option
    renderer : str
        Module and function, ``module:function``, which takes the options and `progress`.
    """

    name: str
    summary: str
    example: str
    options: tuple[Option, ...]
    renderer: str

    def render(self, options: Mapping[str, Any], progress: Any = None) -> Any:
        """Return the `LightStack`; InputError where an option is wrong, or a package for it is not installed."""
        module, function = self.renderer.split(":")
        return getattr(importlib.import_module(module), function)(**options, progress=progress)

    def stack_name(self, options: Mapping[str, Any]) -> str:
        """Return the scene's name, behind the words in which its options differ from the usual ones."""
        words = [
            str(options[o.name]) for o in self.options if o.choices and options.get(o.name, o.default) != o.default
        ]
        return "-".join([*words, self.name])


def _options(
    size: int, size_help: str, lights_help: str, dtype: str, seed_help: str, *others: Option
) -> tuple[Option, ...]:
    return (
        Option("size", size, size_help, least=8, most=1 << 16),
        Option("lights", 256, lights_help, least=1, most=1 << 20),
        Option("pattern", "uniform", "Where they are (the paper's figure 2).", PATTERNS),
        Option("seed", 0, seed_help),
        Option("dtype", dtype, "Sample type.", DTYPES),
        *others,
    )


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene(
            "ring",
            "Rings on a textured ground, ray traced with cast shadows and highlights.",
            "--size 256 --lights 256 --pattern uniform --seed 0",
            _options(
                256, "Width and height in pixels.", "Number of lights.", "uint8", "Of the texture and scattered lights."
            ),
            "datasets_synth.ring:render_ring",
        ),
        Scene(
            "torus",
            "A white diffuse torus in its own shadow: at each vertex, what it reflects of light from each direction.",
            "--size 128 --lights 256",
            _options(
                128,
                "Rows and columns of the grid of vertices.",
                "Number of light directions, in each vertex's own frame.",
                "float32",
                "Of the tiles and scattered directions.",
                Option("albedo", "white", "Reflectance: white, or coloured tiles.", ("white", "tiles")),
            ),
            "datasets_synth.torus:render_torus",
        ),
        Scene(
            "dama",
            "A glossy sculpture in a studio's light: at each vertex, what it sends to an eye in each direction.",
            "--size 128 --lights 256 --material ggx",
            _options(
                128,
                "Rows and columns of the grid of vertices.",
                "Number of directions to eyes, in each vertex's own frame.",
                "float32",
                "Of scattered directions.",
                Option("material", "phong", "Model of the gloss.", ("phong", "blinn", "ggx")),
            ),
            "datasets_synth.dama:render_dama",
        ),
        Scene(
            "head",
            "A matte head in its own shadow; each seed is another person.",
            "--size 96 --lights 64 --seed 3",
            _options(
                96, "Width and height in pixels.", "Number of lights.", "uint8", "Of the person and scattered lights."
            ),
            "datasets_synth.heads:render_heads",
        ),
    )
}
"""By name, in the order of tables."""


def scenes_with(option: str) -> tuple[str, ...]:
    """Return the names of the scenes that take an option."""
    return tuple(scene.name for scene in SCENES.values() if any(o.name == option for o in scene.options))
