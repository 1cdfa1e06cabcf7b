"""Surfaces in files: what goes in comes out, files without one are as they were, damage is refused, parts have none."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import clrelight as cr
from clrelight import store
from clrelight.codec.encoded import Encoded
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError, StoreFormatError
from clrelight.fit.samples import Samples
from clrelight.jobs.region import Part, crop
from clrelight.sampling import make_pattern
from clrelight.store import writing
from clrelight.store.seal import SEAL_ATTRIBUTE
from tests.file_mutations import damage
from tests.hdf5 import unseal
from tests.surfaces import make_grid, surface_content

LIGHTS = make_pattern("uniform", 16)


def make_map(surface, **changes):
    shape = (4, *surface.map_shape, 3)
    coeffs = np.random.default_rng(3).standard_normal(shape).astype(np.float32)
    return CoefficientMap(coeffs, 1, "transfer", 1.0, "linear", LIGHTS, {"seed": 1}, surface=surface, **changes)


def make_stack(surface, channels=1):
    images = np.random.default_rng(4).random((16, *surface.map_shape, channels)).astype(np.float32)
    return LightStack(images, LIGHTS, 1.0, name="samples", surface=surface)


@pytest.fixture(params=[True, False], ids=["grid", "bare"])
def surface(request):
    return make_grid(whole=request.param)


@pytest.mark.parametrize("way", ["memory", "streamed"])
def test_round_trip(tmp_path, surface, way, monkeypatch):
    if way == "streamed":
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    store.write_fit(tmp_path / "fit.h5", make_map(surface))
    store.write_stack(tmp_path / "stack.h5", make_stack(surface))
    for read in (store.read_fit(tmp_path / "fit.h5").surface, *opened_surfaces(tmp_path)):
        assert surface_content(read) == surface_content(surface)
    again = tmp_path / "again.h5"
    with store.open_fit(tmp_path / "fit.h5") as held:
        store.write_fit(again, held)
    assert again.read_bytes() == (tmp_path / "fit.h5").read_bytes()


def opened_surfaces(folder):
    with store.open_fit(folder / "fit.h5") as held:
        yield held.surface
    with store.open_stack(folder / "stack.h5") as held:
        yield held.surface


def test_large_arrays_lie_in_chunks(tmp_path, monkeypatch):
    surface = make_grid(40, 50)
    monkeypatch.setattr("clrelight.store.surfaces.CHUNK_BYTES", 4096)
    store.write_fit(tmp_path / "fit.h5", make_map(surface))
    with h5py.File(tmp_path / "fit.h5") as file:
        assert file["surface/vertices"].chunks[0] < 200
        assert file["surface/vertices"].chunks[1] == 3
    assert surface_content(store.read_fit(tmp_path / "fit.h5").surface) == surface_content(surface)


def test_info_tells_of_a_surface(tmp_path):
    store.write_fit(tmp_path / "fit.h5", make_map(make_grid()))
    store.write_stack(tmp_path / "stack.h5", make_stack(make_grid(whole=False)))
    told = json.loads(json.dumps(store.describe(tmp_path / "fit.h5")))["surface"]
    assert (told["vertices"], told["faces"], told["grid"], told["frame"]) == (20, 24, [4, 5], "local")
    assert told["functions"] == "of the direction to the eye"
    assert len(told["albedo"]) == 3
    told = store.describe(tmp_path / "stack.h5")["surface"]
    assert (told["frame"], told["functions"]) == ("global", "of the direction to the light")
    assert "grid" not in told
    assert "albedo" not in told


def test_files_without_a_surface_say_nothing_of_one(tmp_path):
    """As files of before: their bytes are the same, which tests/frozen and test_store hold for the rest."""
    store.write_fit(tmp_path / "fit.h5", replace(make_map(make_grid()), surface=None))
    assert store.read_fit(tmp_path / "fit.h5").surface is None
    assert "surface" not in store.describe(tmp_path / "fit.h5")
    assert b"surface" not in (tmp_path / "fit.h5").read_bytes()
    old = Path(__file__).parent / "frozen" / "encoded.1.hdf"
    assert store.read_encoded(old)[1].surface is None


@pytest.mark.parametrize("kind", ["fit", "stack"])
def test_damaged_bytes(tmp_path, kind):
    """Each byte of the group's own records and values, or a random damage: refused in one line, or read the same."""
    path, surface = tmp_path / f"{kind}.h5", make_grid(3, 3)
    store.write_fit(path, make_map(surface)) if kind == "fit" else store.write_stack(path, make_stack(surface))
    good, expected = path.read_bytes(), everything(kind, path)
    rng = np.random.default_rng(5)
    values = [good.index(getattr(surface, name).tobytes()) for name in ("vertices_v3", "faces_f3", "albedo_vc")]
    places = [*rng.choice(len(good), 100), *values, *(at + 7 for at in values)]
    damaged = [good[:at] + bytes([good[at] ^ 1 << int(rng.integers(8))]) + good[at + 1 :] for at in places]
    damaged += [damage(good, [good], rng) for _ in range(70)]
    refusals = 0
    for bad in damaged:
        path.write_bytes(bad)
        refusals += refusal(path, kind, expected)
    assert refusals > 100
    for at in values:
        path.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        with pytest.raises(StoreFormatError):
            everything(kind, path)


