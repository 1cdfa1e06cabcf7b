"""Planes and pictures in tiles: asked for as viewers ask, read back, and refused where a tile is damaged."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.exchange.layouts import LAYOUTS
from clrelight.exchange.pyramid import Cut, Pyramid
from clrelight.exchange.relight_reading import read_relight_folder
from clrelight.images import write_image
from clrelight.store import write_fit
from tests.commands import call, contents, succeed
from tests.reference import openlime
from tests.test_exchange import LIGHTS, decibels, made_fit, shown_by_ours

SHADERS = ["deepzoom", "google", "zoomify", "tarzoom", "itarzoom"]
"""Layouts in which OpenLIME shows relightable pictures."""
URL = "https://example.org/coin"


def exported(place, layout, height, width, *words):
    fit = made_fit(1, height=height, width=width)
    write_fit(place / "fit.h5", fit)
    url = ("--url", URL) if layout == "iiif" else ()
    succeed("export", place / "fit.h5", place / "out", *words, *url, "--tiles", layout, "--format", "relight")
    return fit, place / "out"


@pytest.mark.parametrize(("height", "width"), [(37, 50), (20, 37), (1, 64), (65, 33)])
@pytest.mark.parametrize(
    ("tile", "overlap", "up", "pixel"), [(8, 0, False, False), (8, 1, True, True), (16, 2, False, False)]
)
def test_a_pyramid_is_cut_from_rows_as_from_the_whole(height, width, tile, overlap, up, pixel):
    picture = np.random.default_rng(height).integers(0, 256, (height, width, 2), np.uint8)
    cut = Cut(height, width, tile, overlap, up, pixel)
    tiles = {}
    pyramid = Pyramid(cut, 2, lambda *where: tiles.__setitem__(where[:3], where[3].copy()))
    for first in range(0, height, 7):
        pyramid.add(picture[first : first + 7])
    assert set(tiles) == set(cut.places())
    level = picture.astype(int)
    for number in range(cut.n_level):
        for (at, column, row), found in tiles.items():
            if at == number:
                top, left = max(row * tile - overlap, 0), max(column * tile - overlap, 0)
                expected = level[top : (row + 1) * tile + overlap, left : (column + 1) * tile + overlap]
                np.testing.assert_array_equal(found, expected)
        if up:
            level = np.pad(level, ((0, level.shape[0] % 2), (0, level.shape[1] % 2), (0, 0)), mode="edge")
        level = level[: level.shape[0] // 2 * 2, : level.shape[1] // 2 * 2]
        level = (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2] + 2) // 4
    assert not pixel or max(cut.size(cut.n_level - 1)) == 1


@pytest.fixture
def small_tiles(monkeypatch):
    """Tiles of 32 pixels, that small pictures have some: all but Google's, which are 256 by definition."""
    for name, layout in LAYOUTS.items():
        if name != "google":
            monkeypatch.setitem(LAYOUTS, name, replace(layout, cut=replace(layout.cut, tile=32)))


@pytest.mark.usefixtures("small_tiles")
@pytest.mark.parametrize("space", ["mrgb", "mycc"])
@pytest.mark.parametrize("layout", SHADERS)
def test_openlime_finds_each_tile_it_asks_for(tmp_path, layout, space):
    height, width = (50, 257) if layout == "google" else (50, 130)
    fit, out = exported(tmp_path, layout, height, width, "--planes", 12, "--colorspace", space)
    folder = openlime.TiledFolder(out, layout)
    assert (folder.width, folder.height) == (width, height)
    assert folder.levels == (2 if layout == "google" else 4)
    texels = [folder.level(level) for level in range(folder.levels)]
    for light, expected in zip(LIGHTS[:2], shown_by_ours(fit, LIGHTS[:2]), strict=True):
        assert decibels(openlime.shown(folder.info, texels[-1], light), expected) > 40
    for coarse, fine in itertools.pairwise(texels):
        height, width = coarse.shape[:2]
        cells = fine[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).astype(float)
        assert np.abs(cells.mean(axis=(1, 3)) - coarse).mean() < 1.5  # of JPEG at 100
    # All tiles are of the picture: nothing but them and what describes them is there.
    if layout in ("tarzoom", "itarzoom"):
        assert not list(out.rglob("*.jpg"))
        assert all(told["offsets"][-1] == size for told, size in _archives(folder, out))
    else:
        assert len(list(out.rglob("*.jpg"))) == 4 * sum(x * y for x, y, *_ in folder.grid)


def _archives(folder, out):
    names = ["planes"] if folder.layout == "itarzoom" else [f"plane_{i}" for i in range(4)]
    return [(told, (out / f"{name}.tzb").stat().st_size) for told, name in zip(folder.told, names, strict=True)]


