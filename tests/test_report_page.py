"""The report as one HTML page: nothing from outside, no name taken for markup, and what a browser makes of it."""

import base64
import csv
import hashlib
import html
import io
import json
import math
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from clrelight.errors import InputError
from clrelight.report import write_report
from clrelight.report.comparing import compare_html
from clrelight.report.contact_sheet import psnr_8bit
from clrelight.report.html import json_block, plain, table_html
from clrelight.report.tables import Column, Table
from clrelight.results import ROW_DTYPE, Results
from tests.commands import call
from tests.test_report import CODECS, make_results, make_rows

HOSTILE = """<img src=x onerror=alert(1)></script>"x='#url(#a"""
VOID = {"meta", "img", "input", "br"}


class Tree(HTMLParser):
    """Elements with their attributes, the text of scripts apart; complains of what is not closed."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.scripts, self.text = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        (self.scripts if self.open and self.open[-1] == "script" else self.text).append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def hostile_results():
    rows = make_rows(HOSTILE, degree=3, methods=("cls", "spline"), codecs=[*CODECS[:3], *CODECS[-2:]], held_out=True)
    rows["device"] = HOSTILE
    return make_results(np.concatenate([make_rows(codecs=CODECS[:3]), rows]))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "out"
    write_report(hostile_results(), out)
    return out / "report.html"


@pytest.fixture(scope="module")
def tree(written):
    return Tree(written.read_text(encoding="utf-8"))


def uncoded(uri, kind):
    assert uri.startswith(f"data:{kind};base64,")
    return base64.b64decode(uri.partition(",")[2], validate=True)


def test_nothing_is_asked_of_the_network(written, tree):
    text = written.read_text(encoding="utf-8")
    (policy,) = [a["content"] for a in tree.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; img-src data:;")
    script = [each for each in tree.scripts if each.startswith('"use strict"')]
    assert len(script) == 1
    assert f"'sha256-{base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode()}'" in policy
    addresses = set(re.findall(r"https?://[^\s\"'<)]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    for _, attributes in tree.elements:
        for name in ("src", "href", "xlink:href"):
            if attributes.get(name):
                assert attributes[name].startswith(("data:", "#"))
    assert "@import" not in text
    assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", re.search(r"<style>.*?</style>", text, re.DOTALL)[0])


def test_a_hostile_name_is_text(written, tree):
    assert [a for a in tree.all("img") if not (a.get("src") or "data:").startswith("data:")] == []
    assert not [name for _, a in tree.elements for name in a if name.startswith("on")]
    assert len(tree.scripts) == 3  # one for each comparison, and the page's own
    assert "".join(tree.text).count(" ".join(HOSTILE.split())) >= 4
    for script in tree.scripts[:2]:
        assert "</" not in script
        json.loads(script)


def test_identities_are_distinct_and_every_reference_has_one(tree):
    names = [a["id"] for _, a in tree.elements if a.get("id")]
    assert len(names) == len(set(names))
    pairs = [(name, value or "") for _, a in tree.elements for name, value in a.items()]
    asked = {value[1:] for name, value in pairs if name in ("href", "xlink:href") and value.startswith("#")}
    styled = " ".join(value for name, value in pairs if name in ("style", "clip-path"))
    asked |= set(re.findall(r"url\(#([^)]+)\)", styled))
    assert asked
    assert asked <= set(names)


def test_controls_and_pictures_have_labels(tree):
    for tag in ("svg", "input"):
        assert tree.all(tag)
        assert all(a.get("aria-label") for a in tree.all(tag))
    assert all("alt" in a for a in tree.all("img"))
    assert all(a.get("scope") == "col" for a in tree.all("th"))
    assert [a.get("lang") for a in tree.all("html")] == ["en"]
    assert len([a for a in tree.all("svg") if a.get("role") == "img"]) == len(tree.all("svg"))


def test_charts_take_the_colours_of_the_page(written):
    charts = re.findall(r"<svg.*?</svg>", written.read_text(encoding="utf-8"), re.DOTALL)
    assert len(charts) == 5  # two of figure 7, one of figure 15 (the ring has no wavelet), two of sizes
    for chart in charts:
        assert "var(--ink)" in chart
        assert "#333333" not in chart
        assert "#0072b2" not in chart
        assert "<text" in chart
        assert "<metadata" not in chart


def test_pictures_are_those_of_the_results_and_their_errors():
    results = make_results(make_rows(codecs=CODECS[:2]))
    body, notes, taken = compare_html(results, "ring", 6)
    shown = json.loads(re.search(r'<script type="application/json">(.*?)</script>', body)[1])
    assert [each["name"] for each in shown][:3] == ["reference", "ULS, plain", "ULS, half float"]
    assert len(shown) == 9
    assert taken > 0
    assert notes

    def opened(each, kind):
        return np.asarray(Image.open(io.BytesIO(uncoded(each[kind], "image/png"))).convert("RGB"))

    reference, picture = results.pictures["ring/reference"], results.pictures["ring/uls/6/none"]
    np.testing.assert_array_equal(opened(shown[0], "picture"), reference)
    np.testing.assert_array_equal(opened(shown[1], "picture"), picture)
    assert shown[1]["facts"].startswith(f"{psnr_8bit(picture, reference):.2f} dB")
    import matplotlib

    scaled = np.abs(picture.astype(float) - reference).mean(axis=2) * 8 / 255
    expected = matplotlib.colormaps["inferno"](np.rint(255 * np.clip(scaled, 0, 1)).astype(int))[..., :3]
    assert np.abs(opened(shown[1], "error") - 255 * expected).max() <= 1


def test_flip_maps_are_there_where_flip_is(monkeypatch):
    results = make_results(make_rows(codecs=CODECS[:1], methods=("uls",)))
    monkeypatch.setattr("clrelight.report.comparing.importlib.util.find_spec", lambda name: None)
    body, notes, _ = compare_html(results, "ring", 6)
    assert '"flip"' not in body
    assert any("clrelight[flip]" in note for note in notes)
    monkeypatch.undo()
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is not installed")
    body, notes, _ = compare_html(results, "ring", 6)
    shown = json.loads(re.search(r'<script type="application/json">(.*?)</script>', body)[1])
    from clrelight.perception import display_of, flip_of

    pair = [display_of(results.pictures[f"ring/{key}"] / 255.0, "srgb") for key in ("reference", "uls/6/none")]
    assert shown[1]["facts"].endswith(f"FLIP {flip_of(*pair).mean():.4f}")
    assert uncoded(shown[1]["flip"], "image/png")


def test_large_pictures_are_averaged_and_too_many_left_out(monkeypatch):
    rows = make_rows(codecs=CODECS[:2], methods=("uls",))
    reference = np.random.default_rng(0).integers(0, 255, (70, 33, 3)).astype(np.uint8)
    pictures = {"ring/reference": reference, "ring/uls/6/none": reference, "ring/uls/6/half": reference}
    monkeypatch.setattr("clrelight.report.comparing.LONGEST_SIDE", 35)
    body, notes, _ = compare_html(Results(rows, pictures), "ring", 6, room=1)
    shown = json.loads(re.search(r'<script type="application/json">(.*?)</script>', body)[1])
    picture = np.asarray(Image.open(io.BytesIO(uncoded(shown[0]["picture"], "image/png"))))
    assert picture.shape == (35, 17, 3)
    np.testing.assert_array_equal(picture[0, 0], np.rint(reference[:2, :2].mean(axis=(0, 1))))
    np.testing.assert_array_equal(picture[3, -1], np.rint(reference[6:8, 32:].mean(axis=(0, 1))))
    assert any("2×2" in note for note in notes)


def test_pictures_beyond_the_room_are_counted():
    results = make_results(make_rows(codecs=CODECS[:4]))
    body, notes, taken = compare_html(results, "ring", 6, room=20_000)
    shown = json.loads(re.search(r'<script type="application/json">(.*?)</script>', body)[1])
    assert 2 <= len(shown) < 17
    assert any(note.startswith(f"{17 - len(shown)} more pictures") for note in notes)
    assert taken > 20_000


def test_tables_hold_every_number_to_sort_by():
    table = Table(
        "a <b>", (Column("w", "w<"), Column("x", "x", 1)), (("b\u202ex", 1.25), ("a", math.inf), ("c", math.nan))
    )
    text = table_html(table, file="t.csv")
    assert re.findall(r'<td data-value="([^"]*)">([^<]*)', text) == [("1.25", "1.2"), ("Infinity", "∞"), ("", "–")]
    assert "\u202e" not in text
    assert "w&lt;" in text
    link = re.search(r'download="t.csv" href="([^"]+)"', text)[1]
    assert uncoded(link, "text/csv").decode().splitlines()[0] == "w,x"


def test_plain_text_and_json_end_no_element():
    assert plain("<a\n b>\x00&\"'") == "&lt;a b&gt;\ufffd&amp;&quot;&#x27;"
    assert json_block({"a": "</script><!--"}).count("<") == 2
    assert json.loads(re.sub("<[^>]*>", "", json_block({"a": "</script><!--"}))) == {"a": "</script><!--"}


def test_rows_csv_has_every_column(written):
    rows = list(csv.DictReader(io.StringIO((written.parent / "rows.csv").read_text(encoding="utf-8"))))
    assert tuple(rows[0]) == ROW_DTYPE.names
    results = hostile_results()
    assert [row["scene"] for row in rows] == [name.decode() for name in results.table["scene"]]
    assert [float(row["psnr_mean"]) for row in rows] == results.table["psnr_mean"].tolist()
    link = re.findall(r'download="rows.csv" href="([^"]+)"', written.read_text(encoding="utf-8"))
    assert uncoded(html.unescape(link[0]), "text/csv") == (written.parent / "rows.csv").read_bytes()


def test_parquet_holds_the_same_rows(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    results = hostile_results()
    paths = write_report(results, tmp_path / "out", parquet=True)
    assert "rows.parquet" in {path.name for path in paths}
    table = parquet.read_table(tmp_path / "out" / "rows.parquet").to_pydict()
    assert tuple(table) == ROW_DTYPE.names
    assert table["psnr_mean"] == results.table["psnr_mean"].tolist()
    assert table["device"][-1] == HOSTILE
    assert table["rate"][0] is None
    assert table["coding_psnr"][0] == math.inf


def test_parquet_is_refused_without_pyarrow_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)  # as where it is not installed, or does not load
    with pytest.raises(InputError, match=r"pip install 'clrelight\[parquet\]'"):
        write_report(hostile_results(), tmp_path / "out", parquet=True)
    # Before results are read: the file is not looked at.
    ended = call("report", tmp_path / "none.h5", "--out", tmp_path / "out", "--parquet")
    line = "clrelight: Parquet needs pyarrow: pip install 'clrelight[parquet]', or take rows.csv\n"
    assert (ended.code, ended.out, ended.err) == (2, "", line)
    assert not (tmp_path / "out").exists()


def browsed(page, tmp_path):
    """Return what a browser makes of a page."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium is installed")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000", "--dump-dom")
    home = f"--user-data-dir={tmp_path / 'browser'}"
    done = subprocess.run([browser, *options, home, page.as_uri()], capture_output=True, text=True, timeout=120)
    return done.stdout