def everything(kind, path):
    if kind == "fit":
        held = store.read_fit(path)
        return held.coeffs_khwc.tobytes(), str(held.config), surface_content(held.surface)
    with store.open_stack(path) as held:
        return held.images_ihwc[...].tobytes(), held.directions_i3.tobytes(), surface_content(held.surface)


def refusal(path, kind, expected):
    """Return whether a damaged file is refused; if it is not, it must read as the sound one did."""
    try:
        assert everything(kind, path) == expected
    except InputError as error:
        return (str(path) in str(error) and "\n" not in str(error)) or pytest.fail(str(error))
    return False


def facts(**changes):
    def change(file):
        held = json.loads(file["surface/vertices"].attrs["surface"])
        text = json.dumps({**held, **changes})
        del file["surface/vertices"].attrs["surface"]
        file["surface/vertices"].attrs["surface"] = text

    return change


def data(name, values):
    def change(file):
        kept = dict(file[name].attrs)
        del file[name]
        file[name] = values
        file[name].attrs.update(kept)

    return change


def drop(name):
    return lambda file: file.__delitem__(name)


NAN = np.full((20, 3), np.nan)


@pytest.mark.parametrize("kind", ["fit", "stack"])
@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (drop("surface/faces"), "no dataset faces"),
        (drop("surface/vertices"), "no dataset vertices"),
        (drop("surface/normals"), "no dataset normals"),
        (data("surface/vertices", NAN), "vertices must be finite"),
        (data("surface/vertices", np.zeros((19, 3))), "19"),
        (data("surface/vertices", np.zeros((20, 2))), r"\(20, 2\)|along xyz"),
        (data("surface/normals", np.zeros((20, 3))), "unit vectors"),
        (data("surface/faces", np.full((3, 3), 20, np.int32)), "faces name vertices"),
        (data("surface/faces", np.full((3, 3), -1, np.int32)), "faces name vertices"),
        (data("surface/faces", np.zeros((0, 3), np.int32)), "faces must be integers"),
        (data("surface/albedo", np.full((20, 3), 2, np.float32)), "albedo must be from 0 to 1"),
        (data("surface/tangents", np.tile([[0.0, 0.0, 1.0]], (20, 1))), "orthogonal"),
        (facts(grid=[3, 3]), "a grid of"),
        (facts(grid=[-4, -5]), "must have grid"),
        (facts(grid=[4.0, 5]), "must have grid"),
        (facts(grid="45"), "must have grid"),
        (facts(grid=[1 << 80, 1]), "a grid of"),
        (facts(argument="sound"), "argument must be one of"),
        (facts(argument=1), "must have argument"),
        (facts(name=None), "must have name"),
        (lambda f: f["surface/vertices"].attrs.__delitem__("surface"), "no attribute surface"),
        (lambda f: f["surface/vertices"].attrs.__setitem__("surface", "{"), "not valid JSON"),
        (lambda f: f["surface/vertices"].attrs.__setitem__("surface", "[]"), "JSON object"),
        (lambda f: f["surface/vertices"].attrs.__setitem__("surface", 1.0), "one text"),
        (lambda f: f["surface"].__setitem__("link", h5py.SoftLink("/")), "soft or external link"),
        (lambda f: f["surface"].__setitem__("again", f["surface/faces"]), "linked twice"),
        (lambda f: f["surface"].__setitem__("loop", f["surface"]), "linked twice"),
    ],
)
def test_wrong_values(tmp_path, kind, change, phrase):
    path = tmp_path / "x.h5"
    store.write_fit(path, make_map(make_grid())) if kind == "fit" else store.write_stack(path, make_stack(make_grid()))
    with h5py.File(path, "r+", libver="latest") as file:
        unseal(file)
        change(file)
    with pytest.raises(StoreFormatError, match=phrase) as caught:
        everything(kind, path)
    assert str(path) in str(caught.value)
    with pytest.raises(StoreFormatError):
        store.describe(path)


