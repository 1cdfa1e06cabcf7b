import os
import unicodedata

import pytest

from clrelight.errors import InputError
from clrelight.image_names import list_photographs, natural_key, resolve_names


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


def resolve(folder, *names):
    images, notes = resolve_names(folder, names, "a.lp", lambda light: f"light {light}")
    return [str(path.relative_to(folder)) for path in images], notes


def photographs(folder, count):
    images, notes = list_photographs(folder, count, "t.txt")
    return [path.name for path in images], notes


def test_natural_order():
    names = ["img10.png", "img9.png", "IMG2.png", "img2b.png", "1.png", "a1b02.png", "a1b1.png"]
    expected = ["1.png", "a1b1.png", "a1b02.png", "IMG2.png", "img2b.png", "img9.png", "img10.png"]
    assert sorted(names, key=natural_key) == expected


def test_names_in_another_case(tmp_path):
    touch(tmp_path, "Lion1.JPG", "lion2.jpg", "jpg/Lion3.jpg")
    assert resolve(tmp_path, "Lion1.JPG", "lion2.jpg") == (["Lion1.JPG", "lion2.jpg"], [])
    found, notes = resolve(
        tmp_path,
        "lion1.jpg",
        "LION2.JPG",
        "jpg/lion3.jpg",
    )
    assert found == ["Lion1.JPG", "lion2.jpg", "jpg/Lion3.jpg"]
    assert notes == ["3 names differ in case or accents from the files: lion1.jpg is Lion1.JPG"]
    assert resolve(tmp_path, "LION2.jpg")[1] == [
        "1 name differs in case or accents from the files: LION2.jpg is lion2.jpg"
    ]


@pytest.mark.parametrize("written", ["NFC", "NFD"])
@pytest.mark.parametrize("kept", ["NFC", "NFD"])
def test_accents_in_either_form(tmp_path, written, kept):
    name = unicodedata.normalize(kept, "schädel é.png")
    touch(tmp_path, name)
    assert resolve(tmp_path, unicodedata.normalize(written, "schädel é.png"))[0] == [name]


@pytest.mark.skipif(os.name == "nt", reason="names are no bytes there")
def test_file_whose_name_is_no_utf8(tmp_path):
    name = os.fsdecode("schädel.png".encode("latin-1"))
    touch(tmp_path, name)
    assert resolve(tmp_path, "schädel.png")[0] == [name]


def test_names_with_another_extension(tmp_path):
    touch(tmp_path, "a1.tif", "a2.TIF", "a2.txt", "scan 3.png")
    found, notes = resolve(tmp_path, "jpeg-exports/a1.jpg", "a2.jpg", "scan 3")
    assert found == ["a1.tif", "a2.TIF", "scan 3.png"]
    assert notes == ["3 names differ in extension from the files: jpeg-exports/a1.jpg is a1.tif"]
    touch(tmp_path, "a1.png")
    with pytest.raises(InputError, match=r"no image .*a1.jpg, and both a1.png and a1.tif could be meant"):
        resolve(tmp_path, "a1.jpg")


def test_names_that_could_be_two_files(tmp_path):
    touch(tmp_path, "A.png", "a.png")
    if len(list(tmp_path.iterdir())) < 2:
        pytest.skip("this file system knows no case")
    assert resolve(tmp_path, "A.png", "a.png")[0] == ["A.png", "a.png"]
    with pytest.raises(InputError, match=r"both A.png and a.png could be meant"):
        resolve(tmp_path, "A.PNG")


def test_names_with_a_number_before_each(tmp_path):
    touch(tmp_path, "a.png", "b.png", "1 a.png", "2 b.png")
    assert resolve(tmp_path, "1 a.png", "2 b.png")[0] == ["1 a.png", "2 b.png"]
    assert resolve(tmp_path, "0 a.png", "1 b.png")[0] == ["a.png", "b.png"]
    assert resolve(tmp_path, '0,"a.png"', '1,"b.png"')[0] == ["a.png", "b.png"]
    with pytest.raises(InputError, match=r"no image .*3 a.png"):
        resolve(tmp_path, "3 a.png", "5 b.png")


def test_one_file_under_two_names(tmp_path):
    touch(tmp_path, "a.png")
    (tmp_path / "b.png").symlink_to("a.png")
    os.link(tmp_path / "a.png", tmp_path / "c.png")
    for second in ("A.png", "b.png", "c.png", "x/a.png", "a.jpg"):
        with pytest.raises(InputError, match=r"as a.png and .* for light 0 and for light 1"):
            resolve(tmp_path, "a.png", second)
    with pytest.raises(InputError, match=r"names image a.png for light 0 and for light 1"):
        resolve(tmp_path, "a.png", "a.png")


def test_names_that_no_file_can_have(tmp_path):
    for name in ("a" * 5000 + ".png", "..", "/", "nowhere/../../x.png"):
        with pytest.raises(InputError, match="no image"):
            resolve(tmp_path, name)


def test_masks_and_normals_are_no_photographs(tmp_path):
    touch(tmp_path, "b.0.png", "b.1.png", "b.mask.png", "Normals.png", "depth-map.tif", "mask2.png", ".b.2.png")
    found, notes = photographs(tmp_path, 2)
    assert found == ["b.0.png", "b.1.png"]
    assert notes[1] == "left out of the images: b.mask.png, depth-map.tif, mask2.png, Normals.png"
    with pytest.raises(InputError, match=r"holds 2 images \(without b.mask.png.*\), but t.txt 3 light directions"):
        photographs(tmp_path, 3)


def test_photographs_of_a_mask(tmp_path):
    touch(tmp_path, "mask_1.jpg", "mask_2.jpg", "mask_10.jpg", "mask.png")
    assert photographs(tmp_path, 3)[0] == ["mask_1.jpg", "mask_2.jpg", "mask_10.jpg"]


def test_the_one_series_that_fits_is_taken(tmp_path):
    touch(tmp_path, "001.png", "002.png", "003.png", "cover.png")
    found, notes = photographs(tmp_path, 3)
    assert found == ["001.png", "002.png", "003.png"]
    assert notes == ["images in the order of their names, 001.png to 003.png", "left out of the images: cover.png"]
    found, notes = photographs(tmp_path, 4)
    assert found[-1] == "cover.png"
    assert notes[1] == "taken as photographs although named otherwise than 001.png: cover.png"
    touch(tmp_path, "001.jpg", "002.jpg", "003.jpg")
    with pytest.raises(InputError, match=r"holds 7 images, but t.txt 3 light directions"):
        photographs(tmp_path, 3)


def test_images_in_a_folder_within_are_told(tmp_path):
    """RTIBuilder's projects keep photographs in a folder beside the light file's."""
    touch(tmp_path, "assembly/x.jpg", "exports/a.jpg", "exports/b.jpg")
    with pytest.raises(InputError, match=r"missing; .*exports holds it: give that folder, and --lights"):
        resolve(tmp_path, "C:\\old\\a.jpg", "C:\\old\\b.jpg")
    with pytest.raises(InputError, match=r"2 of 2 images are missing$"):
        resolve(tmp_path, "c.jpg", "b.jpg")
