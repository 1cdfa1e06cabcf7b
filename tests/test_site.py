"""The documentation site without sphinx: every page is reached, every link resolves, every block and example runs."""

import io
import json
import re
import runpy
import shlex
import struct
import sys
import tomllib
import types
import warnings
import zlib
from collections import Counter
from pathlib import Path
from unittest import mock

import click
import h5py
import numpy as np
import pytest

import clrelight as cr
from clrelight.cli.app import cli
from clrelight.images import write_image
from clrelight.light_codes import unpack_directions
from clrelight.sampling import make_pattern
from clrelight.transfer.brdfs import Ggx
from clrelight.transfer.functions import FixedLight
from datasets_synth.heads import make_head, shade_head
from datasets_synth.torus import render_torus
from tests.commands import ROOT, call

DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
LINKING = [*PAGES, *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
FENCE = re.compile(r"^```(\S*)\n(.*?)^```$", re.S | re.M)


def blocks(page, language):
    return [text for told, text in FENCE.findall(page.read_text("utf-8")) if told == language]


def listed(page):
    """Return the pages in the toctrees of an rst page, from docs/."""
    text = page.read_text("utf-8")
    entries = [e for tree in re.findall(r"^\.\. toctree::\n((?:   .*\n|\n)*)", text, re.M) for e in tree.split("\n")]
    names = [entry.strip() for entry in entries if entry.strip() and not entry.strip().startswith(":")]
    folder = page.parent.relative_to(DOCS)
    return [name[1:] if name.startswith("/") else (folder / name).as_posix() for name in names]


def test_every_page_is_in_one_toctree():
    """A new page of docs/ is listed in one of docs/site/*.rst."""
    trees = [name for page in [DOCS / "index.rst", *(DOCS / "site").glob("*.rst")] for name in listed(page)]
    pages = [*PAGES, *(DOCS / "site").iterdir()]
    there = {page.relative_to(DOCS).with_suffix("").as_posix() for page in pages} | {"gallery/index"}
    assert Counter(trees) == Counter(there)


def anchors(page):
    """Return the anchors that GitHub, and myst, give a page's headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.S | re.M)
    found = Counter()
    for title in re.findall(r"^#+ (.*)$", text, re.M):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).strip().lower()
        slug = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        yield f"{slug}-{found[slug]}" if found[slug] else slug
        found[slug] += 1


@pytest.mark.parametrize("page", LINKING, ids=lambda page: page.name)
def test_links_resolve(page):
    text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", page.read_text("utf-8")))
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and anchor not in set(anchors(target))):
            wrong.append(link)
    assert wrong == []


def test_python_reference_has_every_public_name():
    text = (DOCS / "site" / "python-reference.rst").read_text("utf-8")
    told = re.findall(r"^\.\. auto\w+:: (\w+)$", text, re.M)
    assert Counter(told) == Counter(set(cr.__all__) - {"__version__"})


def test_bibliography_has_what_docstrings_cite():
    keys = set(re.findall(r"^\| `([\w-]+)` \|", (DOCS / "bibliography.md").read_text("utf-8"), re.M))
    cited = set()
    for folder in ("clrelight", "datasets_synth"):
        for path in (ROOT / folder).rglob("*.py"):
            cited |= set(re.findall(r"\b([a-z]+(?:-[a-z]+)+), (?:eq|section|table|figure)\b", path.read_text("utf-8")))
    assert len(keys) == 5
    assert cited <= keys


def command_lines(page):
    """Return the words of the lines of a page's blocks that run clrelight."""
    for language in ("", "sh", "console"):
        for text in blocks(page, language):
            for line in text.replace("\\\n", " ").split("\n"):
                if re.match(r"(\$ )?clrelight ", line):
                    words = shlex.split(line.removeprefix("$ "), comments=True)[1:]
                    ends = [at for at, word in enumerate(words) if word in ("|", ">", "&&", ";", "&")]
                    yield words[: min(ends, default=None)]


@pytest.mark.parametrize("page", LINKING, ids=lambda page: page.name)
def test_command_lines_name_commands_and_options_that_exist(page):
    for words in command_lines(page):
        told, command = list(words), cli
        while isinstance(command, click.Group) and told and not told[0].startswith("-"):
            name = told.pop(0)
            assert name in command.commands, words
            command = command.commands[name]
        known = {"--help", "-h", "--version", *(o for p in command.params for o in (*p.opts, *p.secondary_opts))}
        assert [w for w in told if w.startswith("--") and w.split("=")[0] not in known] == [], words


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A new user's: nothing but photographs of a head, sRGB, and the light file of a dome."""
    place = tmp_path_factory.mktemp("user")
    photos = place / "photos"
    photos.mkdir()
    head, directions_i3 = make_head(2, size=40), make_pattern("uniform", 40)
    shade_ip = shade_head(head, directions_i3)
    lines = ["40"]
    for i, direction in enumerate(directions_i3):
        image_hwc = np.zeros((40, 40, 3))
        image_hwc[head.mask_hw] = 0.9 * shade_ip[i, :, None] * head.albedo_hwc[head.mask_hw]
        write_image(photos / f"DSC_{i:04}.png", code_values(image_hwc))
        lines.append(f"DSC_{i:04}.png " + " ".join(f"{v:.6f}" for v in direction))
    (photos / "dome.lp").write_text("\n".join(lines) + "\n")
    return place


def code_values(linear_hwc):
    return np.rint(255 * np.clip(linear_hwc, 0, 1) ** (1 / 2.2)).astype(np.uint8)


MADE = {
    "start.md": ("view.h5", "relit.png", "viewer.html", "ring.png"),
    "photographs.md": ("small.h5", "found.lp", "under_sky.png"),
    "capture.md": ("plan.lp", "fewer.lp"),
}
"""What the commands of each page with blocks of sh leave in the folder."""


def test_every_page_with_commands_to_run_is_run():
    assert {page.name for page in PAGES if blocks(page, "sh")} == set(MADE)


@pytest.mark.parametrize(("page", "made"), MADE.items())
def test_blocks_of_the_first_pages_run_in_a_folder_of_photographs(page, made, folder, monkeypatch):
    monkeypatch.chdir(folder)
    lines = [line for text in blocks(DOCS / page, "sh") for line in text.strip().split("\n")]
    if page == "start.md":
        assert len(blocks(DOCS / page, "sh")[0].strip().split("\n")) == 4
    for line in lines:
        if re.fullmatch(r"pip install '?clrelight(\[synth\])?'?", line):
            continue
        program, *words = shlex.split(line)
        assert program == "clrelight", line
        ended = call(*words)
        assert ended.code == 0, f"{line}: {ended.err}"
    assert [name for name in made if not (folder / name).is_file()] == []


def test_start_is_what_the_first_page_shows():
    (shown,) = re.findall(r"^\.\. code-block:: sh\n\n((?:   .*\n)*)", (DOCS / "index.rst").read_text("utf-8"), re.M)
    first = blocks(DOCS / "start.md", "sh")[0].split("\n")
    assert [line.strip() for line in shown.split("\n")][:3] == first[:3]


def encoded_file(place):
    small = cr.encode(cr.fit(ring(), "spline", 2, measure=False), "klt", rate=1.0)
    cr.write_encoded(place / "small.h5", small)
    return h5py.File(place / "small.h5")


def ring():
    return cr.LightStack(
        np.random.default_rng(0).random((20, 8, 8, 3)).astype(np.float32), make_pattern("uniform", 20), 1.0
    )


def names_of(page, place):
    """Return what the Python blocks of a page take for given."""
    if page == "bases.md":
        given = np.random.default_rng(0).random((3, 256))
        return {"values": given[0].reshape(16, 16), "visibility": given[1], "cosine": given[2]}
    if page == "files.md":
        images = np.zeros((20, 8, 8, 3), np.uint8)
        directions = make_pattern("uniform", 20)
        return {
            **{"h5py": h5py, "zlib": zlib, "json": json, "struct": struct, "images": images, "directions": directions},
            "file": encoded_file(place),
        }
    if page == "scenes.md":
        light = FixedLight(np.array([[0.0, 0.0, 1.0]]), np.ones((1, 3)))
        return {"cr": cr, "surface": render_torus(size=8, lights=9).surface, "light": light, "brdf": Ggx(roughness=0.5)}
    return {}


ELSEWHERE = {"python.md", "README.md"}  # in tests/test_python_verbs.py
WITH_PYTHON = [page for page in LINKING if blocks(page, "python") and page.name not in ELSEWHERE]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_python_of_the_pages_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if page.name == "batches.md":  # one stack, and a cluster that is not there
        cr.write_stack(tmp_path / "one.h5", ring())
        (tmp_path / "museum.toml").write_text('job = "fit"\nstacks = ["*.h5"]\n')
        slurm = types.SimpleNamespace(SLURMCluster=mock.Mock())
        monkeypatch.setitem(sys.modules, "dask_jobqueue", slurm)
    names = names_of(page.name, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cr.Note)
        exec(compile("".join(blocks(page, "python")), page.name, "exec"), names)
    if page.name == "batches.md":
        assert not names["batch"].failed
        assert list((tmp_path / "packed").glob("one*"))
    if page.name == "files.md":
        held_i3 = unpack_directions(names["lights"])
        place_i2 = held_i3[:, :2] / np.abs(held_i3).sum(axis=1, keepdims=True) * 2**15
        np.testing.assert_allclose(names["places"], place_i2, atol=1e-6)
        assert len(place_i2) == 20


def test_toml_of_the_pages_parses():
    texts = [text for page in PAGES for text in blocks(page, "toml")]
    assert len(texts) >= 2
    assert all(tomllib.load(io.BytesIO(text.encode())) for text in texts)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_and_draw(example, tmp_path, monkeypatch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    monkeypatch.chdir(tmp_path)
    shown = []
    monkeypatch.setattr(pyplot, "show", lambda: shown.append(pyplot.gcf()))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cr.Note)
            runpy.run_path(str(example))
        assert shown
        for figure in shown:
            figure.savefig(io.BytesIO())
    finally:
        pyplot.close("all")
    assert list(Path().iterdir()) == []