def test_a_sealed_file_keeps_its_surface_as_it_was_written(tmp_path):
    path = tmp_path / "fit.h5"
    for change in (facts(name="other"), drop("surface"), drop("surface/texture")):
        store.write_fit(path, make_map(make_grid()))
        with h5py.File(path, "r+", libver="latest") as file:
            change(file)
        with pytest.raises(StoreFormatError, match=SEAL_ATTRIBUTE):
            store.read_fit(path)


def test_a_fit_is_of_the_surface_of_its_stack(tmp_path):
    stack = make_stack(make_grid())
    store.write_stack(tmp_path / "stack.h5", stack)
    fitted = cr.fit(stack, "cls", 1)
    assert fitted.surface is stack.surface
    for extra in ({}, {"holdout": 4}, {"store": "float16"}):
        cr.fit(tmp_path / "stack.h5", "uls", 1, out=tmp_path / "fit.h5", report=cr.Report(), **extra)
        assert surface_content(store.read_fit(tmp_path / "fit.h5").surface) == surface_content(stack.surface)
    assert cr.fit(stack, "auto", "auto", report=cr.Report()).surface is stack.surface


def test_a_choice_takes_some_pixels_without_their_surface():
    stack = make_stack(make_grid())
    assert Samples(stack, 8).stack.surface is None
    assert stack.select(np.arange(4)).surface is stack.surface


def test_a_part_has_no_surface(tmp_path):
    held = make_map(make_grid())
    part = crop(held, Part((1, 1, 2, 3)))
    assert part.image_shape == (3, 2, 3)
    assert part.surface is None
    path = tmp_path / "fit.h5"
    store.write_fit(path, held)
    with store.open_fit(path) as opened:
        assert crop(opened, Part((0, 0, 5, 4))).surface is None
    assert cr.relight(path, [0, 0, 1], region=[1, 1, 2, 3], report=cr.Report()).shape == (3, 2, 3)


@pytest.mark.parametrize("codec", ["half", "klt", "uniform"])
def test_encodings_hold_no_geometry(tmp_path, codec):
    held = make_map(make_grid(16, 20))
    encoded = cr.encode(held, codec, report=cr.Report())
    assert encoded.record.surface is None
    cr.encode(held, codec, out=tmp_path / "e.h5", report=cr.Report())
    for source in (encoded, tmp_path / "e.h5"):
        decoded = cr.decode(source, report=cr.Report())
        assert decoded.surface is None
        assert decoded.image_shape == held.image_shape
    if codec == "klt":
        assert cr.decode(encoded, region=[1, 1, 2, 3], report=cr.Report()).surface is None
        again = cr.encode(held, codec, target_psnr=4.0, stack=make_stack(held.surface, 3), report=cr.Report())
        assert isinstance(again, Encoded)
