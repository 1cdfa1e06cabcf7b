import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.lights import (
    count_duplicates,
    find_lights,
    length_note,
    natural_key,
    parse_subset,
    read_directions,
    read_lp,
    read_numbers,
    unit_directions,
)


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def touch_images(folder, *names):
    for name in names:
        write(folder / name, "")


def label(light):
    return f"light {light}"


def test_lp_names_may_contain_blanks(tmp_path):
    path = write(tmp_path / "a.lp", "\ufeff2\r\nmy lion 1.jpg  0 0.6\t0.8\r\n\r\n dir/b 2.jpg -1 0 1e-3 \r\n")
    names, directions = read_lp(path)
    assert names == ["my lion 1.jpg", "dir/b 2.jpg"]
    assert directions.tolist() == [[0, 0.6, 0.8], [-1, 0, 1e-3]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: expected the number of images"),
        ("a.jpg 0 0 1\n", "line 1: expected the number of images"),
        ("-1\n", "line 1: expected the number of images"),
        ("²\n", "line 1: expected the number of images"),
        ("0\n", "names no image"),
        ("1\n0 0 1\n", "line 2: expected an image name and x y z"),
        ("1\n\na.jpg 0 zero 1\n", "line 3: expected a number, got 'zero'"),
        ("3\na.jpg 0 0 1\nb.jpg 0 0 1\n", "announces 3 images on line 1, but 2 lines follow"),
        ("1\na.jpg 0 0 1\nb.jpg 0 0 1\n", "announces 1 images on line 1, but 2 lines follow"),
    ],
)
def test_lp_that_does_not_parse(tmp_path, text, message):
    path = write(tmp_path / "a.lp", text)
    with pytest.raises(InputError, match=message) as error:
        read_lp(path)
    assert str(path) in str(error.value)


def test_numbers_with_commas_and_comments(tmp_path):
    path = write(tmp_path / "d.txt", "# x y z\n1, 2,3\n\n 4\t5 6e-1 # last\n")
    assert read_numbers(path).tolist() == [[1, 2, 3], [4, 5, 0.6]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "holds no numbers"),
        ("1 2 3\n\n4 5\n", "line 3: expected 3 numbers, got 2"),
        ("1 2 3\n4 5 x\n", "line 2: expected a number, got 'x'"),
        ("1 2\n3 4\n", "2×2 numbers, expected N×3 or 3×N"),
    ],
)
def test_table_that_does_not_parse(tmp_path, text, message):
    path = write(tmp_path / "d.txt", text)
    with pytest.raises(InputError, match=message) as error:
        read_directions(path)
    assert str(path) in str(error.value)


def test_light_file_that_is_no_text(tmp_path):
    path = tmp_path / "d.txt"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no text file"):
        read_directions(path)


def test_table_is_read_by_rows_or_columns(tmp_path):
    rows = np.random.default_rng(1).normal(size=(5, 3))
    np.savetxt(tmp_path / "rows.txt", rows, fmt="%.17g")
    np.savetxt(tmp_path / "columns.txt", rows.T, fmt="%.17g", delimiter=",")
    np.testing.assert_array_equal(read_directions(tmp_path / "rows.txt"), rows)
    np.testing.assert_array_equal(read_directions(tmp_path / "columns.txt"), rows)
    assert read_directions(write(tmp_path / "one.txt", "0\n0\n1\n")).tolist() == [[0, 0, 1]]


