"""Light files as people write them: each says the directions below, or is refused in one line."""

import unicodedata

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.light_files import read_light_file, read_table

NAMES = ("a1.png", "my scan 2.png", "a3.png", "a4.png")
DIRECTIONS = ((0.6, 0.0, 0.8), (0.0, -0.6, 0.8), (-0.28, 0.0, 0.96), (0.0, 0.28, 0.96))


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def point(value):
    return f"{value:.6f}"


def comma(value):
    return point(value).replace(".", ",")


def rows(between=" ", number=point, line="{n}", end="\n"):
    """Return a table; `line` says what stands around the numbers {n} of light {i}."""
    lines = (line.format(n=between.join(map(number, d)), i=i, name=NAMES[i]) for i, d in enumerate(DIRECTIONS))
    return "".join(each + end for each in lines)


TABLES = {
    "blanks": rows("  "),
    "tabs": rows("\t"),
    "commas": rows(","),
    "commas and blanks": rows(", "),
    "commas at the end": rows(",", line="{n},"),
    "semicolons": rows(";"),
    "decimal commas": rows(number=comma),
    "decimal commas, tabs": rows("\t", comma),
    "decimal commas, semicolons": rows(";", comma),
    "decimal commas, semicolons, blanks": rows(" ; ", comma, "{n} ;"),
    "decimal commas, commas and blanks": rows(", ", comma),
    "decimal commas, quoted": rows('","', comma, '"{n}"'),
    "exponents": rows(number=lambda v: f"{v:.8E}"),
    "fortran": rows(number=lambda v: f"{v:.8e}".replace("e", "D")),
    "minus signs": rows(number=lambda v: point(v).replace("-", "\u2212")),
    "no-break spaces": rows("\u00a0"),
    "matlab": "[" + rows(line="{n};") + "]\n",
    "numpy": "[" + rows(", ", line="[{n}],") + "]\n",
    "heading": "x,y,z\n" + rows(","),
    "heading in words": "light directions of the dome\n" + rows(),
    "heading of excel": "sep=;\nlx;ly;lz\n" + rows(";", comma),
    "heading with an index": "id,dir_x,dir_y,dir_z\n" + rows(",", line="{i},{n}"),
    "heading that leaves the index out": ",x,y,z\n" + rows(",", line="{i},{n}"),
    "count": "4\n" + rows(),
    "count with words": "4 lights\n" + rows(),
    "count after words": "number of lights: 4\n" + rows(),
    "rows and columns": "4 3\n" + rows(),
    "index": rows(line="{i} {n}"),
    "last column alike": rows(line="{n} 1.0"),
    "index and last column alike": rows(line="{i} {n} 2"),
    "comments": "; a\n// b\n% c\n# d\n\n" + rows(line="{n} # e"),
    "returns": rows(end="\r"),
    "returns and newlines": rows(end="\r\n"),
    "no last newline": rows()[:-1],
    "transposed": "\n".join(" ".join(map(point, column)) for column in zip(*DIRECTIONS, strict=True)),
    "transposed with a count": "4\n" + "\n".join(" ".join(map(comma, d)) for d in zip(*DIRECTIONS, strict=True)),
    "z second": "x z y\n" + "".join(f"{x} {z} {y}\n" for x, y, z in DIRECTIONS),
}
NAMED = {
    "blanks": rows(line="{name} {n}"),
    "commas": rows(",", line="{name},{n}"),
    "tabs": rows("\t", line="{name}\t{n}"),
    "decimal commas": rows(number=comma, line="{name} {n}"),
    "decimal commas, semicolons": rows(";", comma, "{name};{n}"),
    "decimal commas, quoted": rows('","', comma, '"{name}","{n}"'),
    "quoted": rows(line='"{name}" {n}'),
    "heading": "filename,x,y,z\n" + rows(",", line="{name},{n}"),
    "heading and more columns": "image,x,y,z,power\n" + rows(",", line="{name},{n},{i}"),
    "name last": rows(line="{n} {name}"),
    "name last, commas": rows(",", line="{n},{name}"),
    "last column alike": rows(line="{name} {n} 1.0"),
    "index after the name": rows(line="{name} {i} {n}"),
    "comments": "# dome\n; by hand\n" + rows(line="{name} {n} # seen"),
    "blank lines": rows(line="\n{name} {n}\n"),
}


@pytest.mark.parametrize("suffix", [".txt", ".csv"])
@pytest.mark.parametrize("form", TABLES)
def test_table_of_numbers(tmp_path, form, suffix):
    file = read_light_file(write(tmp_path / f"t{suffix}", TABLES[form]))
    np.testing.assert_allclose(file.directions_i3, DIRECTIONS, atol=1e-12)
    assert (file.names, file.count_notes()) == ((), [])
    assert file.announced == (4 if "count" in form or form == "rows and columns" else None)


