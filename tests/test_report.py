"""The report: tables as data and as files, pictures, the page, and what happens to files that are there already."""

import csv
import io
import math
import re
import sys

import matplotlib.image
import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.report import all_rows, summary_rows, table_i, table_iii, write_report
from clrelight.report.canvas import spread
from clrelight.report.contact_sheet import lit_part, psnr_8bit
from clrelight.report.markup import escape_markdown, escape_tex, to_csv, to_latex, to_markdown
from clrelight.report.rows import Setting, file_suffixes, parse_picture_key
from clrelight.report.tables import Column, Table
from clrelight.results import ROW_DTYPE, Results

NAN, INF = math.nan, math.inf
SIZE = 48
PLAIN_DB = {"ceb": 30.68, "uls": 31.21, "cls": 30.81, "sloan": 31.16}  # not in the paper's order
LOSS_DB = {"uls": 16.0, "sloan": 10.0, "cls": 0.9, "ceb": 0.7}
ENERGY = {"uls": 6630.0, "sloan": 211.0, "cls": 0.68, "ceb": 0.53}
CODECS = [("none", NAN, 32.0), ("half", NAN, 16.0), ("s3tc", NAN, 14 / 3), ("uniform", 8.0, 8.01)]
CODECS += [("wavelet", rate, 0.994 * rate) for rate in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)]


def make_rows(scene="ring", degree=6, methods=tuple(PLAIN_DB), codecs=CODECS, held_out=False):
    rows = np.zeros(len(methods) * len(codecs), ROW_DTYPE)
    pairs = ((method, codec) for method in methods for codec in codecs)
    for row, (method, (codec, rate, bits)) in zip(rows, pairs, strict=True):
        n = (degree + 1) ** 2
        loss = 0.0 if codec == "none" else LOSS_DB.get(method, 1.0) * 4.67 / max(bits, 4.67 / 1.5)
        row["scene"], row["method"], row["degree"], row["codec"], row["rate"] = scene, method, degree, codec, rate
        row["n_light"], row["n_holdout"], row["n_coeff"] = 256, 64 * held_out, n
        row["height"], row["width"], row["channel"] = SIZE, SIZE, 3
        row["encoded_bytes"] = round(bits * n * SIZE * SIZE * 3 / 8)
        row["bits_per_coefficient"] = bits
        row["entropy_bits"] = 5.4321 if codec == "uniform" else NAN
        row["mean_energy"] = ENERGY.get(method, 1.0)
        row["psnr_mean"] = PLAIN_DB.get(method, 30.0) - loss
        row["psnr_pooled"] = row["psnr_mean"] - 0.5
        noise = (INF, INF, INF) if codec == "none" else (30.125, 40.25, 40.5)
        row["coding_psnr_independent"], row["coding_psnr_predicted"], row["coding_psnr"] = noise
        row["psnr_mean_holdout"] = row["psnr_mean"] - 1.0 if held_out else NAN
        row["psnr_pooled_holdout"] = row["psnr_mean"] - 1.25 if held_out else NAN
        row["seconds_fit"], row["seconds_encode"] = 0.125, 0.0625
        row["seed"], row["device"], row["versions"], row["commit"] = 7, "cpu: PoCL", "clrelight 0.1", "abc123"
    return rows


def make_pictures(table, channels=3):
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    reference = np.stack([40 + 180 * x, 40 + 180 * y, 128 + 0 * x], axis=2)[:, :, :channels]
    rng = np.random.default_rng(1)
    pictures = {}
    for row in table:
        scene, method, codec = (row[name].decode() for name in ("scene", "method", "codec"))
        noisy = reference + rng.normal(0, 255 * 10 ** (-row["psnr_mean"] / 20), reference.shape)
        rate = "" if math.isnan(row["rate"]) else f"@{row['rate']:g}"
        pictures[f"{scene}/reference"] = reference.astype(np.uint8)
        pictures[f"{scene}/{method}/{row['degree']}/{codec}{rate}"] = np.clip(noisy, 0, 255).astype(np.uint8)
    return pictures