@pytest.mark.usefixtures("small_tiles")
@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_a_folder_of_tiles_is_photographed(tmp_path, layout):
    height, width = (40, 257) if layout == "google" else (70, 75)
    fit, out = exported(tmp_path, layout, height, width, "--planes", 9)
    found = read_relight_folder(out)
    assert found.image_shape == (height, width, 3)
    for first, end in ((0, 30), (height - 5, height), (10, height - 2), (0, height)):
        expected = shown_by_ours(fit, LIGHTS[:2])[:, first:end]
        assert decibels(found.display_values(LIGHTS[:2], first, end), expected) > 40
    succeed("import", out, tmp_path / "stack.h5", "--lights", 6)
    with cr.open_stack(tmp_path / "stack.h5") as stack:
        expected = shown_by_ours(fit, stack.directions_i3)
        assert decibels(stack.images_ihwc[:] / 255.0, expected) > 36


def test_a_picture_smaller_than_a_tile_has_one_level(tmp_path):
    for layout in ("deepzoom", "zoomify", "tarzoom"):
        (tmp_path / layout).mkdir()
        _, out = exported(tmp_path / layout, layout, 37, 50, "--planes", 6)
        folder = openlime.TiledFolder(out, layout)
        assert folder.levels == 1
        assert folder.level(0).shape == (37, 50, 6)
    ended = call("export", tmp_path / "deepzoom" / "fit.h5", tmp_path / "x", "--format", "relight", "--tiles", "google")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "google tiles are for pictures of more than 128 pixels, this has 50" in ended.err
    assert not (tmp_path / "x").exists()


def iiif_urls(info):
    """Yield what OpenSeadragon asks a static service for: level, place, and the path."""
    width, height, tile = info["width"], info["height"], info["tiles"][0]["width"]
    for scale in info["tiles"][0]["scaleFactors"]:
        across, down = math.ceil(width / scale), math.ceil(height / scale)
        for y in range(math.ceil(down / tile)):
            for x in range(math.ceil(across / tile)):
                w, h = min(tile * scale, width - x * tile * scale), min(tile * scale, height - y * tile * scale)
                region = f"{x * tile * scale},{y * tile * scale},{w},{h}" if (w, h) != (width, height) else "full"
                size = min(tile, across - x * tile), min(tile, down - y * tile)
                text = "max" if size == (width, height) else f"{size[0]},{size[1]}"
                yield scale, (x * tile, y * tile), size, f"{region}/{text}/0/default.jpg"


def test_iiif_pictures_are_static_services(tmp_path):
    fit = made_fit(1, height=523, width=1100)
    write_fit(tmp_path / "fit.h5", fit)
    light = "0.2,0.3,0.93"
    succeed("export", tmp_path / "fit.h5", tmp_path / "out", "--format", "iiif", "--light", light, "--url", URL + "/")
    info = json.loads((tmp_path / "out" / "info.json").read_text())
    assert info["@context"] == "http://iiif.io/api/image/3/context.json"
    assert (info["id"], info["type"], info["profile"]) == (URL, "ImageService3", "level0")
    assert (info["protocol"], info["width"], info["height"]) == ("http://iiif.io/api/image", 1100, 523)
    expected = shown_by_ours(fit, LIGHTS[:1])[0]
    found, paths = np.zeros(expected.shape), set()
    for scale, (x, y), size, path in iiif_urls(info):
        pixels = openlime.read_jpeg((tmp_path / "out" / path).read_bytes())
        assert pixels.shape[:2] == size[::-1]
        paths.add(path)
        if scale == 1:
            found[y : y + size[1], x : x + size[0]] = pixels / 255
    assert decibels(found, expected) > 38
    whole = openlime.read_jpeg((tmp_path / "out" / "full/max/0/default.jpg").read_bytes())
    assert decibels(whole / 255, expected) > 38
    for size in info["sizes"]:
        paths.add(f"full/{size['width']},{size['height']}/0/default.jpg")
    files = {str(file.relative_to(tmp_path / "out")) for file in (tmp_path / "out").rglob("*.jpg")}
    assert files == paths | {"full/max/0/default.jpg"}