def test_three_by_three_is_rows_unless_only_columns_are_unit(tmp_path):
    unit = np.array([[0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])
    for name, table, expected in (("r", unit, unit), ("c", unit.T, unit), ("n", unit * 2, unit * 2)):
        np.savetxt(tmp_path / name, table)
        np.testing.assert_allclose(read_directions(tmp_path / name), expected)
    both = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    np.savetxt(tmp_path / "b", both)
    np.testing.assert_array_equal(read_directions(tmp_path / "b"), both)


def test_natural_order():
    names = ["img10.png", "img9.png", "IMG2.png", "img2b.png", "1.png", "a1b02.png", "a1b1.png"]
    expected = ["1.png", "a1b1.png", "a1b02.png", "IMG2.png", "img2b.png", "img9.png", "img10.png"]
    assert sorted(names, key=natural_key) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:6:2", [0, 2, 4]),
        (":", list(range(10))),
        ("-2:", [8, 9]),
        ("::-4", [9, 5, 1]),
        ("3,1,-1", [3, 1, 9]),
        ("0:2, 5 ,8:100", [0, 1, 5, 8, 9]),
    ],
)
def test_subset(text, expected):
    assert parse_subset(text, 10) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected slices or indices"),
        ("1,,2", "expected slices or indices"),
        ("a", "expected slices or indices"),
        ("1.5", "expected slices or indices"),
        ("0:1:2:3", "expected slices or indices"),
        ("::0", "expected slices or indices"),
        ("10", "no light 10, only 0 to 9"),
        ("-11", "no light -11"),
        ("5:5", "chooses none of the 10 lights"),
        ("1:4,2", "chooses light 2 twice"),
    ],
)
def test_subset_that_is_wrong(text, message):
    with pytest.raises(InputError, match=message):
        parse_subset(text, 10)


def test_unit_directions():
    given = np.array([[0, 3, 4], [0, 0, 1e-200], [1e200, 0, 1e200], [1, 0, 0]])
    expected = [[0, 0.6, 0.8], [0, 0, 1], [0.5**0.5, 0, 0.5**0.5], [1, 0, 0]]
    np.testing.assert_allclose(unit_directions(given, label), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("direction", "message"),
    [
        ([0, 0, 0], "light 1 has direction 0 0 0"),
        ([0, np.nan, 1], "light 1 has direction 0 nan 1, expected finite"),
        ([np.inf, 0, 1], "light 1 has direction inf 0 1, expected finite"),
        ([1, 0, -1e-6], "light 1 is below the horizon: 1 0 -1e-06"),
    ],
)
def test_directions_that_are_none(direction, message):
    with pytest.raises(InputError, match=message):
        unit_directions(np.array([[0, 0, 1.0], direction]), label)


def test_lights_below_the_horizon_may_be_allowed():
    given = np.array([[0, 0, -2.0], [0, -3, -4], [0, 0, 1]])
    np.testing.assert_allclose(unit_directions(given, label, allow_below=True)[0], [0, 0, -1])
    with pytest.raises(InputError, match=r"light 0 \(and 1 more\) is below"):
        unit_directions(given, label)


def test_duplicates_and_lengths():
    z = np.array([0, 0, 1.0])
    x = np.array([1.0, 0, 0])
    assert count_duplicates(np.array([z, x, [5e-10, 0, 1], x, x])) == 3
    assert count_duplicates(np.array([z, x, [2e-9, 0, 1]])) == 0
    assert length_note(np.array([z, z * 1.009])) == []
    assert length_note(np.array([z, z * 1.02, z * 0.5]))[0].startswith(
        "2 directions were not of unit length (worst 0.5)"
    )


def test_lp_is_found_and_its_images_by_any_folder(tmp_path):
    lines = ["3", "jpg/a 1.jpg 0 0 1", r"C:\scans\b.jpg 1 0 0", "/home/me/c.jpg 0 1 0"]
    write(tmp_path / "dirs.LP", "\n".join(lines))
    touch_images(tmp_path, "jpg/a 1.jpg", "b.jpg", "c.jpg", "unrelated.png")
    table = find_lights(tmp_path)
    assert [str(p.relative_to(tmp_path)) for p in table.images] == ["jpg/a 1.jpg", "b.jpg", "c.jpg"]
    assert table.directions_i3.tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert "light 1 (b.jpg)" in table.label(1)


