"""Files made ready to be shown: what the page is told of them, as a page on disk or behind a server."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from clrelight.device import Device
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.jobs.inputs import opened_on, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_stops
from clrelight.view.document import page_pieces, start_tables, tile_names
from clrelight.view.lights import light_degree, read_surroundings, sky_tables
from clrelight.view.server import ViewServer
from clrelight.view.sources import PayloadSource, Source, StackSource, opened_source
from clrelight.view.texels import BORDER, TILE

PLANES = ("half", "uint8")
"""What planes that are decoded here are sent as: floats of 16 bits, or bytes between the extremes of each tile."""

_MOST_BYTES = 1 << 29
"""Of data in a page on disk: browsers hold no longer text."""

Path = str | os.PathLike[str]


@dataclass(frozen=True)
class Session:
    """Open files, and what the page is told of them."""

    sources: list[Source]
    manifest: dict[str, Any]


@contextmanager
def opened_session(
    files: Sequence[Path],
    environments: Sequence[Path],
    reference: Path | None,
    planes: str,
    exposure: float | str,
    device: Callable[[], Device],
    report: Report,
) -> Iterator[Session]:
    """Open files for a page; InputError where one is nothing that a page can show, or sizes differ."""
    if not files:
        raise InputError("the viewer needs at least 1 file")
    if planes not in PLANES:
        raise InputError(f"planes must be one of {', '.join(PLANES)}, got {planes!r}")
    stops = count_stops(exposure)
    with ExitStack() as stack:
        paths = [*files, *([] if reference is None else [reference])]
        sources = [stack.enter_context(opened_source(path, device, report)) for path in paths]
        _check_sizes(sources)
        degrees = [source.record["degree"] for source in sources if "degree" in source.record]
        if not degrees:
            raise InputError(
                "the viewer relights fits and encodings: give one that clrelight fit or pack makes of "
                f"{sources[0].name}, which may then be the --reference"
            )
        degree = light_degree(degrees)
        surroundings = []
        for path in environments:
            made, notes = read_surroundings(path, degree, device)
            report.note(*notes)
            surroundings.append(made)
        manifest = {
            "title": sources[0].name,
            "files": [source.facts() for source in sources],
            "reference": None if reference is None else len(sources) - 1,
            "planes": planes,
            "exposure": 0.0 if stops is None else stops,
            "on_disk": False,
            "light_degree": degree,
            "skies": sky_tables(degree),
            "environments": surroundings,
            "start": start_tables() if any(isinstance(source, PayloadSource) for source in sources) else "",
        }
        yield Session(sources, manifest)


def _opener(device: Device | str | None, report: Report) -> Callable[[], Device]:
    """Return what opens the device at its first call."""

    @functools.cache
    def opened() -> Device:
        with opened_on(device, report) as found:
            return found

    return opened


def _check_sizes(sources: Sequence[Source]) -> None:
    height, width, _ = sources[0].image_shape
    for other in sources[1:]:
        if other.image_shape[:2] != (height, width):
            raise InputError(
                f"{other.name} has {other.image_shape[1]} × {other.image_shape[0]} pixels and {sources[0].name} "
                f"{width} × {height}: only pictures of one view can be compared"
            )


def write_viewer(
    files: Path | Sequence[Path],
    out: Path,
    *,
    environments: Sequence[Path] = (),
    reference: Path | None = None,
    planes: str = "half",
    exposure: float | str = 0.0,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write a page that shows files under any light, with everything in it: it works from disk and asks for nothing.

    Parameters
    ----------
    files : path, or sequence of paths
        Fits and encodings of one view. Payloads of `klt` go into the page as they are; of others, planes do.
    out : path
        The page, ``.html``.
    environments : sequence of paths
        Environment maps or light files that the page offers.
    reference : path, optional
        A stack, a fit or an encoding that the files are compared with.
    planes : str
        ``"half"`` or ``"uint8"``: what is sent of files that the page does not decode.
    exposure : float
        Stops that the page begins with.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``file`` and ``bytes``.

    Raises
    ------
    InputError
        If a file cannot be shown, the page would pass what browsers hold, or `out` cannot be written.
    """
    listed = [files] if isinstance(files, str | os.PathLike) else list(files)
    target, kept, since = path_text(out, "a page to write"), report_for(report), time.perf_counter()
    inputs = paths_among(*listed, *environments, reference)
    with (
        claimed([target], inputs, kept),
        opened_session(listed, environments, reference, planes, exposure, _opener(device, kept), kept) as session,
    ):
        since = kept.add("open", since)
        _check_room(session, planes)
        session.manifest["on_disk"] = True
        with replacing(target) as part, stage(progress, "writing") as tell:
            data = _data_of(session, planes, tell)
            for piece in page_pieces(session.manifest, data, served=False):
                part.write(piece.encode("utf-8"))
            kept.add("write", since)
    kept.facts = {"file": target, "bytes": os.path.getsize(target), **kept.facts}
    return kept


def _texel_bytes(source: Source, planes: str) -> int:
    """Return about the bytes of all tiles of a file."""
    height, width, _ = source.image_shape
    lights = source.record["lights"] if isinstance(source, StackSource) else 1
    layers = 1 if isinstance(source, StackSource) else -(-source.facts()["planes"] // 4)
    each = 8 if planes == "half" or isinstance(source, StackSource) else 4
    levels = 4 / 3 if source.levels else 1
    return int(lights * layers * each * height * width * levels * (1 + 4 * BORDER / TILE))


def _check_room(session: Session, planes: str) -> None:
    """Raise InputError where a page would be larger than browsers open."""
    sizes = [
        len(source.body) if isinstance(source, PayloadSource) else _texel_bytes(source, planes)
        for source in session.sources
    ]
    if sum(sizes) * 4 // 3 > _MOST_BYTES:
        largest = session.sources[sizes.index(max(sizes))]
        raise InputError(
            f"the page would have {sum(sizes) * 4 / 3e6:.0f} MB, most of it {largest.name}, and browsers open "
            f"{_MOST_BYTES / 1e6:.0f}: encode it by klt, take --planes uint8, or serve it without --out"
        )


def _data_of(session: Session, planes: str, tell: Any) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of what a page on disk carries."""
    count = len(session.sources)
    for number, source in enumerate(session.sources):
        tell(number, count)
        if isinstance(source, PayloadSource):
            yield f"body-{number}", source.read(0, len(source.body))
            continue
        lights = source.record["lights"] if isinstance(source, StackSource) else 1
        for light in range(lights):
            for place in tile_names(*source.image_shape[:2], source.levels):
                name = "-".join(str(each) for each in (number, *place, light))
                yield f"tile-{name}", source.tile(*place, light, planes)
    tell(count, count)


@contextmanager
def served_viewer(
    files: Sequence[Path],
    *,
    environments: Sequence[Path] = (),
    reference: Path | None = None,
    planes: str = "half",
    exposure: float | str = 0.0,
    port: int = 0,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Iterator[ViewServer]:
    """Lend a server of the page that `write_viewer` writes, bound to loopback; arguments as there.

    ``serve_forever`` answers until ``shutdown``. InputError where a port is taken, or a file cannot be shown.
    """
    kept = report_for(report)
    with (
        opened_session(files, environments, reference, planes, exposure, _opener(device, kept), kept) as session,
    ):
        try:
            server = ViewServer(session.sources, session.manifest, planes, port)
        except OSError as error:
            raise InputError(f"port {port} cannot be had: {error.strerror or error}") from None
        with server:
            yield server
