"""The image files of one stack: alike in all that a stack has once, and how they were understood."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.images import read_header

_MOST_NOTES = 4


def read_headers(paths: list[Path], layer: str | None, upright: bool) -> list[ImageHeader]:
    """Return the headers of images; InputError names the first that is not like the first of all."""
    headers = [read_header(path, layer=layer, upright=upright) for path in paths]
    first = headers[0]
    for header in headers[1:]:
        for what, got, expected in (
            ("pixels", f"{header.width}×{header.height}", f"{first.width}×{first.height}"),
            ("channels", header.channels, first.channels),
            ("values", header.dtype, first.dtype),
            ("layer", header.picture.layer, first.picture.layer),
            *(
                (("data window at", header.origin_xy, first.origin_xy),)
                if header.stored_hw is None is first.stored_hw
                else ()
            ),
        ):
            if got != expected:
                raise InputError(
                    f"image {header.path} has {what} {got}, but {first.path.name} {expected}; all images must be alike"
                )
    return headers


def check_covers(headers: list[ImageHeader], kept_xywh: tuple[int, int, int, int]) -> None:
    """Raise InputError where images store different parts of the picture, and not all store what is kept."""
    areas = [header.covers for header in headers]
    if len(set(areas)) == 1:
        return
    left, top = max(area[0] for area in areas), max(area[1] for area in areas)
    right, bottom = min(area[0] + area[2] for area in areas), min(area[1] + area[3] for area in areas)
    x, y, width, height = kept_xywh
    if left <= x and top <= y and x + width <= right and y + height <= bottom:
        return
    other = next(i for i, area in enumerate(areas) if area != areas[0])
    has_some = right > left and bottom > top
    cure = (
        f"--crop {left},{top},{right - left},{bottom - top} keeps what all store" if has_some else "no pixel is in all"
    )
    raise InputError(
        f"image {headers[other].path} has data window at {areas[other][:2]}, but {headers[0].path.name} {areas[0][:2]} "
        f"({areas[other][2]}×{areas[other][3]} and {areas[0][2]}×{areas[0][3]} pixels); {cure}"
    )


def describe_headers(headers: list[ImageHeader], transfer: str | None) -> Iterator[str]:
    """Yield how image files were understood, read by a curve or, where that is None, the default's; each note once."""
    curves = (header.colours.curve_note(transfer) for header in headers)
    noted = (note for header in headers for note in header.notes)
    counts = Counter([*noted, *(note for note in curves if note is not None)]).most_common()
    for note, count in counts[:_MOST_NOTES]:
        yield f"{'all' if count == len(headers) else count} images: {note}"
    if len(counts) > _MOST_NOTES:
        yield f"and {len(counts) - _MOST_NOTES} more such notes, on single images"
    turns = Counter(header.camera_orientation for header in headers)
    if set(turns) == {1}:
        return
    several = ", ".join(f"{turn} in {count}" for turn, count in sorted(turns.items()))
    found = f"EXIF orientation {next(iter(turns))}" if len(turns) == 1 else f"mixed EXIF orientations ({several})"
    yield f"images carry {found}, not applied: pixels lie as they are stored (--upright turns them)"