@pytest.mark.parametrize("opening", [None, "4", "4 images", "images: 4", "4,,,"])
@pytest.mark.parametrize("form", NAMED)
def test_table_with_names(tmp_path, form, opening):
    for suffix in (".lp", ".csv"):
        text = NAMED[form] if opening is None else f"{opening}\n{NAMED[form]}"
        file = read_light_file(write(tmp_path / f"t{suffix}", text))
        np.testing.assert_allclose(file.directions_i3, DIRECTIONS, atol=1e-12)
        assert file.names == NAMES
        assert file.announced == (4 if opening else None)
        noted = ["t.lp does not open with the number of its lights; all 4 were taken"]
        assert file.count_notes() == (noted if opening is None and suffix == ".lp" else [])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "windows-1252"])
def test_encodings(tmp_path, encoding):
    text = "1\r\nschädel.png 0 0.6 0.8\r\n"
    file = read_light_file(write(tmp_path / "a.lp", text, encoding))
    assert (file.names, file.directions_i3.tolist()) == (("schädel.png",), [[0, 0.6, 0.8]])
    noted = ("a.lp is not UTF-8, and was read as Windows-1252",)
    assert file.notes == (noted if encoding == "windows-1252" else ())
    decomposed = unicodedata.normalize("NFD", text)
    assert read_light_file(write(tmp_path / "b.lp", decomposed)).names == (unicodedata.normalize("NFD", "schädel.png"),)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("my scan 1 0 0 1", "my scan 1"),
        ("my scan 1 0,0 0,0 1,0", "my scan 1"),
        ("my scan 1,0,0,1", "my scan 1"),
        ("7 0 0 1", "7"),
        ("Smith, J. 01.png 0 0 1", "Smith, J. 01.png"),
        ("a#1.png 0 0 1", "a#1.png"),
        ("50%done.png 0 0 1", "50%done.png"),
        ("1.5.tif 0 0 1", "1.5.tif"),
        (r"C:\scans 2\a.jpg 0 0 1", r"C:\scans 2\a.jpg"),
        ("'it is.png' 0 0 1", "it is.png"),
        ("a.png 0 0 1 1", "a.png"),
    ],
)
def test_where_a_name_ends(tmp_path, line, name):
    file = read_light_file(write(tmp_path / "a.lp", f"1\n{line}\n"))
    assert (file.names, file.directions_i3.tolist()) == ((name,), [[0, 0, 1]])


def test_what_is_left_out_is_said(tmp_path):
    for form, words in (
        ("index", "the first column numbers the lines"),
        ("last column alike", "the last column is 1 everywhere and not used"),
        ("heading with an index", "column 'id' is not used"),
        ("z second", "x, y, z are columns 1, 3, 2 as its heading says"),
    ):
        assert read_light_file(write(tmp_path / "t.txt", TABLES[form])).notes == (f"t.txt: {words}",)


def test_counts_off_by_one_are_said(tmp_path):
    for announced in (3, 5):
        for name, text in (("t.txt", rows()), ("t.lp", rows(line="{name} {n}"))):
            file = read_light_file(write(tmp_path / name, f"{announced}\n{text}"))
            assert len(file.directions_i3) == 4
            assert file.count_notes() == [f"{name} announces {announced} lights, but lists 4; all 4 were taken"]


def test_three_lights_with_a_number_before_each(tmp_path):
    text = "1 0 0 1\n2 0.6 0 0.8\n3 0 0.6 0.8\n"
    expected = [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]]
    assert read_light_file(write(tmp_path / "t.txt", text)).directions_i3.tolist() == expected


def test_lights_in_a_plane_are_no_angles(tmp_path):
    text = "".join(f"{x} {y} 300\n" for x in (-150, 0, 150) for y in (-100, 100))
    assert read_light_file(write(tmp_path / "t.txt", text)).directions_i3.shape == (6, 3)


def test_long_lines_take_no_time(tmp_path):
    table = "\n".join(" ".join(["0.57735"] * 20_000) for _ in range(3))
    assert read_light_file(write(tmp_path / "t.txt", table)).directions_i3.shape == (20_000, 3)


