"""What OpenLIME makes of a relight folder: which tiles its `LayoutTiles` asks for, and what its `ShaderRTI` sums.

Written from their documentation and formats; nothing here is of the package.
"""

import io
import json
import math

import numpy as np
import OpenImageIO as oiio


def count_levels(width, height, tile):
    """Return the levels that a viewer expects: 1 + ceil(log2(longer side / tile))."""
    return math.ceil(math.log(max(width, height) / tile) / math.log(2)) + 1


def grids(width, height, tile, levels):
    """Return columns and rows of tiles, and sides, of each level; the coarsest first."""
    found = []
    for _ in range(levels):
        found.append((math.ceil(width / tile), math.ceil(height / tile), width, height))
        width, height = width >> 1, height >> 1
    return found[::-1]


def read_jpeg(content):
    """Return the pixels of a JPEG in memory."""
    # OpenImageIO reads files alone.
    import tempfile

    with tempfile.NamedTemporaryFile(suffix=".jpg") as file:
        file.write(content)
        file.flush()
        image = oiio.ImageBuf(file.name)
        assert image.has_error is False, image.geterror()
        return image.get_pixels(oiio.UINT8)


class TiledFolder:
    """A folder whose planes are in tiles of a layout, asked for as OpenLIME asks a web server."""

    def __init__(self, folder, layout):
        self.folder, self.layout = folder, layout
        self.info = json.loads((folder / "info.json").read_text())
        self.images = math.ceil(self.info["nplanes"] / 3)
        getattr(self, f"_{layout}")()
        if self.levels is None:
            self.levels = count_levels(self.width, self.height, self.tile)
        self.grid = grids(self.width, self.height, self.tile, self.levels)

    def _deepzoom(self):
        from xml.etree import ElementTree

        root = ElementTree.parse(self.folder / "plane_0.dzi").getroot()
        self.tile, self.overlap, self.levels = int(root.get("TileSize")), int(root.get("Overlap")), None
        size = root.find("{http://schemas.microsoft.com/deepzoom/2008}Size")
        self.width, self.height = int(size.get("Width")), int(size.get("Height"))
        assert root.get("Format") == "jpg"

    def _google(self):
        self.tile, self.overlap, self.levels = 256, 0, None
        self.width, self.height = self.info["width"], self.info["height"]

    def _zoomify(self):
        from xml.etree import ElementTree

        root = ElementTree.parse(self.folder / "plane_0" / "ImageProperties.xml").getroot()
        self.tile, self.overlap, self.levels = int(root.get("TILESIZE")), 0, None
        self.width, self.height = int(root.get("WIDTH")), int(root.get("HEIGHT"))

    def _tarzoom(self):
        self._index([json.loads((self.folder / f"plane_{i}.tzi").read_text()) for i in range(self.images)])

    def _itarzoom(self):
        self._index([json.loads((self.folder / "planes.tzi").read_text())])

    def _index(self, told):
        self.told = told
        for name in ("width", "height", "overlap"):
            setattr(self, name, told[0][name])
        self.tile, self.levels = told[0]["tilesize"], told[0]["nlevels"]

    def content(self, image, level, x, y):
        """Return the bytes of a tile."""
        index = sum(columns * rows for columns, rows, *_ in self.grid[:level]) + y * self.grid[level][0] + x
        plane = self.folder / f"plane_{image}"
        if self.layout == "deepzoom":
            return (self.folder / f"plane_{image}_files/{level}/{x}_{y}.jpg").read_bytes()
        if self.layout == "google":
            return (plane / f"{level}/{y}/{x}.jpg").read_bytes()
        if self.layout == "zoomify":
            return (plane / f"TileGroup{index >> 8}/{level}-{x}-{y}.jpg").read_bytes()
        told = self.told[image if self.layout == "tarzoom" else 0]
        archive = self.folder / (f"plane_{image}.tzb" if self.layout == "tarzoom" else "planes.tzb")
        if self.layout == "itarzoom":
            index = index * told["stride"] + image
        start, end = told["offsets"][index : index + 2]
        content = io.BytesIO(archive.read_bytes())
        content.seek(start)
        return content.read(end - start)

    def level(self, level):
        """Return the texels of a level, as tiles cover it, (height, width, plane)."""
        columns, rows, width, height = self.grid[level]
        found = np.zeros((height, width, 3 * self.images), np.uint8)
        for image in range(self.images):
            for y in range(rows):
                for x in range(columns):
                    pixels = read_jpeg(self.content(image, level, x, y))
                    left = 0 if x == 0 else self.overlap
                    top = 0 if y == 0 else self.overlap
                    w, h = min(self.tile, width - x * self.tile), min(self.tile, height - y * self.tile)
                    if self.layout == "google":
                        assert pixels.shape[:2] == (256, 256)
                    else:
                        right = 0 if x == columns - 1 else min(self.overlap, width - (x + 1) * self.tile)
                        low = 0 if y == rows - 1 else min(self.overlap, height - (y + 1) * self.tile)
                        assert pixels.shape[:2] == (top + h + low, left + w + right)
                    part = pixels[top : top + h, left : left + w]
                    found[
                        y * self.tile : y * self.tile + h,
                        x * self.tile : x * self.tile + w,
                        3 * image : 3 * image + 3,
                    ] = part
        return found


def whole_texels(folder):
    """Return the texels of a folder of whole images."""
    info = json.loads((folder / "info.json").read_text())
    files = [read_jpeg((folder / f"plane_{i}.jpg").read_bytes()) for i in range(math.ceil(info["nplanes"] / 3))]
    return np.concatenate(files, axis=2)


def shown(info, texels, light):
    """Return what the shader makes of texels under a light: `bilinear` in `mrgb` or `mycc`."""
    assert info["type"] == "bilinear"
    side, planes, material = info["resolution"], info["nplanes"], info["materials"][0]
    if info["colorspace"] == "mycc":
        assert sum(info["yccplanes"]) == planes
    table = np.array(info["basis"], float).reshape(planes + 1, side, side, 3)
    table[0] /= 255
    table[1:] = (table[1:] - 127) / np.array(material["range"])[:, None, None, None]
    size = np.abs(light).sum()
    x, y = ((each / size + 1) / 2 * (side - 1) for each in (light[0] + light[1], light[1] - light[0]))
    left, top = (min(max(math.floor(each), 0), side - 2) for each in (x, y))
    dx, dy = x - left, y - top
    base = (1 - dx) * (1 - dy) * table[:, top, left] + dx * (1 - dy) * table[:, top, left + 1]
    base += (1 - dx) * dy * table[:, top + 1, left] + dx * dy * table[:, top + 1, left + 1]
    values = (texels / 255.0 - material["bias"]) * material["scale"]
    if info["colorspace"] == "mrgb":
        return np.clip(base[0] + values @ base[1:], 0, 1)
    # Images before the first count of planes hold a component in each channel; those behind it luminance alone.
    y, cb, cr = (np.full(texels.shape[:2], base[0, k]) for k in range(3))
    for image in range(planes // 3):
        for k in range(3):
            plane = 3 * image + k
            if image >= info["yccplanes"][0] or k == 0:
                y = y + base[plane + 1, 0] * values[..., plane]
            elif k == 1:
                cb = cb + base[plane + 1, 1] * values[..., plane]
            else:
                cr = cr + base[plane + 1, 2] * values[..., plane]
    green = y + cr / 2
    blue = y - cr / 2 - cb / 2
    return np.clip(np.stack([blue + cb, green, blue], axis=-1), 0, 1)