def test_deep_zoom_pictures_go_down_to_a_pixel(tmp_path):
    picture = np.random.default_rng(4).integers(0, 256, (300, 259, 3), np.uint8)
    write_image(tmp_path / "view.png", picture)
    succeed("export", tmp_path / "view.png", tmp_path / "out", "--format", "deepzoom", "--quality", 100)
    assert '<Size Height="300" Width="259"/>' in (tmp_path / "out" / "picture.dzi").read_text()
    levels = sorted(int(each.name) for each in (tmp_path / "out" / "picture_files").iterdir())
    assert levels == list(range(10))  # 1 + ceil(log2(300))
    width, height = 259, 300
    for level in reversed(levels):
        files = {file.name for file in (tmp_path / "out" / f"picture_files/{level}").iterdir()}
        assert files == {f"{x}_{y}.jpg" for x in range(math.ceil(width / 254)) for y in range(math.ceil(height / 254))}
        width, height = math.ceil(width / 2), math.ceil(height / 2)
    corner = openlime.read_jpeg((tmp_path / "out" / "picture_files/9/1_1.jpg").read_bytes())
    assert corner.shape == (47, 6, 3)
    assert np.abs(corner - picture[253:, 253:].astype(float)).mean() < 2


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("fit.h5", "x", "--format", "iiif"), "say where the folder will be found, as --url"),
        (("fit.h5", "x", "--format", "relight", "--tiles", "iiif"), "say where the folder will be found"),
        (("fit.h5", "x", "--format", "deepzoom", "--light", "0,0,-1"), "the light"),
        (("fit.h5", "x.ptm", "--light", "0,0,1"), "--light is for --format deepzoom or iiif, this is ptm"),
        (("deep.png", "x", "--format", "deepzoom"), "deep.png has values of uint16"),
        (("view.png", "x", "--format", "deepzoom", "--light", "0,0,1"), "view.png is a picture already"),
        (("view.png", "x", "--format", "relight"), "view.png"),
        (("fit.h5", "x.lp", "--names", "a b%d.png"), "have no blanks"),
        (("fit.h5", "x.lp", "--names", "a.png"), "number field"),
        (("sky.h5", "x.lp"), "expected fit/1 or encoded/4"),
    ],
)
def test_refusals(tmp_path, monkeypatch, words, line):
    monkeypatch.chdir(tmp_path)
    write_fit("fit.h5", made_fit(1, 4, 5))
    write_image("view.png", np.zeros((3, 4, 3), np.uint8))
    write_image("deep.png", np.zeros((3, 4, 3), np.uint16))
    succeed("light", "sky.h5", "--directional", "0,0.6,0.8", "--degree", 1)
    before = contents(tmp_path)
    ended = call("export", *words)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert line in ended.err
    assert contents(tmp_path) == before


@pytest.mark.usefixtures("small_tiles")
def test_damaged_tiles_are_refused(tmp_path):
    _, out = exported(tmp_path, "deepzoom", 40, 70, "--planes", 3)
    tile = out / "plane_0_files/2/1_0.jpg"
    good = tile.read_bytes()
    write_image(tmp_path / "small.jpg", np.zeros((9, 9, 3), np.uint8))
    for content in (b"", good[:50], (tmp_path / "small.jpg").read_bytes()):
        tile.write_bytes(content)
        ended = call("import", out, tmp_path / "y.h5", "--lights", 4)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "1_0.jpg" in ended.err
        assert not (tmp_path / "y.h5").exists()
    tile.unlink()
    ended = call("import", out, tmp_path / "y.h5", "--lights", 4)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "1_0.jpg" in ended.err


BAD_INDICES = [
    *({"width": each} for each in (0, -5, 1 << 40, "x", None, 531)),
    *({"tilesize": each} for each in (0, 1 << 30, "q")),
    *({"overlap": -1}, {"overlap": 1 << 20}, {"nlevels": 1 << 40, "width": []}),
    *({"offsets": each} for each in ([], [0], None, 7, [0] * 100, [1 << 60] * 100, ["x"] * 100)),
]


@pytest.mark.usefixtures("small_tiles")
@pytest.mark.parametrize("layout", ["tarzoom", "itarzoom"])
def test_indices_that_make_no_sense_are_refused(tmp_path, layout):
    _, out = exported(tmp_path, layout, 40, 70, "--planes", 3)
    file = out / ("plane_0.tzi" if layout == "tarzoom" else "planes.tzi")
    good = json.loads(file.read_text())
    more = [] if layout == "tarzoom" else [{"stride": 0}, {"stride": 1 << 40}, {"stride": "x"}]
    for change in BAD_INDICES + more:
        file.write_text(json.dumps(good | change))
        ended = call("import", out, tmp_path / "y.h5", "--lights", 4)
        assert (ended.code, ended.err.count("\n")) == (2, 1), change
        assert not (tmp_path / "y.h5").exists()


@pytest.mark.usefixtures("small_tiles")
def test_one_pixel_levels_of_other_writers_are_found(tmp_path):
    """Deep Zoom as others number it: level 0 is one pixel."""
    _, out = exported(tmp_path, "deepzoom", 70, 75, "--planes", 3)
    expected = read_relight_folder(out).display_values(LIGHTS[:1], 0, 70)
    for level in (2, 1, 0):
        (out / f"plane_0_files/{level}").rename(out / f"plane_0_files/{level + 8}")
    (out / "plane_0.dzi").write_text((out / "plane_0.dzi").read_text().replace('"', "'"))
    np.testing.assert_array_equal(read_relight_folder(out).display_values(LIGHTS[:1], 0, 70), expected)
    assert oiio.ImageBuf(str(out / "plane_0_files/10/0_0.jpg")).spec().width == 33