def test_lp_names_may_contain_blanks(tmp_path):
    path = write(tmp_path / "a.lp", "\ufeff2\r\nmy lion 1.jpg  0 0.6\t0.8\r\n\r\n dir/b 2.jpg -1 0 1e-3 \r\n")
    file = read_light_file(path)
    assert file.names == ("my lion 1.jpg", "dir/b 2.jpg")
    assert file.directions_i3.tolist() == [[0, 0.6, 0.8], [-1, 0, 1e-3]]
    assert (file.lines, file.announced, file.notes, file.count_notes()) == ((2, 4), 2, (), [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "names no image"),
        ("-1\n", "line 1: expected the number of images"),
        ("²\n", "line 1: expected the number of images"),
        ("9999999999\na.jpg 0 0 1\n", "line 1: expected the number of images"),
        ("a.jpg\n", "line 1: expected an image name and x y z"),
        ("0\n", "names no image"),
        ("1\n0 0 1\n", "line 2: expected an image name and x y z"),
        ("1\n\na.jpg 0 zero 1\n", "line 3: expected a number, got 'zero'"),
        (
            "1\na.jpg 0 0\n",
            r"line 2: expected an image name and x y z \(two numbers look like angles\), got 'a.jpg 0 0'",
        ),
        ("2\na.jpg 0 0 1\nb.jpg 0 0 1 1\n", "line 3: expected 3 numbers, got 4"),
        ("4\na.jpg 0 0 1\nb.jpg 0 0 1\n", "announces 4 lights, but lists 2"),
        ("1\n" + "a.jpg 0 0 1\n" * 3, "announces 1 lights, but lists 3"),
        ("2\na.jpg 0 0 1 1\nb.jpg 0 0 1 2\n", "the fourth number of each light differs from line to line"),
        ("1\n" + "a" * 9000 + ".jpg 0 0 1", "line 2: expected an image name and x y z, got 9010 characters"),
    ],
)
def test_lp_that_does_not_parse(tmp_path, text, message):
    path = write(tmp_path / "a.lp", text)
    with pytest.raises(InputError, match=message) as error:
        read_light_file(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_numbers_with_commas_and_comments(tmp_path):
    path = write(tmp_path / "d.txt", "# x y z\n1, 2,3\n\n 4\t5 6e-1 # last\n")
    assert read_table(path).tolist() == [[1, 2, 3], [4, 5, 0.6]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "holds no numbers"),
        ("1 2 3\n\n4 5\n", "line 3: expected 3 numbers, got 2"),
        ("1 2 3\n4 5 x\n", "line 2: expected a number, got 'x'"),
        ("1 2 3\n4 1_0 3\n", "line 2: expected a number, got '1_0'"),
        ("1 2 3\n4 0x1 3\n", "line 2: expected a number, got '0x1'"),
        ("1,,2,3\n", "line 1: expected a number, got ''"),
        ("1 2\n3 4\n", r"2×2 numbers, expected N×3 or 3×N \(two numbers a light look like angles\)"),
        ("0 0 1 1\n0 1 1 2\n", "2×4 numbers, expected N×3 or 3×N .the fourth number of each light differs"),
        ("0.5 0,5 0,7\n", "line 1: has decimal commas and points"),
        ("0,577,0,577,0,577\n-0,577,0,577,0,577\n0,0,1,0,0,0\n", "line 1: commas both as decimal commas and between"),
        ("azimuth elevation\n30 40\n50 60\n", "line 1: azimuth and elevation are angles, expected directions as x y z"),
        ("theta phi r\n30 40 1\n50 60 1\n", "line 1: theta and phi are angles"),
        ("30 40 1\n50 60 1\n270 20 1\n0 45 1\n", "looks like two angles and the radius 1, expected x y z"),
        ("x,y,z\n0,0,1,5\n", "has 3 columns of numbers in its heading, but 4 below it"),
        ("2\n0 0 1\n0 1 1\n1 0 1\n1 1 1\n", "announces 2 lights, but lists 4"),
    ],
)
def test_table_that_does_not_parse(tmp_path, text, message):
    path = write(tmp_path / "d.txt", text)
    with pytest.raises(InputError, match=message) as error:
        read_light_file(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_light_file_that_is_no_text(tmp_path):
    path = tmp_path / "d.txt"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no text file"):
        read_light_file(path)


def test_table_is_read_by_rows_or_columns(tmp_path):
    rows = np.random.default_rng(1).normal(size=(5, 3))
    np.savetxt(tmp_path / "rows.txt", rows, fmt="%.17g")
    np.savetxt(tmp_path / "columns.txt", rows.T, fmt="%.17g", delimiter=",")
    np.testing.assert_array_equal(read_light_file(tmp_path / "rows.txt").directions_i3, rows)
    np.testing.assert_array_equal(read_light_file(tmp_path / "columns.txt").directions_i3, rows)
    assert read_light_file(write(tmp_path / "one.txt", "0\n0\n1\n")).directions_i3.tolist() == [[0, 0, 1]]


def test_three_by_three_is_rows_unless_only_columns_are_unit(tmp_path):
    unit = np.array([[0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])
    for name, table, expected in (("r", unit, unit), ("c", unit.T, unit), ("n", unit * 2, unit * 2)):
        np.savetxt(tmp_path / name, table)
        np.testing.assert_allclose(read_light_file(tmp_path / name).directions_i3, expected)
    both = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    np.savetxt(tmp_path / "b", both)
    np.testing.assert_array_equal(read_light_file(tmp_path / "b").directions_i3, both)
