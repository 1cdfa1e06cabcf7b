"""Where viewers look for the tiles of an image: Deep Zoom, Google Maps, Zoomify, IIIF, and OpenLIME's two archives.

Names and numbers of the first four are those of their makers; ``.tzi`` and ``.tzb`` are what relight writes and
OpenLIME's `LayoutTiles` asks for. Levels count from the coarsest, 0, which is one tile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from clrelight.errors import InputError, unknown
from clrelight.exchange.pyramid import Cut

ARCHIVES = ("tarzoom", "itarzoom")
"""Layouts of which all tiles of a plane, or of all planes, lie in one file."""
_GROUP = 256
"""Tiles of one folder of Zoomify."""


@dataclass(frozen=True)
class Layout:
    """A way to lay out tiles.

    Attributes
    ----------
    name : str
    cut : Cut
        Of sides 0, until `Layout.of` puts in those of a picture.
    pads : bool
        Whether tiles at the rim are filled up to whole ones.
    """

    name: str
    cut: Cut
    pads: bool = False

    def of(self, height: int, width: int) -> Layout:
        """Return the layout of a picture, whose one tile is no larger than it; InputError where it cannot be shown."""
        longer, tile = max(height, width), self.cut.tile
        if self.pads and 2 * longer <= tile:
            raise InputError(f"{self.name} tiles are for pictures of more than {tile // 2} pixels, this has {longer}")
        # OpenLIME counts levels by the logarithm of what a tile is smaller than the picture.
        tile = tile if self.pads or self.name == "iiif" else min(tile, longer)
        return replace(self, cut=replace(self.cut, height=height, width=width, tile=tile))

    def tile_names(self, image: str) -> dict[tuple[int, int, int], str]:
        """Return the file of each tile (level from the finest, column, row) of an image, relative to its folder."""
        last = self.cut.n_level - 1
        return {
            (level, column, row): self._name(image, index, last - level, column, row)
            for index, (level, column, row) in enumerate(self.cut.places())
        }

    def _name(self, image: str, index: int, level: int, column: int, row: int) -> str:
        if self.name == "google":
            return f"{image}/{level}/{row}/{column}.jpg"
        if self.name == "zoomify":
            return f"{image}/TileGroup{index // _GROUP}/{level}-{column}-{row}.jpg"
        if self.name == "iiif":
            return f"{image}/{iiif_request(self.cut, self.cut.n_level - 1 - level, column, row)}"
        return f"{image}_files/{level}/{column}_{row}.jpg"


def iiif_request(cut: Cut, level: int, column: int, row: int) -> str:
    """Return a tile's ``region/size/0/default.jpg`` as viewers spell it, the canonical form of Image API 3.0."""
    side = cut.tile << level
    left, top = column * side, row * side
    width, height = min(side, cut.width - left), min(side, cut.height - top)
    region = "full" if (width, height) == (cut.width, cut.height) else f"{left},{top},{width},{height}"
    size = (-(-width // (1 << level)), -(-height // (1 << level)))
    return f"{region}/{'max' if size == (cut.width, cut.height) else f'{size[0]},{size[1]}'}/0/default.jpg"


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("deepzoom", Cut(0, 0, 254, overlap=1)),
        Layout("google", Cut(0, 0, 256), pads=True),
        Layout("zoomify", Cut(0, 0, 256)),
        Layout("tarzoom", Cut(0, 0, 254, overlap=1)),
        Layout("itarzoom", Cut(0, 0, 254, overlap=1)),
        Layout("iiif", Cut(0, 0, 512, rounds_up=True)),
    )
}
"""Layouts by their names, which are OpenLIME's."""


def find_layout(name: str) -> Layout:
    """Return a layout; InputError for an unknown name."""
    if name not in LAYOUTS:
        raise unknown("layout of tiles", name, LAYOUTS)
    return LAYOUTS[name]
