import numpy as np
import pytest

from clrelight.directions import count_duplicates, horizon_note, length_note, unit_directions
from clrelight.errors import InputError
from clrelight.lights import (
    find_lights,
    parse_subset,
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
        ([1, 0, -0.003], "light 1 is below the horizon: 1 0 -0.003; expected z >= 0, or --allow-below"),
        ([0, -1, -1], "light 1 is below the horizon"),
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


@pytest.mark.parametrize("count", [0, 1, 2, 60])
def test_duplicates_are_those_of_all_pairs(count):
    rng = np.random.default_rng(count)
    known = rng.standard_normal((count, 3)).round(1)  # some of which are alike already
    again = known[: count // 2] + rng.uniform(-2e-9, 2e-9, (count // 2, 3))
    lights = rng.permutation(np.concatenate([known, again]))
    pairs = (np.abs(lights[:, None] - lights) <= 1e-9).all(axis=2)
    assert count_duplicates(lights) == np.tril(pairs, -1).any(axis=1).sum()


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
    write(tmp_path / "a.lp", "3\na.jpg 0 0 1\nb.jpg 0 0 1\nc.jpg 0 0 1\n")
    with pytest.raises(InputError, match=r"b.jpg, which .* for light 1 \(line 3\); 2 of 3 images are missing"):
        find_lights(tmp_path)
    write(tmp_path / "a.lp", "2\nleft/a.jpg 0 0 1\nright/a.jpg 0 0 1\n")
    with pytest.raises(
        InputError, match=r"names image a.jpg as left/a.jpg and right/a.jpg for light 0 .*line 2.* light 1"
    ):
        find_lights(tmp_path)


def test_table_takes_all_images_in_natural_order(tmp_path):
    write(tmp_path / "light_directions.txt", "0 0 1\n0 1 1\n1 0 1\n1 1 1\n")
    touch_images(tmp_path, "i10.png", "i9.png", "i2.PNG", "i1.jpg", "mask.png", "._i1.png", "notes.txt")
    assert [p.name for p in find_lights(tmp_path).images] == ["i1.jpg", "i2.PNG", "i9.png", "i10.png"]
    other = write(tmp_path / "other" / "lights.csv", "0,0,1\n0,1,1\n")
    with pytest.raises(InputError, match=r"holds 4 images \(without mask.png\), but .*lights.csv 2 light directions"):
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
        ({"intensities": "1 2 3 4\n4 5 6 7\n7 8 9 10\n"}, "3×4 numbers, expected 3×3"),
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
    with pytest.raises(InputError, match="holds no files"):
        find_lights(tmp_path)
    (tmp_path / "note").touch()
    with pytest.raises(InputError, match=r"filenames.txt .*\.lp file.*light_directions.txt.*clrelight find-lights"):
        find_lights(tmp_path)
    with pytest.raises(InputError, match="no light file"):
        find_lights(tmp_path, tmp_path / "x.lp")
    touch_images(tmp_path, "a.lp", "b.lp")
    with pytest.raises(InputError, match=r"2 \.lp files \(a.lp, b.lp\): name one with --lights"):
        find_lights(tmp_path)
    (tmp_path / "a.lp").unlink()
    (tmp_path / "b.lp").unlink()
    touch_images(tmp_path, "lights.txt", "Directions.csv")
    with pytest.raises(InputError, match=r"2 tables of lights \(Directions.csv, lights.txt\): name one with --lights"):
        find_lights(tmp_path)
    with pytest.raises(InputError, match="no images"):
        find_lights(tmp_path, write(tmp_path / "d.txt", "0 0 1"))


def test_what_a_table_of_lights_may_be_called(tmp_path):
    touch_images(tmp_path, "1.png", "2.png", "buddha.mask.png")
    for name in ("lights.txt", "Lights.TXT", "directions.csv", "Light_Directions.txt"):
        table = write(tmp_path / name, "2\n0 0 1\n0.6 0 0.8\n")
        found = find_lights(tmp_path)
        assert found.directions_i3.tolist() == [[0, 0, 1], [0.6, 0, 0.8]]
        assert [path.name for path in found.images] == ["1.png", "2.png"]
        assert any("buddha.mask.png" in note for note in found.notes)
        assert found.label(1) == f"light 1 (2.png) of {table} line 3"
        table.unlink()


def test_directions_of_diligent_come_first(tmp_path):
    touch_images(tmp_path, "1.png")
    write(tmp_path / "lights.txt", "1 0 0\n")
    write(tmp_path / "light_directions.txt", "0 0 1\n")
    assert find_lights(tmp_path).directions_i3.tolist() == [[0, 0, 1]]


def test_table_that_names_images_takes_these(tmp_path):
    table = write(tmp_path / "dome.csv", "file,x,y,z\n3.png,0,0,1\n1.png,0.6,0,0.8\n")
    touch_images(tmp_path, "1.png", "2.png", "3.png")
    found = find_lights(tmp_path, table)
    assert [path.name for path in found.images] == ["3.png", "1.png"]
    assert found.directions_i3.tolist() == [[0, 0, 1], [0.6, 0, 0.8]]


def test_lp_that_lists_one_light_more_than_it_announces(tmp_path):
    write(tmp_path / "a.lp", "2\n1.png 0 0 1\n2.png 0.6 0 0.8\n3.png 0 0.6 0.8\n")
    touch_images(tmp_path, "1.png", "2.png")
    found = find_lights(tmp_path)  # the last image is not there either
    assert ([path.name for path in found.images], len(found.directions_i3)) == (["1.png", "2.png"], 2)
    assert found.notes == ("a.lp announces 2 lights, but lists 3; the first 2 were taken",)
    touch_images(tmp_path, "3.png")
    found = find_lights(tmp_path)
    assert found.directions_i3.tolist() == [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]]
    assert found.notes == ("a.lp announces 2 lights, but lists 3; all 3 were taken",)
    (tmp_path / "2.png").unlink()
    with pytest.raises(InputError, match=r"no image .*2.png"):
        find_lights(tmp_path)


def test_diligent_files_in_other_forms(tmp_path):
    diligent(tmp_path, names='3\r\n"2.png"\r\n10.png\r\n1.PNG\r\n', intensities="1,5 4 7\n2 5 8\n")
    with pytest.raises(InputError, match="2×3 numbers, expected 3×3"):
        find_lights(tmp_path)
    write(tmp_path / "light_intensities.txt", "r;g;b\n1,5;2;3\n4;5,25;6\n7;8;9\n")
    table = find_lights(tmp_path)
    assert [path.name for path in table.images] == ["2.png", "10.png", "1.png"]
    assert table.intensities_ic.tolist() == [[1.5, 2, 3], [4, 5.25, 6], [7, 8, 9]]


def test_intensities_with_a_light_in_each_column(tmp_path):
    write(tmp_path / "filenames.txt", "1.png\n2.png\n")
    write(tmp_path / "light_directions.txt", "0 0 1\n0 1 1\n")
    write(tmp_path / "light_intensities.txt", "1 2\n3 4\n5 6\n")
    touch_images(tmp_path, "1.png", "2.png")
    table = find_lights(tmp_path)
    assert table.intensities_ic.tolist() == [[1, 3, 5], [2, 4, 6]]
    assert "light_intensities.txt has one light a column" in table.notes


def test_lights_just_below_the_horizon_are_put_on_it():
    z = -np.sin(np.radians(0.1))
    given = np.array([[0, 0, 1.0], [3, -4, 5 * z], [1, 0, z * 1.01], [0.0, 0.0, 2.0]])
    unit = unit_directions(given, label)
    np.testing.assert_allclose(unit, [[0, 0, 1], [0.6, -0.8, 0], [1, 0, 0], [0, 0, 1]], atol=2e-6)
    assert (unit[:, 2] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1, atol=1e-15)
    assert horizon_note(given, label, False) == [
        "light 1 is 0.1° below the horizon and 1 more, at most 0.15°: taken to be at it"
    ]
    assert horizon_note(given[:1], label, False) == horizon_note(given, label, True) == []
    assert unit_directions(given, label, allow_below=True)[2, 2] < -1e-3


def test_lights_below_the_horizon_may_come_of_other_axes():
    rng = np.random.default_rng(3)
    up = np.abs(rng.normal(size=(9, 3)))
    signed = rng.choice([-1.0, 1.0], size=(9, 3)) * up
    signed[0] = up[0] * [1, 1, -1]
    for axis, number in ((0, "first"), (1, "second")):
        swapped = signed.copy()
        swapped[:, axis] = up[:, axis]
        swapped[:4, 1 - axis] *= [1, -1, 1, -1]
        swapped[:4, 2] = -up[:4, 2]
        with pytest.raises(InputError, match=f"the {number} number is never negative: is z written there"):
            unit_directions(swapped, label)
    with pytest.raises(InputError, match="does z point away from the camera"):
        unit_directions(np.column_stack([signed[:, :2], -up[:, 2]]), label)