def test_lp_name_as_written_comes_before_its_base_name(tmp_path):
    write(tmp_path / "a.lp", "1\nsmall/a.jpg 0 0 1\n")
    touch_images(tmp_path, "a.jpg", "small/a.jpg")
    assert find_lights(tmp_path).images == (tmp_path / "small/a.jpg",)


def test_lp_that_does_not_fit_the_folder(tmp_path):
    write(tmp_path / "a.lp", "2\na.jpg 0 0 1\nb.jpg 0 0 1\n")
    touch_images(tmp_path, "a.jpg")
    with pytest.raises(InputError, match=r"no image .*b.jpg, which .*a.lp names for light 1"):
        find_lights(tmp_path)
    write(tmp_path / "a.lp", "2\nleft/a.jpg 0 0 1\nright/a.jpg 0 0 1\n")
    with pytest.raises(InputError, match=r"names image a.jpg for light 0 and for light 1"):
        find_lights(tmp_path)


def test_table_takes_all_images_in_natural_order(tmp_path):
    write(tmp_path / "light_directions.txt", "0 0 1\n0 1 1\n1 0 1\n1 1 1\n")
    touch_images(tmp_path, "i10.png", "i9.png", "i2.PNG", "i1.jpg", "mask.png", "._i1.png", "notes.txt")
    assert [p.name for p in find_lights(tmp_path).images] == ["i1.jpg", "i2.PNG", "i9.png", "i10.png"]
    other = write(tmp_path / "other" / "lights.csv", "0,0,1\n0,1,1\n")
    with pytest.raises(InputError, match=r"holds 4 images, but .*lights.csv 2 light directions"):
        find_lights(tmp_path, other)


def diligent(folder, names="2.png\n10.png\n1.png\n", intensities="1 2 3\n4 5 6\n7 8 9\n"):
    write(folder / "filenames.txt", names)
    write(folder / "light_directions.txt", "0 0 1\n0 1 1\n1 0 1\n")
    write(folder / "light_intensities.txt", intensities)
    touch_images(folder, "1.png", "2.png", "10.png", "Normal_gt.png", "mask.png")


def test_diligent_folder(tmp_path):
    diligent(tmp_path)
    write(tmp_path / "other.lp", "1\n1.png 0 0 1\n")
    for lights in (None, tmp_path / "light_directions.txt"):
        table = find_lights(tmp_path, lights)
        assert [p.name for p in table.images] == ["2.png", "10.png", "1.png"]
        assert table.intensities_ic.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
        assert table.mask == tmp_path / "mask.png"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"names": "1.png\n2.png\n"}, "filenames.txt names 2 images, but .* 3 light directions"),
        ({"intensities": "1 2 3\n4 5 6\n"}, "2×3 numbers, expected 3×3"),
        ({"intensities": "1 2 3\n4 0 6\n7 8 9\n"}, r"light 1 \(10.png\) has intensity 4 0 6"),
        ({"intensities": "1 2 3\n4 5 6\n7 nan 9\n"}, r"light 2 \(1.png\) has intensity 7 nan 9"),
    ],
)
def test_diligent_folder_that_does_not_fit(tmp_path, settings, message):
    diligent(tmp_path, **settings)
    with pytest.raises(InputError, match=message):
        find_lights(tmp_path)


def test_nothing_found(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        find_lights(tmp_path / "none")
    with pytest.raises(InputError, match=r"filenames.txt .*\.lp file.*light_directions.txt"):
        find_lights(tmp_path)
    with pytest.raises(InputError, match="no light file"):
        find_lights(tmp_path, tmp_path / "x.lp")
    touch_images(tmp_path, "a.lp", "b.lp")
    with pytest.raises(InputError, match=r"2 \.lp files \(a.lp, b.lp\)"):
        find_lights(tmp_path)
    with pytest.raises(InputError, match="no images"):
        find_lights(tmp_path, write(tmp_path / "d.txt", "0 0 1"))