def test_a_browser_shows_and_sorts(written, tmp_path):
    """The page's own script runs under its policy; clicks and keys are then made by one more."""
    text = written.read_text(encoding="utf-8")
    clicks = """
      const tables = [...document.querySelectorAll("table.sortable")];
      const table = tables.find((t) => t.caption.textContent.includes("All rows of ring"));
      const head = [...table.tHead.rows[0].cells].find((c) => c.textContent === "PSNR mean, fitted");
      const values = () => [...table.tBodies[0].rows].map((r) => r.cells[head.cellIndex].textContent).join(" ");
      head.querySelector("button").click();
      const up = values();
      head.querySelector("button").click();
      const box = document.querySelector(".compare");
      const set = (name, value, kind) => {
        const control = box.querySelector(`[name=${name}]`);
        control.value = value;
        control.dispatchEvent(new Event(kind));
      };
      set("at", 25, "input"); set("right", 2, "change"); set("kind", "error", "change");
      document.title = JSON.stringify([up, values(), head.getAttribute("aria-sort"),
        box.querySelector("output").textContent, box.querySelector(".right").style.clipPath,
        box.querySelector(".right").naturalWidth, box.querySelector("[name=at]").getAttribute("aria-valuetext")]);
    """
    page = tmp_path / "page.html"
    page.write_text(
        re.sub(r"script-src 'sha256-[^']+'", "script-src 'unsafe-inline'", text).replace(
            "</body>", f"<script>{clicks}</script></body>"
        ),
        encoding="utf-8",
    )
    up, down, order, words, clip, _, spoken = json.loads(
        html.unescape(re.search(r"<title>(.*?)</title>", browsed(page, tmp_path))[1])
    )
    numbers = [float(each) for each in up.split()]
    assert numbers == sorted(numbers)
    assert [float(each) for each in down.split()] == numbers[::-1]
    assert order == "descending"
    assert words.startswith("Left: reference. Right: error ×8 of ULS, half float, ")
    assert clip in ("inset(0px 0px 0px 25%)", "inset(0 0 0 25%)")
    assert spoken == "left picture up to 25 percent"
    untouched = browsed(written, tmp_path)
    assert "<output>Left: reference. Right: ULS, plain, " in untouched
    assert "onerror=alert(1)&gt;" in untouched
    assert not re.search(r"<img[^>]*onerror", untouched)
