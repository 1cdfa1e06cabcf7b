"""Bad input: one line that says what is wrong, exit code 2, nothing written, nothing lost."""

import numpy as np
import pytest

from clrelight.dataset import FitRecord, LightStack
from clrelight.images import write_image
from clrelight.sampling import make_pattern
from clrelight.store import create_fit, write_stack
from tests.commands import arrays, call, contents, succeed

DIRECTIONS = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8], [0, 0.8, 0.6], [-0.8, 0, 0.6]])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with one file of each kind, and spoilt ones."""
    folder = tmp_path_factory.mktemp("made")
    succeed("synth", "ring", folder / "stack.h5", "--size", 16, "--lights", 36)
    succeed("synth", "ring", folder / "large.h5", "--size", 24, "--lights", 36)
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", 3)
    succeed("encode", folder / "fit.h5", folder / "enc.h5", "--codec", "half")
    succeed("bench", folder / "stack.h5", "--methods", "cls", "--codecs", "none", "--out", folder / "results.h5")
    whole = (folder / "stack.h5").read_bytes()
    (folder / "cut.h5").write_bytes(whole[: len(whole) // 2])
    spoilt = bytearray(whole)
    spoilt[len(spoilt) // 2] ^= 1
    (folder / "spoilt.h5").write_bytes(spoilt)
    (folder / "text.h5").write_text("not HDF5")
    (folder / "empty.h5").touch()
    (folder / "lights.lp").write_text("1\na.png 0 0 1\n")
    (folder / "zero.txt").write_text("0 0 1\n0 0 0\n")
    (folder / "folder").mkdir()
    large = np.zeros((16, 16, 16, 3), np.float32)
    large[1, 2, 3, 0] = 1e6
    infinite = large.copy()
    infinite[1, 2, 3, 0] = np.inf
    for name, coeffs in (("overflow.h5", large), ("infinite.h5", infinite)):
        about = {"method": "uls", "peak": 1.0, "transfer": "linear", "directions_i3": DIRECTIONS, "name": "x"}
        with create_fit(folder / name, FitRecord(3, config={}, **about), (16, 16, 3)) as sink:
            sink.coeffs_khwc[:] = coeffs
    return folder


def refuse(arguments, made, tmp_path, out, expected):
    """Run a command that must be refused, once with nothing at its output and once with an old file there."""
    words = [str(tmp_path / word[1:]) if word.startswith("@") else word for word in arguments]
    words = [str(made / word) if (made / word).exists() and word != "ring" else word for word in words]
    before = contents(made)
    for old in (None, b"precious"):
        if old is not None and out:
            (tmp_path / out).write_bytes(old)
        files = contents(tmp_path)
        ended = call(*words)
        assert (ended.code, ended.out) == (2, ""), ended.err
        assert ended.err.startswith("clrelight")
        assert ended.err.count("\n") == 1
        assert expected in ended.err
        assert contents(tmp_path) == files
    assert contents(made) == before


FITS = [
    ("nowhere.h5 @o.h5", "there is no file nowhere.h5"),
    ("text.h5 @o.h5", "text.h5 is not an HDF5 file"),
    ("empty.h5 @o.h5", "is empty, expected an HDF5 file"),
    ("cut.h5 @o.h5", "cut.h5 is cut short"),
    ("spoilt.h5 @o.h5", "spoilt.h5"),
    ("folder @o.h5", "folder is no regular file, but a folder"),
    ("fit.h5 @o.h5", "it is a fit/1 file, expected stack/1"),
    ("enc.h5 @o.h5", "it is an encoded/4 file, expected stack/1"),
    ("stack.h5 @no/o.h5", "there is no folder"),
    ("stack.h5 folder", "it is there and is no regular file"),
    ("stack.h5 stack.h5", "that is the input"),
    ("stack.h5 @o.h5 --degree -1", "0 to 100, got -1"),
    ("stack.h5 @o.h5 --degree 101", "0 to 100, got 101"),
    ("stack.h5 @o.h5 --degree 1000000000000000000000", "0 to 100, got 1000000000000000000000"),
    ("stack.h5 @o.h5 --degree six", "'six' is not a whole number or auto"),
    ("stack.h5 @o.h5 --degree 100 --memory 1M", "more than the memory budget 1000000"),
    ("stack.h5 @o.h5 --method uls", "49 coefficients but there are 36 lights: degree 5 is the largest that fits"),
    ("stack.h5 @o.h5 --method sloan --degree 6", "degree 5 is the largest that fits"),
    ("stack.h5 @o.h5 --method best", "unknown method 'best'; known are auto, project, uls, sloan, cls"),
    ("stack.h5 @o.h5 --method uls --degree 3 --energy 2", "method uls has no option 'energy'; it has: none"),
    ("stack.h5 @o.h5 --method ceb --iterations 8", "method ceb has no option 'iterations'; it has: energy"),
    ("stack.h5 @o.h5 --method auto --energy 1", "auto chooses the options too"),
    ("stack.h5 @o.h5 --energy nan", "positive factor on E_c, got nan"),
    ("stack.h5 @o.h5 --energy -1", "positive factor on E_c, got -1"),
    ("stack.h5 @o.h5 --iterations 0", "got 0"),
    ("stack.h5 @o.h5 --solver magic", "bisection, newton, paper, got 'magic'"),
    ("stack.h5 @o.h5 --method project --fill ones", "zero or mirror, got 'ones'"),
    ("stack.h5 @o.h5 --weights heavy", "uniform, solid-angle, got 'heavy'"),
    ("stack.h5 @o.h5 --sampling poor", "hemisphere, scattered, got 'poor'"),
    ("stack.h5 @o.h5 --holdout 1", "--holdout"),
    ("stack.h5 @o.h5 --holdout 37", "keeps no light out of 36"),
    ("stack.h5 @o.h5 --holdout 1000000000000000000000000", "--holdout"),
    ("stack.h5 @o.h5 --memory much", "'much' is not a number of bytes such as 1GiB"),
    ("stack.h5 @o.h5 --memory 0", "is not a number of bytes"),
    ("stack.h5 @o.h5 --memory 1e999", "is not a number of bytes"),
    ("stack.h5 @o.h5 --memory 10", "more than the memory budget 10"),
    ("stack.h5 @o.h5 --device warp", "no OpenCL device matches 'warp'; there are 0: "),
    ("stack.h5 @o.h5 --device 99", "no OpenCL device matches '99'"),
    ("stack.h5", "Missing argument 'OUT'; it is clrelight fit [OPTIONS] STACK OUT (see clrelight fit --help)"),
    ("stack.h5 @o.h5 --method csl", "(did you mean 'cls'?)"),
    ("stack.h5 @o.h5 --method auot", "known are auto, "),
    ("stack.h5 @o.h5 --depth 3", "No such option '--depth'"),
]
ENCODES = [
    ("nowhere.h5 @o.h5", "there is no file nowhere.h5"),
    ("stack.h5 @o.h5", "it is a stack/1 file, expected fit/1"),
    ("fit.h5 fit.h5", "that is the input"),
    ("fit.h5 stack.h5 --stack stack.h5", "that is the input"),
    ("fit.h5 @no/o.h5", "there is no folder"),
    ("fit.h5 @o.h5 --codec zip", "unknown codec 'zip'; known are bc6h"),
    ("fit.h5 @o.h5 --codec uniform --bits 0", "integer from 1 to 16, got 0"),
    ("fit.h5 @o.h5 --codec uniform --bits 99", "integer from 1 to 16, got 99"),
    ("fit.h5 @o.h5 --codec wavelet --rate 0", "got 0"),
    ("fit.h5 @o.h5 --codec wavelet --rate -1", "got -1"),
    ("fit.h5 @o.h5 --codec wavelet --rate nan", "got nan"),
    ("fit.h5 @o.h5 --codec wavelet --rate 1e-9", "too few"),
    ("fit.h5 @o.h5 --codec wavelet --allocation fair", "map, global, got 'fair'"),
    ("fit.h5 @o.h5 --codec half --bits 8", "codec half has no option 'bits'; it has: clamp"),
    ("fit.h5 @o.h5 --codec s3tc --clamp", "codec s3tc has no option 'clamp'; it has: none"),
    (
        "fit.h5 @o.h5 --codec s3tc --bytes 5k",
        "--bytes: what s3tc takes follows from its options; klt, wavelet and jpeg2000 meet a size",
    ),
    ("fit.h5 @o.h5 --bytes 5k --rate 2", "--bytes says the size already"),
    ("fit.h5 @o.h5 --basis klt --codec whitened", "choose another inside principal"),
    ("fit.h5 @o.h5 --basis whitened --codec whitened", "choose another inside whitened"),
    ("fit.h5 @o.h5 --target-psnr 20", "--target-psnr needs --stack"),
    ("fit.h5 @o.h5 --target-psnr 20", "--target-psnr needs --stack"),
    ("fit.h5 @o.h5 --target-psnr 20 --rate 3 --stack stack.h5", "--target-psnr says the size already"),
    ("fit.h5 @o.h5 --target-psnr nan --stack stack.h5", "got nan"),
    ("fit.h5 @o.h5 --target-psnr 99 --stack stack.h5", "the target is 99 dB"),
    ("fit.h5 @o.h5 --codec vq --target-psnr 9 --stack stack.h5", "a quality can be asked of klt and wavelet"),
    ("fit.h5 @o.h5 --stack nowhere.h5", "there is no file nowhere.h5"),
    ("fit.h5 @o.h5 --stack large.h5", "the coefficients are of images (16, 16, 3) but the stack has (24, 24, 3)"),
    ("overflow.h5 @o.h5 --codec half", "(k, row, column, channel) = (1, 2, 3, 0) is 1e+06"),
    ("infinite.h5 @o.h5 --codec uniform", "(k, row, column, channel) = (1, 2, 3, 0) is inf"),
]
RELIGHTS = [
    ("fit.h5 @o.png", "give the light by --light X,Y,Z or by --lights FILE"),
    ("fit.h5 @o.png --light 0,0,1 --lights lights.lp", "give the light by"),
    ("fit.h5 @o.png --light 0,0,0", "light 0 has direction 0 0 0, expected a vector towards the light"),
    ("fit.h5 @o%d.png --lights zero.txt", "line 2 has direction 0 0 0, expected a vector"),
    ("fit.h5 @o.png --light nan,0,1", "expected 3 numbers separated by commas, such as X,Y,Z, got 'nan,0,1'"),
    ("fit.h5 @o.png --light 0,1", "expected 3 numbers"),
    ("fit.h5 @o.png --light a,b,c", "expected 3 numbers"),
    ("fit.h5 @o.png --light 0,0,1 --light 1,0,1", "2 images need a number field in their name, such as relit%03d.png"),
    ("fit.h5 @o.png --light 0,0,1 --exposure nan", "exposure must be a number of stops from -64 to 64, got nan"),
    ("fit.h5 @o.png --light 0,0,1 --exposure 1e9", "exposure must be"),
    ("fit.h5 @o.exr --light 0,0,1 --transfer srgb", "--transfer is for 8-bit files"),
    ("fit.h5 @o.png --light 0,0,1 --transfer film", "'film' is not one of"),
    ("fit.h5 @o.mp4 --light 0,0,1", "extension '.mp4' is none of .exr"),
    ("fit.h5 @no/o.png --light 0,0,1", "there is no folder"),
    ("fit.h5 fit.h5 --light 0,0,1", "that is the input"),
    ("fit.h5 lights.lp --lights lights.lp", "that is the input"),
    ("fit.h5 @o.png --lights nowhere.txt", "nowhere.txt"),
    ("fit.h5 @o.png --lights folder", "Is a directory"),
    ("fit.h5 @o.png --lights stack.h5", "is no text file"),
    ("stack.h5 @o.png --light 0,0,1", "it is a stack/1 file, expected fit/1"),
    ("infinite.h5 @o.png --light 0,0,1", "coefficient 1 at row 2, column 3, channel 0 is inf"),
]
OTHERS = [
    ("decode fit.h5 @o.h5", "it is a fit/1 file, expected encoded/4"),
    ("decode enc.h5 enc.h5", "that is the input"),
    ("decode nowhere.h5 @o.h5", "there is no file nowhere.h5"),
    ("psnr stack.h5 stack.h5", "it is a stack/1 file, expected fit/1"),
    ("psnr fit.h5 fit.h5", "it is a fit/1 file, expected stack/1"),
    ("psnr fit.h5 large.h5", "but the stack has (24, 24, 3)"),
    ("psnr infinite.h5 stack.h5", "channel 0 is inf"),
    ("info nowhere.h5", "there is no file nowhere.h5"),
    ("info text.h5", "is not an HDF5 file"),
    ("info cut.h5", "is cut short"),
    ("report nowhere.h5 --out @o", "there is no file nowhere.h5"),
    ("report fit.h5 --out @o", "it is a fit/1 file, expected results/1"),
    ("report results.h5 --out stack.h5", "is a file; give a folder"),
    ("report results.h5 --out results.h5", "is a file; give a folder"),
    ("synth ring @o.h5 --size 4", "4 is not in the range"),
    ("synth ring @o.h5 --size 10000000000000000000000000", "is not in the range"),
    ("synth ring @o.h5 --lights 0", "0 is not in the range"),
    ("synth ring @o.h5 --lights 17 --pattern grid", "17"),
    ("synth ring @o.h5 --seed -1", "-1 is not in the range"),
    ("synth ring @no/o.h5 --size 16", "there is no folder"),
    ("synth square @o.h5", "No such command 'square'"),
    ("bench nowhere.h5 --out @o.h5", "there is no file nowhere.h5"),
    ("bench nowhere.toml --out @o.h5", "there is no file nowhere.toml"),
    ("bench fit.h5 --out @o.h5 --force", "it is a fit/1 file, expected stack/1"),
    ("bench cut.h5 --out @o.h5 --force", "cut.h5 is cut short"),
    ("bench ring --size 16 --lights 9 --codecs none --out stack.h5", "it is a stack/1 file, expected results/1"),
    ("bench stack.h5 --codecs none --out stack.h5 --force", "that is the input"),
    ("bench large.h5 --codecs none --out results.h5", "another stack that is named 'ring' too"),
    ("bench stack.h5 --out @no/o.h5", "there is no folder"),
    ("bench stack.h5 --out @o.h5 --methods uls,magic", "unknown method 'magic'"),
    ("bench stack.h5 --out @o.h5 --codecs none,zip", "unknown codec 'zip'"),
    ("bench stack.h5 --out @o.h5 --methods cls,cls", "twice"),
    ("bench stack.h5 --out @o.h5 --codecs none,none", "twice"),
    ("bench stack.h5 --out @o.h5 --methods ,", "one or more names"),
    ("bench stack.h5 --out @o.h5 --degrees 4,101", "degrees must be auto or 0 to 100, got 101"),
    ("bench stack.h5 --out @o.h5 --degrees 4.5", "whole numbers"),
    ("bench stack.h5 --out @o.h5 --degrees 99999999999999999999", "whole numbers"),
    ("bench stack.h5 --out @o.h5 --codecs none --rates 1", "rates are for codecs that take one"),
    ("bench stack.h5 --out @o.h5 --codecs wavelet --rates 0", "got 0"),
    ("bench stack.h5 --out @o.h5 --codecs wavelet --rates nan", "numbers"),
    ("bench stack.h5 --out @o.h5 --holdout 37 --force", "keeps no light out of 36"),
    ("bench stack.h5 --out @o.h5 --size 16", "--size is an option of the scenes ring, torus, dama, head, not of"),
    ("bench ring --out @o.h5 --pattern spiral --force", "pattern must be one of"),
    ("devices --device gpu", "No such option '--device'"),
    ("dance", "No such command 'dance'"),
]
CASES = [(f"fit {words}", expected) for words, expected in FITS]
CASES += [(f"encode {words}", expected) for words, expected in ENCODES]
CASES += [(f"relight {words}", expected) for words, expected in RELIGHTS] + OTHERS


@pytest.mark.parametrize(("words", "expected"), CASES, ids=[words for words, _ in CASES])
def test_refused(made, tmp_path, words, expected):
    out = next((word[1:] for word in words.split() if word.startswith("@") and "/" not in word and "." in word), None)
    refuse(words.split(), made, tmp_path, out if words.split()[0] != "bench" or "--force" in words else None, expected)


def test_out_of_memory(tmp_path, monkeypatch):
    def render_ring(**options):
        raise MemoryError("Unable to allocate 698 TiB")

    monkeypatch.setattr("datasets_synth.ring.render_ring", render_ring)
    ended = call("synth", "ring", tmp_path / "o.h5")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "out of memory (Unable to allocate 698 TiB)" in ended.err
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("link", ["hard", "soft"])
def test_an_input_by_another_name_is_refused(made, tmp_path, link):
    if link == "hard":
        (tmp_path / "other.h5").hardlink_to(made / "stack.h5")
    else:
        (tmp_path / "other.h5").symlink_to(made / "stack.h5")
    before = contents(made)
    ended = call("fit", made / "stack.h5", tmp_path / "other.h5", "--degree", 2)
    assert ended.code == 2
    assert contents(made) == before


def test_constrained_fits_go_on_with_few_lights(made, tmp_path):
    for method in ("cls", "ceb"):
        ended = call("fit", made / "stack.h5", tmp_path / "o.h5", "--method", method, "--degree", 6)
        assert ended.code == 0
        assert "note: 36 lights for 49 coefficients" in ended.err
        assert np.isfinite(arrays(tmp_path / "o.h5")["coefficients"]).all()


def test_half_clamps_where_asked(made, tmp_path):
    ended = call("encode", made / "overflow.h5", tmp_path / "o.h5", "--codec", "half", "--clamp")
    assert (ended.code, ended.err) == (0, "note: 1 coefficient was clamped\n")


def float_stack(path, mask=None):
    directions = make_pattern("uniform", 20)
    images = np.full((20, 6, 5, 3), 0.25, np.float32)
    write_stack(path, LightStack(images, directions, 1.0, mask_hw=mask))
    return images


@pytest.mark.parametrize(("light", "holdout"), [(3, None), (3, 4), (7, None), (7, 2)])
@pytest.mark.parametrize(("value", "shown"), [(np.nan, "nan"), (np.inf, "inf"), (-0.5, "-0.5")])
def test_bad_radiance_is_named_wherever_it_is(tmp_path, light, holdout, value, shown):
    """Also in a light that is held out, which only measuring sees."""
    path = tmp_path / "s.h5"
    images = float_stack(path)
    images[light, 4, 2, 1] = value
    write_stack(path, LightStack(images, make_pattern("uniform", 20), 1.0))
    options = [] if holdout is None else ["--holdout", holdout]
    (tmp_path / "o.h5").write_bytes(b"precious")
    before = contents(tmp_path)
    for words in (["fit", path, tmp_path / "o.h5"], ["bench", path, "--out", tmp_path / "o.h5", "--force"]):
        ended = call(*words, *options)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert f"is {shown} at row 4, column 2, channel 1" in ended.err
        assert contents(tmp_path) == before


def test_mask_without_a_pixel(tmp_path):
    float_stack(tmp_path / "s.h5", np.zeros((6, 5), bool))
    before = contents(tmp_path)
    ended = call("fit", tmp_path / "s.h5", tmp_path / "o.h5", "--degree", 2)
    assert ended.code == 2
    assert "the mask leaves no pixel" in ended.err
    assert contents(tmp_path) == before


def test_black_pixels_have_coefficients_zero(tmp_path):
    images = float_stack(tmp_path / "s.h5")
    images[:, 2, 3] = 0
    write_stack(tmp_path / "s.h5", LightStack(images, make_pattern("uniform", 20), 1.0))
    for method in ("uls", "cls", "ceb"):
        succeed("fit", tmp_path / "s.h5", tmp_path / "o.h5", "--method", method, "--degree", 3)
        held = arrays(tmp_path / "o.h5")["coefficients"]
        assert (held[:, 2, 3] == 0).all()
        assert np.isfinite(held).all()
        assert np.abs(held[0, 0, 0]).min() > 0.1


def photographs(folder, directions=DIRECTIONS):
    folder.mkdir()
    lines = [str(len(directions))]
    for i, direction in enumerate(directions):
        write_image(folder / f"{i}.png", np.full((6, 5, 3), 40 * i + 9, np.uint8))
        lines.append(f"{i}.png " + " ".join(map(str, direction)))
    (folder / "dirs.lp").write_text("\n".join(lines))
    return folder


def ruin(folder, what):
    lines = (folder / "dirs.lp").read_text().splitlines()
    match what:
        case "missing":
            (folder / "3.png").unlink()
        case "unreadable":
            (folder / "3.png").write_bytes(b"\x89PNG\r\n\x1a\njunk")
        case "size":
            write_image(folder / "3.png", np.ones((6, 4, 3), np.uint8))
        case "channels":
            write_image(folder / "3.png", np.ones((6, 5, 1), np.uint8))
        case "fewer":
            (folder / "dirs.lp").write_text("\n".join(lines[:-2]))
        case "zero":
            lines[4] = "3.png 0 0 0"
        case "nan":
            lines[4] = "3.png nan 0 1"
        case "below":
            lines[4] = "3.png 0.6 0 -0.8"
        case "words":
            lines[4] = "3.png up"
        case "none":
            (folder / "dirs.lp").unlink()
    if what in ("zero", "nan", "below", "words"):
        (folder / "dirs.lp").write_text("\n".join(lines))


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("missing", "3.png"),
        ("unreadable", "3.png"),
        ("size", "3.png has pixels 4×6, but 0.png 5×6"),
        ("channels", "3.png has channels 1, but 0.png 3"),
        ("fewer", "dirs.lp announces 5 lights, but lists 3"),
        ("zero", "light 3 (3.png)"),
        ("nan", "light 3 (3.png)"),
        ("below", "is below the horizon: 0.6 0 -0.8; expected z >= 0, or --allow-below"),
        ("words", "dirs.lp line 5: expected an image name and x y z"),
        ("none", "name a light file"),
    ],
)
def test_ingest_refuses(tmp_path, what, expected):
    folder = photographs(tmp_path / "photos")
    ruin(folder, what)
    (tmp_path / "o.h5").write_bytes(b"precious")
    before = contents(tmp_path)
    for out in ("o.h5", "new.h5"):
        ended = call("ingest", folder, tmp_path / out)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert expected in ended.err
        assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--crop", "0,0,9,9"], "crop x=0 y=0 width=9 height=9"),
        (["--crop", "0,0,9"], "expected 4 whole numbers"),
        (["--crop", "0,0,99999999999999999999,1"], "expected 4 whole numbers"),
        (["--peak", "0"], "peak must be a positive number"),
        (["--peak", "nan"], "peak must be a positive number"),
        (["--subset", "9"], "no light 9"),
        (["--mask", "nowhere.png"], "nowhere.png"),
        (["--lights", "nowhere.lp"], "there is no light file nowhere.lp"),
        (["--transfer", "film"], "'film' is not one of"),
        (["--memory", "10"], "cannot hold 1 row"),
    ],
)
def test_ingest_refuses_options(tmp_path, options, expected):
    folder = photographs(tmp_path / "photos")
    ended = call("ingest", folder, tmp_path / "o.h5", *options)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert expected in ended.err
    assert {path.name for path in tmp_path.iterdir()} == {"photos"}


def test_ingest_does_not_write_over_what_it_reads(tmp_path):
    folder = photographs(tmp_path / "photos")
    before = contents(tmp_path)
    for name in ("dirs.lp", "2.png"):
        ended = call("ingest", folder, folder / name)
        assert ended.code == 2
        assert "that is the input" in ended.err
        assert contents(tmp_path) == before


def test_lights_below_the_horizon_where_allowed(tmp_path):
    folder = photographs(tmp_path / "photos")
    ruin(folder, "below")
    told = succeed("ingest", folder, tmp_path / "s.h5", "--allow-below", "--json").json
    assert told["below_horizon"] == 1
    succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 1)


def test_duplicate_directions_are_reported(tmp_path):
    folder = photographs(tmp_path / "photos", DIRECTIONS[[0, 1, 2, 1, 0]])
    told = succeed("ingest", folder, tmp_path / "s.h5", "--json").json
    assert told["duplicates"] == 2
    assert "duplicates  2" in succeed("ingest", folder, tmp_path / "s.h5").out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("fit a.h5 b.h5 --degree", "clrelight fit: Option '--degree' requires an argument (see clrelight fit --help)"),
        (
            "shrm build --brdf",
            "clrelight shrm build: Option '--brdf' requires an argument (see clrelight shrm build --help)",
        ),
        (
            "fit a.h5 b.h5 --methud cls",
            "clrelight fit: No such option '--methud'. Did you mean '--method'? (see clrelight fit --help)",
        ),
    ],
)
def test_options_that_are_mistyped(words, line):
    ended = call(*words.split())
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.replace("(Did", "Did").replace("?)", "?") == line + "\n"
