"""Lines of `clrelight info`, of a file of each kind, beside what h5py reads of it."""

import os

import h5py
import numpy as np
import pytest

import clrelight as cr
from clrelight import store
from clrelight.lighting.light import Light
from clrelight.results import ROW_DTYPE, Results
from clrelight.sampling import make_pattern
from clrelight.shrm.record import Shrm
from clrelight.store.schemas import SCHEMAS
from tests.commands import succeed

LIGHTS = make_pattern("uniform", 6)
NO_DATASETS = {"tiles"}
"""Kinds of which files hold places of others: see `tests/test_batch_tiles.py`."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the path of a file of each kind that holds its arrays itself."""
    place, rng = tmp_path_factory.mktemp("kinds"), np.random.default_rng(0)
    images = rng.integers(0, 255, (6, 5, 7, 3), np.uint8)
    stack = cr.LightStack(images, LIGHTS, 200.0, "srgb", name="thing", mask_hw=rng.random((5, 7)) > 0.3)
    fitted = cr.fit(stack, "cls", degree=1, report=cr.Report())
    table = np.zeros(3, ROW_DTYPE)
    table["scene"], table["method"] = b"thing", b"cls"
    made = {kind: place / f"{kind}.h5" for kind in ("stack", "fit", "encoded", "light", "shrm", "results")}
    store.write_stack(made["stack"], stack)
    store.write_fit(made["fit"], fitted)
    cr.encode(fitted, "klt", rate=8, out=made["encoded"], report=cr.Report())
    store.write_light(made["light"], Light(rng.random((9, 3)), "sky", "z up", {"sun": 3}))
    store.write_shrm(made["shrm"], Shrm(np.ones((4, 5, 9, 3), np.float32), "global", 3, "reflection", "sky", "", {}))
    pictures, profiles = {"thing/reference": np.zeros((4, 4, 3), np.uint8)}, {"thing/cls/1": np.arange(4.0)}
    store.write_results(made["results"], Results(table, pictures, profiles))
    return made


def tree_of(text):
    """Return what is printed as it is nested: two blanks a level, a name, and a value behind two blanks or more."""
    tree, levels = {}, [{}]
    levels[0] = tree
    for line in text.splitlines():
        depth = (len(line) - len(line.lstrip())) // 2
        name, _, value = line.strip().partition("  ")
        at = levels[depth]
        at[name] = value.strip() if value else {}
        if not value:
            levels[depth + 1 :] = [at[name]]
    return tree


def shown(value):
    """Return a value of a file as it is printed."""
    value = value.decode() if isinstance(value, bytes) else value
    return f"{float(value):.6g}" if isinstance(value, float | np.floating) else str(value)


@pytest.mark.parametrize("kind", ["stack", "fit", "encoded", "light", "shrm", "results"])
def test_each_line_is_true(files, kind):
    told = tree_of(succeed("info", files[kind], "--no-thumbnail").out)
    assert told.pop("file") == str(files[kind])
    assert told.pop("bytes_on_disk") == str(os.path.getsize(files[kind]))
    with h5py.File(files[kind]) as file:
        assert told.pop("schema") == shown(file.attrs["clrelight_schema"])
        for name, lines in told.pop("datasets").items():
            held = file[name]
            assert lines.pop("shape") == (" × ".join(map(str, held.shape)) or "none"), name
            assert lines.pop("dtype") == ("row" if held.dtype.names else held.dtype.name), name
            assert lines.pop("chunks") == ("None" if held.chunks is None else " × ".join(map(str, held.chunks))), name
            assert len(lines.pop("axes").split(", ")) == held.ndim, name
            assert lines == {}
        attributes = told.pop("attributes")
        attributes = {} if attributes == "{}" else attributes
        for name in set(attributes) & set(file.attrs) - {"config", "fit_config"}:
            assert (attributes.pop(name) or "") == shown(file.attrs[name]), name
    rest(kind, told, attributes, files[kind])


def rest(kind, told, attributes, path):
    """Check lines of what is within JSON, tables, and the payload."""
    if kind == "encoded":
        encoded, record = store.read_encoded(path)
        assert told.pop("shape") == " × ".join(map(str, encoded.shape))
        assert told.pop("lights") == str(len(record.directions_i3)) == "6"
        assert {name: shown(value) for name, value in encoded.info.items()} == told.pop("info")
        sizes = {"encoded_bytes": encoded.encoded_bytes, "bits_per_coefficient": encoded.bits_per_coefficient}
        assert {name: attributes.pop(name) for name in sizes} == {name: shown(value) for name, value in sizes.items()}
        assert attributes.pop("config").keys() == encoded.config.keys()
        known = {name: shown(getattr(record, name)) for name in ("method", "degree", "peak", "transfer", "name")}
        assert {name: value for name, value in attributes.items() if name in known} == {
            name: known[name] for name in known if name in attributes
        }
        assert attributes["fit_config"] == {name: shown(value) for name, value in record.config.items()}
    if kind == "results":
        assert told.pop("rows") == "3"
        assert (told.pop("pictures"), told.pop("profiles")) == ("thing/reference", "thing/cls/1")
    if kind == "fit":
        with store.open_fit(path) as fitted:
            assert attributes.pop("config") == {name: shown(value) for name, value in fitted.config.items()}
    assert told == {}


def test_each_kind_is_looked_at(files):
    assert set(SCHEMAS) - NO_DATASETS == set(files)
