"""The page as one text: style and scripts within it, so that it works from disk and asks nobody for anything."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Iterable, Iterator, Mapping
from importlib import resources
from typing import Any

from clrelight.view.texels import TILE, level_side

DECODER = ("bytes.js", "units.js", "details.js", "body.js", "planes.js", "straight.js")
"""Scripts of which workers are made too."""
SCRIPTS = (
    *DECODER,
    *("worker.js", "harmonics.js", "lighting.js", "tiles.js", "shaders.js", "renderer.js"),
    *("view.js", "measure.js", "globe.js", "pointer.js", "panel.js", "state.js", "main.js"),
)
"""All scripts in the order in which they are read."""

# Nothing is fetched but from where the page came, and nothing at all where it is a file.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; worker-src blob:; "
    "img-src data: blob:; connect-src {connect}; base-uri 'none'; form-action 'none'"
)


def _part(name: str) -> str:
    return resources.files("clrelight.view").joinpath("page", name).read_text("utf-8")


def start_tables() -> str:
    """Return the tables that streams of `klt` start from, which are part of the format, in base64."""
    content = resources.files("clrelight.codec.entropy").joinpath("units.tables").read_bytes()
    return base64.b64encode(content).decode("ascii")


def page_pieces(manifest: Mapping[str, Any], data: Iterable[tuple[str, bytes]], *, served: bool) -> Iterator[str]:
    """Yield the text of the page, piece by piece.

    Parameters
    ----------
    manifest : mapping
        What the page is told, JSON values.
    data : iterable of (str, bytes)
        Names and contents that a page on disk carries with it.
    served : bool
        Whether the page gets its data from where it came.
    """
    title = html.escape(str(manifest["title"])).replace("{", "&#123;")  # no place of the page
    policy = _POLICY.format(connect="'self'" if served else "'none'")
    shell = _part("page.html").replace("{{title}}", title).replace("{{policy}}", policy)
    before, _, rest = shell.partition("{{style}}")
    between, _, after = rest.partition("{{scripts}}")
    yield before + _part("page.css") + between
    yield _script(json.dumps(manifest).replace("<", "\\u003c"), 'id="manifest" type="application/json"')
    for name, content in data:
        yield _script(base64.b64encode(content).decode("ascii"), f'id="data-{html.escape(name)}" type="text/plain"')
    for name in SCRIPTS:
        use = ' data-worker=""' if name in (*DECODER, "worker.js") else ""
        yield _script(_part(name), f'data-name="{name}"{use}')
    yield after


def _script(content: str, attributes: str) -> str:
    return f"<script {attributes}>\n{content}\n</script>\n"


def tile_names(height: int, width: int, levels: int) -> Iterator[tuple[int, int, int]]:
    """Yield level, row and column of all tiles of an image, the coarsest level first."""
    for level in range(levels, -1, -1):
        for row in range(-(-level_side(height, level) // TILE)):
            for column in range(-(-level_side(width, level) // TILE)):
                yield level, row, column