def make_profiles(table):
    rng = np.random.default_rng(2)
    keys = {(row["scene"].decode(), row["method"].decode(), int(row["degree"])): row for row in table}
    return {
        f"{scene}/{method}/{degree}": rng.normal(size=row["n_coeff"]) * math.sqrt(row["mean_energy"] / row["n_coeff"])
        for (scene, method, degree), row in keys.items()
    }


def make_results(table, channels=3):
    return Results(table, make_pictures(table, channels), make_profiles(table))


def numbers_of(path):
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


@pytest.fixture(scope="module")
def ring():
    return make_results(make_rows())


@pytest.fixture(scope="module")
def written(ring, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "new" / "folder"
    return out, write_report(ring, out)


# --- tables as data


def test_table_iii_puts_the_papers_printed_numbers_beside_ours(ring):
    table = table_iii(ring, "ring")
    assert table.values("method") == ["ULS", "Sloan ULS", "CLS", "CEB"]
    assert table.values("psnr_plain_paper") == [32.21, 31.67, 31.32, 30.75]
    assert table.values("psnr_s3tc_paper") == [15.28, 24.31, 29.73, 29.79]
    rows = {(row["method"].decode(), row["codec"].decode()): row["psnr_mean"] for row in ring.table}
    assert table.values("psnr_plain") == [rows[m, "none"] for m in ("uls", "sloan", "cls", "ceb")]
    assert table.values("psnr_s3tc") == [rows[m, "s3tc"] for m in ("uls", "sloan", "cls", "ceb")]
    assert "degree" not in [column.key for column in table.columns]


def test_table_i_has_uls_and_cls_from_plain_coefficients(ring):
    table = table_i(ring, "ring")
    assert table.values("method") == ["ULS", "CLS"]
    assert table.values("psnr") == [31.21, 30.81]
    assert table.values("psnr_paper") == [32.21, 31.32]


@pytest.mark.parametrize(("scene", "degree"), [("ring", 4), ("cat", 6), ("my ring", 6)])
def test_the_papers_numbers_stand_only_beside_its_own_setting(scene, degree):
    results = Results(make_rows(scene, degree))
    for table in (table_i(results, scene), table_iii(results, scene)):
        assert not [column.key for column in table.columns if column.key.endswith("_paper")]


def test_of_several_degrees_only_the_papers_has_its_numbers():
    results = Results(np.concatenate([make_rows(degree=6), make_rows(degree=3)]))
    table = table_i(results, "ring")
    assert table.values("degree") == [3, 3, 6, 6]
    np.testing.assert_equal(table.values("psnr_paper"), [NAN, NAN, 32.21, 31.32])


def test_methods_that_the_paper_does_not_know_follow_its_own_by_name():
    results = Results(make_rows(methods=("spline", "ceb", "project", "uls")))
    table = table_iii(results, "ring")
    assert table.values("method") == ["ULS", "CEB", "project", "spline"]
    np.testing.assert_equal(table.values("psnr_s3tc_paper"), [15.28, 29.79, NAN, NAN])


def test_tables_are_none_where_their_rows_are_missing():
    results = Results(make_rows(methods=("sloan",), codecs=[("half", NAN, 16.0)]))
    assert table_i(results, "ring") is None
    assert table_iii(results, "ring") is None
    assert table_iii(Results(make_rows(codecs=CODECS[:2])), "ring") is None
    assert table_iii(Results(make_rows(codecs=CODECS[2:3])), "ring") is None


def test_all_rows_keeps_every_row_in_a_fixed_order():
    table = make_rows()
    shuffled = np.random.default_rng(3).permutation(table)
    assert to_csv(all_rows(Results(table))) == to_csv(all_rows(Results(shuffled)))
    rows = all_rows(Results(table))
    assert len(rows.rows) == len(table)
    assert rows.values("codec")[:5] == ["none", "half", "s3tc", "uniform", "wavelet"]
    assert rows.values("rate")[4:10] == [8.0, 4.0, 2.0, 1.0, 0.5, 0.25]


def test_summary_has_held_out_lights_only_where_there_are_some():
    headers, rows = summary_rows(Results(make_rows()))
    assert len(rows) == 40
    assert {len(row) for row in rows} == {len(headers)} == {11}
    assert rows[0] == ["ring", "uls", "6", "plain", "32.000", "1354.8", "31.21", "∞", "∞", "0.125", "0.062"]
    assert rows[5][3] == "wavelet 4 bit"
    headers, rows = summary_rows(Results(make_rows(held_out=True)))
    assert rows[0][headers.index("held out, pooled (dB)")] == "29.96"


# --- tables as text

ODD = Table(
    "odd\n100% & more",
    (Column("name", "na|me_1"), Column("n", "n"), Column("db", "dB", 2), Column("big", "big", 2)),
    (("a_b|c*d", 1, INF, 6e22), ("50% & $x$ \\ {~^#<b>}", 20, NAN, 0.5), ("line\nbreak", 300, -3.14159, NAN)),
)


def test_csv_parses_back_to_the_same_numbers():
    parsed = list(csv.DictReader(io.StringIO(to_csv(ODD))))
    assert [row["name"] for row in parsed] == [row[0] for row in ODD.rows]
    assert [row["db"] for row in parsed] == ["inf", "", "-3.14159"]
    assert [float(row["big"] or "nan") for row in parsed][:2] == [6e22, 0.5]
    values = np.random.default_rng(4).normal(size=20) ** 9
    table = Table("", (Column("v", "v", 2),), tuple((float(v),) for v in values))
    assert [float(line) for line in to_csv(table).split()[1:]] == values.tolist()


def test_markdown_has_the_same_columns_in_each_line_and_aligned_points():
    lines = to_markdown(ODD).splitlines()
    assert len(lines) == 5
    for line in lines:
        assert len(re.findall(r"(?<!\\)\|", line)) == 5
    assert len(set(map(len, lines))) == 1
    assert "∞" in lines[2]
    assert re.search(r"\| +– \|", lines[3])
    assert re.fullmatch(r"\| :-+ \| -+: \| -+: \| -+: \|", lines[1])
    assert "6.00e+22" in lines[2]
    assert "5.00e-01" in lines[3]
    assert "<b>" not in to_markdown(ODD)


def test_escaping_leaves_nothing_to_the_markup():
    assert escape_tex("a_b & 50% {~^\\#$}\n<") == (
        r"a\_b \& 50\% \{\textasciitilde{}\textasciicircum{}\textbackslash{}\#\$\} \textless{}"
    )
    assert escape_markdown("a_b|`c` *d* [e]\n<f> & g") == r"a\_b\|\`c\` \*d\* \[e\] &lt;f&gt; &amp; g"


def check_latex(source, columns, rows):
    body = re.sub(r"(?m)^%.*$", "", source)
    assert body.count(r"\begin{tabular}") == body.count(r"\end{tabular}") == 1
    assert re.search(r"\\begin\{tabular\}\{([lr]+)\}", body)[1].__len__() == columns
    bare = re.sub(r"\\[&%$#_{}]", "", body)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    assert not re.search(r"[#%~]", bare)
    assert not re.search(r"[_^]", re.sub(r"\$[^$]*\$", "", bare))
    lines = [line for line in body.splitlines() if line.endswith(r"\\")]
    assert len(lines) == rows + 1
    for line in lines:
        assert len(re.findall(r"(?<!\\)&", line)) == columns - 1


def test_latex_is_balanced_and_escaped():
    source = to_latex(ODD)
    check_latex(source, 4, 3)
    assert r"$\infty$" in source
    assert r"$6.00\cdot10^{22}$" in source
    assert "% odd 100% & more\n" in source


# --- names


def test_file_suffixes_are_distinct_and_portable():
    assert file_suffixes(["any/thing"]) == {"any/thing": ""}
    suffixes = file_suffixes(["a b", "a/b", "A_B", "../..", "é"])
    assert len({suffix.casefold() for suffix in suffixes.values()}) == 5
    assert all(re.fullmatch(r"_[A-Za-z0-9-]+", suffix) for suffix in suffixes.values())


def test_picture_keys():
    assert parse_picture_key("a/b/reference") is None
    assert parse_picture_key("a/b/cls/6/wavelet@0.50") == ("a/b", "cls", 6, Setting("wavelet", "0.5"))
    assert parse_picture_key("ring/uls/6/none") == ("ring", "uls", 6, Setting("none", ""))
    for wrong in ("ring", "ring/uls/none", "ring/uls/six/none", "ring/uls/6/wavelet@fast", "ring/uls/6/"):
        with pytest.raises(InputError, match="SCENE/reference"):
            parse_picture_key(wrong)


# --- pictures


def test_spread_keeps_order_and_gap_and_moves_nothing_without_need():
    np.testing.assert_allclose(spread([0.1, 0.9, 0.5], 0.1), [0.1, 0.9, 0.5])
    np.testing.assert_allclose(spread([0.5, 0.5], 0.1), [0.45, 0.55])
    crowded = np.random.default_rng(5).uniform(0.9, 1.4, 8)
    moved = spread(crowded, 0.08)
    assert moved.min() >= 0
    assert moved.max() <= 1
    assert np.diff(moved[np.argsort(crowded)]).min() >= 0.08 - 1e-12
    assert np.diff(spread(crowded, 0.5)[np.argsort(crowded)]).min() == pytest.approx(1 / 7)
    assert len(spread([], 0.1)) == 0


def test_psnr_8bit():
    reference = np.full((4, 4, 3), 100, np.uint8)
    assert psnr_8bit(reference, reference) == INF
    assert psnr_8bit(reference - np.uint8(10), reference) == pytest.approx(20 * math.log10(25.5))
    assert psnr_8bit(reference + np.uint8(10), reference) == pytest.approx(20 * math.log10(25.5))


def test_lit_part_drops_black_margins_only():
    picture = np.zeros((100, 80, 1), np.uint8)
    assert picture[lit_part(picture)].shape == picture.shape
    picture[40:60, 30:35] = 200
    assert picture[lit_part(picture)].shape == (26, 11, 1)
    picture[0, 0] = picture[-1, -1] = 200
    assert picture[lit_part(picture)].shape == picture.shape


def check_png(path, width=None):
    image = matplotlib.image.imread(path)
    assert min(image.shape[:2]) > 200
    assert width is None or image.shape[1] == width
    levels = (255 * image[:, :, :3]).round().astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
    assert len(np.unique(levels)) > 30
    for border in (image[:, 0], image[:, -1], image[0], image[-1]):
        assert (border == 1).all(), "something is cut off"
    return image


def test_pictures_are_there_and_not_blank(written):
    out, _ = written
    for name in ("figure_7", "figure_15", "quality_vs_size"):
        check_png(out / "figures" / f"{name}.png", width=1350)
    sheet = check_png(out / "figures" / "contact_sheet.png", width=2 * 20 + 5 * 288 + 4 * 8)
    assert sheet.shape[0] > len(CODECS) * 2 * 288


def test_contact_sheet_shows_reference_pictures_and_errors_pixel_by_pixel():
    from clrelight.report.contact_sheet import contact_sheet

    table = make_rows(methods=("uls",), codecs=CODECS[:1])
    results = make_results(table)
    sheet = contact_sheet(results, "ring", 6)
    shown = [axes.images[0].get_array() for axes in sheet.axes if axes.images]
    reference, picture = results.pictures["ring/reference"], results.pictures["ring/uls/6/none"]
    np.testing.assert_array_equal(shown[0], reference)
    np.testing.assert_array_equal(shown[1], picture)
    np.testing.assert_allclose(shown[2], np.abs(picture.astype(float) - reference).mean(axis=2))
    words = [text.get_text() for text in sheet.texts]
    assert f"{psnr_8bit(picture, reference):.2f} dB" in words
    assert "32 bits/coefficient" in words


def test_figure_15_draws_the_bits_that_were_written(ring):
    from clrelight.report.charts import figure_15

    (axes,) = figure_15(ring, "ring", 6).axes
    curves = [line.get_xydata() for line in axes.lines if len(line.get_xydata()) == 6]
    assert len(curves) == 4
    for curve in curves:
        np.testing.assert_allclose(curve[:, 0], 0.994 * np.array([0.25, 0.5, 1, 2, 4, 8]))
    plain = [line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "--"]
    assert plain == [31.21, 31.16, 30.81, 30.68]


# --- the whole report


def test_the_report_writes_every_part(ring, written):
    out, paths = written
    assert paths[0].name == "report.md"
    names = {path.relative_to(out.resolve()).as_posix() for path in paths}
    assert names == {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    tables = {
        f"tables/{name}.{end}" for name in ("table_1", "table_3", "noise", "all_rows") for end in ("md", "csv", "tex")
    }
    pictures = {f"figures/{name}.png" for name in ("figure_7", "figure_15", "contact_sheet", "quality_vs_size")}
    assert names == tables | pictures | {"report.md", "report.html", "rows.csv"}
    assert [path.name for path in out.parent.iterdir()] == ["folder"]
    for name, columns, rows in (("table_1", 3, 2), ("table_3", 6, 4), ("noise", 8, 36), ("all_rows", 18, 40)):
        check_latex((out / "tables" / f"{name}.tex").read_text(encoding="utf-8"), columns, rows)
    parsed = numbers_of(out / "tables" / "all_rows.csv")
    for key in ("psnr_mean", "bits_per_coefficient", "mean_energy", "psnr_pooled"):
        assert sorted(float(row[key]) for row in parsed) == sorted(ring.table[key].tolist())
    assert {row["psnr_mean_holdout"] for row in parsed} == {""}


def test_the_page_says_what_was_measured_and_links_only_what_exists(written):
    out, _ = written
    page = (out / "report.md").read_text(encoding="utf-8")
    for words in (
        "48×48 pixels of 3 channels",
        "256 fitted lights, 0 held out",
        "degree 6 (49 coefficients)",
        "abc123",
    ):
        assert words in page
    assert "cpu: PoCL" in page
    links = re.findall(r"\]\(([^)]+)\)", page)
    assert len(links) == 12
    assert all((out / link).is_file() for link in links)
    assert "32.21" in page
    assert "Left out" not in page


def test_the_same_results_give_the_same_bytes(ring, written, tmp_path):
    _, paths = written
    matplotlib.rcParams["font.size"], before = 30, matplotlib.rcParams["font.size"]  # another user's settings
    try:
        again = write_report(ring, tmp_path / "again")
        assert matplotlib.rcParams["font.size"] == 30
    finally:
        matplotlib.rcParams["font.size"] = before
    assert [p.name for p in again] == [p.name for p in paths]
    for one, other in zip(paths, again, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name
        assert b"Software" not in one.read_bytes() or one.suffix != ".png"


def test_what_is_missing_is_left_out_with_a_line(tmp_path):
    steps = []
    results = Results(make_rows("bare|scene", methods=("cls",), codecs=CODECS[:2]))
    paths = write_report(results, tmp_path / "out", progress=lambda done, total: steps.append((done, total)))
    names = [path.name for path in paths]
    assert "table_1.md" in names
    assert "quality_vs_size.png" in names
    assert "table_3.md" not in names
    assert not {"contact_sheet.png", "figure_7.png", "figure_15.png"} & set(names)
    page = paths[0].read_text(encoding="utf-8")
    left_out = page[page.index("### Left out") :]
    for heading in ("Table III", "Figure 15", "Figure 7", "Contact sheet"):
        assert len(re.findall(rf"- {heading}.*: left out, .*\.", left_out)) == 1
    assert r"bare\|scene" in page
    assert steps == [(i, 8) for i in range(9)]


def test_several_scenes_degrees_and_held_out_lights(tmp_path):
    parts = [make_rows(degree=degree, codecs=CODECS[:1] + CODECS[-2:], held_out=True) for degree in (2, 6)]
    parts.append(make_rows("cat $1_a$", degree=3, methods=("spline", "cls"), codecs=CODECS[:3], held_out=True))
    results = make_results(np.concatenate(parts), channels=1)
    names = {path.name for path in write_report(results, tmp_path)}
    assert {"table_1_ring.md", "table_1_cat-1-a.md", "table_3_cat-1-a.tex", "all_rows_ring.csv"} <= names
    assert {"figure_15_ring_degree_2.png", "figure_15_ring_degree_6.png", "contact_sheet_cat-1-a.png"} <= names
    assert "figure_15_cat-1-a.png" not in names
    for name in names:
        if name.endswith(".png"):
            check_png(tmp_path / "figures" / name)
    page = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "PSNR mean, held out" in page
    assert "256 fitted lights, 64 held out; degree 2 (9 coefficients), 6 (49 coefficients)" in page


def test_infinite_and_unmeasured_psnr_do_not_break_anything(tmp_path):
    table = make_rows(methods=("uls", "cls"))
    table["psnr_mean"][0] = INF
    table["psnr_mean"][1:10] = NAN
    paths = write_report(Results(table), tmp_path)
    assert "∞" in paths[0].read_text(encoding="utf-8")
    assert numbers_of(tmp_path / "tables" / "table_1.csv")[0]["psnr"] == "inf"
    table["psnr_mean"] = INF
    assert "quality_vs_size.png" not in [path.name for path in write_report(Results(table), tmp_path / "b")]


def test_rows_that_share_a_key_are_counted_and_the_first_is_shown(tmp_path):
    table = make_rows(methods=("uls", "cls"), codecs=CODECS[:3])
    other = table.copy()
    other["psnr_mean"] = 1.0
    results = Results(np.concatenate([table, other]))
    assert table_i(results, "ring").values("psnr") == [31.21, 30.81]
    page = write_report(results, tmp_path)[0].read_text(encoding="utf-8")
    assert "6 rows share scene, method, degree, codec and rate" in page
    assert len(numbers_of(tmp_path / "tables" / "all_rows.csv")) == 12


# --- what stands in the way


def test_foreign_files_stay_and_old_ones_are_replaced(tmp_path):
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "mine.txt").write_text("mine")
    (tmp_path / "report.md").write_text("old")
    write_report(Results(make_rows(codecs=CODECS[:1])), tmp_path)
    assert (tmp_path / "tables" / "mine.txt").read_text() == "mine"
    assert (tmp_path / "report.md").read_text(encoding="utf-8").startswith("# ")


def test_nothing_is_replaced_if_a_part_cannot_be_made(tmp_path):
    table = make_rows(methods=("uls",), codecs=CODECS[:1])
    pictures = make_pictures(table)
    pictures["ring/uls/6/none"] = pictures["ring/uls/6/none"][:-1]
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.md").write_text("old")
    with pytest.raises(InputError, match=r"ring/uls/6/none has shape \(47, 48, 3\), its reference has \(48, 48, 3\)"):
        write_report(Results(table, pictures), out)
    assert [path.name for path in out.iterdir()] == ["report.md"]
    assert (out / "report.md").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_bad_input_is_refused_in_one_line(tmp_path):
    results = Results(make_rows(methods=("uls",), codecs=CODECS[:1]))
    with pytest.raises(InputError, match="the results table is empty"):
        write_report(Results(results.table[:0]), tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file; give a folder"):
        write_report(results, tmp_path / "file")
    with pytest.raises(InputError, match="cannot write the report"):
        write_report(results, tmp_path / "file" / "below")
    (tmp_path / "out" / "report.md").mkdir(parents=True)
    with pytest.raises(InputError, match="is a folder, but the report has a file of that name"):
        write_report(results, tmp_path / "out")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "tables").write_text("x")
    with pytest.raises(InputError, match="is a file, but the report has a folder of that name"):
        write_report(results, tmp_path / "other")
    bad = {"ring/reference": np.zeros((4, 4, 3)), "ring/uls/6/none": np.zeros((4, 4, 3))}
    with pytest.raises(InputError, match="ring/reference is float64"):
        write_report(Results(results.table, bad), tmp_path / "p")
    with pytest.raises(InputError, match="is not SCENE/METHOD/DEGREE"):
        write_report(Results(results.table, {}, {"uls": np.zeros(4)}), tmp_path / "p")
    with pytest.raises(InputError, match=r"ring/uls/6 has shape \(0,\), expected"):
        write_report(Results(results.table, {}, {"ring/uls/6": np.zeros(0)}), tmp_path / "p")
    assert not (tmp_path / "p").exists()


def test_without_matplotlib_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(InputError, match=r"pictures need matplotlib: pip install 'clrelight\[report\]'"):
        write_report(Results(make_rows()), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_importing_the_report_does_not_import_matplotlib():
    import subprocess

    code = "import sys, clrelight.report; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
