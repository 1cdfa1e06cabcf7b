"""Commands of reflection maps: what they write, print and refuse."""

import numpy as np
import pytest

from clrelight.brdf.analytic import Microfacet
from clrelight.errors import StoreFormatError
from clrelight.images import read_header, read_image, write_image
from clrelight.jobs.reflection.bench import cost_slopes, frame_rates, prefilter_shares, time_microfacets, time_phong
from clrelight.jobs.reflection.build import build_reflection
from clrelight.jobs.reflection.codecs import code_maps, principal_shares
from clrelight.jobs.reflection.peers import compare_peers
from clrelight.jobs.reflection.render import render_reflection
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.shrm.lookup import render_sphere, view_sphere
from clrelight.store import read_shrm, write_light, write_shrm
from tests.commands import attributes, call, succeed
from tests.meshes import icosphere
from tests.test_brdf_measured import lines


def obj_text(surface):
    rows = [("v", surface.vertices_v3), ("vn", surface.normals_v3)]
    lines = [f"{word} {x:.9g} {y:.9g} {z:.9g}" for word, points in rows for x, y, z in points]
    return "\n".join([*lines, *("f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in surface.faces_f3)])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reflection")
    rng = np.random.default_rng(0)
    radiance = rng.random((48, 96, 3), np.float32)
    radiance[10:14, 20:24] = 60.0  # a sun
    write_image(folder / "map.exr", radiance)
    write_image(folder / "small.exr", radiance[:8, :16])
    write_light(folder / "light.h5", Light(rng.standard_normal((49, 3)), "noise"))
    (folder / "paint.brdf").write_text("\n".join(lines()) + "\n")
    (folder / "bad.brdf").write_text("no paint\n")
    (folder / "ball.obj").write_text(obj_text(icosphere(3)))
    succeed("shrm", "build", folder / "map.exr", folder / "glossy.h5", "--sigma", 0.3)
    succeed("shrm", "build", folder / "map.exr", folder / "local.h5", "--sigma", 0.3, "--frame", "local")
    return folder


def test_build_writes_what_it_prints(made, tmp_path):
    out = tmp_path / "o.h5"
    told = succeed("shrm", "build", made / "map.exr", out, "--sigma", 0.3, "--epsilon", 0.03, "--json").json
    held = read_shrm(out)
    assert (told["degree"], told["order"]) == (held.degree, held.order) == (7, 2)
    assert held.maps_khwc.shape == (9, told["rows"], told["columns"], 3) == (9, 70, 140, 3)
    assert held.maps_khwc.dtype == np.float32
    assert told["share"] >= 0.97
    assert told["seconds"].keys() == {"read", "reflectance", "project", "prefilter", "write"}
    facts = attributes(out)
    assert (facts["clrelight_schema"], facts["frame"], facts["centre"]) == ("shrm/1", "global", "reflection")
    assert held.config == {"brdf": "microfacet", "sigma": 0.3}
    assert held.axes == "right,forward,up"
    shown = succeed("info", out, "--json").json
    assert (shown["schema"], shown["datasets"]["maps"]["shape"]) == ("shrm/1", [9, 70, 140, 3])


@pytest.mark.parametrize("method", ["product", "fft"])
def test_methods_agree(made, tmp_path, method):
    succeed("shrm", "build", made / "map.exr", tmp_path / "o.h5", "--sigma", 0.3, "--method", method)
    expected = read_shrm(made / "glossy.h5").maps_khwc
    got = read_shrm(tmp_path / "o.h5").maps_khwc
    np.testing.assert_allclose(got, expected, atol=1e-5 * np.abs(expected).max())


def test_light_files_will_do(made, tmp_path):
    out = tmp_path / "o.h5"
    words = ("--brdf", made / "paint.brdf", "--degree", 6, "--order", 2, "--rows", 20)
    told = succeed("shrm", "build", made / "light.h5", out, *words, "--json").json
    assert (told["degree"], told["rows"], told["config"]) == (6, 20, {"brdf": "measured", "file": "paint.brdf"})
    assert read_shrm(out).source == "noise"


def test_render_is_the_sphere(made, tmp_path):
    words = ("--size", 32, "--view", "0.3,-1,0.2", "--exposure", 0)
    succeed("shrm", "render", made / "glossy.h5", tmp_path / "o.exr", *words)
    shrm = read_shrm(made / "glossy.h5")
    expected = render_sphere(shrm, view_sphere(32, np.array([0.3, -1.0, 0.2])))
    np.testing.assert_allclose(read_image(read_header(tmp_path / "o.exr")), expected, atol=1e-6)
    succeed("shrm", "render", made / "local.h5", tmp_path / "l.exr", *words)
    np.testing.assert_allclose(read_image(read_header(tmp_path / "l.exr")), expected, atol=1e-4 * expected.max())


def test_a_turntable_goes_round_once(made, tmp_path):
    told = succeed("shrm", "render", made / "glossy.h5", tmp_path / "t%d.exr", "--turntable", 4, "--size", 16, "--json")
    assert len(told.json["files"]) == 4
    frames = [read_image(read_header(tmp_path / f"t{i}.exr")) for i in range(4)]
    succeed("shrm", "render", made / "glossy.h5", tmp_path / "q.exr", "--rotate", 90, "--size", 16, "--exposure", "0")
    turned = read_image(read_header(tmp_path / "q.exr")) * 2.0 ** told.json["exposure"]
    np.testing.assert_allclose(frames[1], turned, rtol=1e-4, atol=1e-5)
    assert np.abs(frames[0] - frames[2]).max() > 0.01


def test_a_mesh_is_shown_from_anywhere(made, tmp_path):
    """A ball of triangles, seen without perspective, is the sphere; the environment lies behind it, alpha around it."""
    pytest.importorskip("embreex")
    words = ("--mesh", made / "ball.obj", "--orthographic", "--from", "0,-1,0.3", "--exposure", 0)
    ball, flat = tmp_path / "b.exr", tmp_path / "s.exr"
    told = succeed("shrm", "render", made / "glossy.h5", ball, *words, "--size", 48, "--json").json
    assert (told["vertices"], told["faces"]) == (642, 1280)
    assert told["maps_a_second"] > 0
    succeed("shrm", "render", made / "glossy.h5", flat, "--size", 46, "--exposure", 0)
    middle = np.s_[14:34, 14:34]
    got, expected = read_image(read_header(ball))[middle], read_image(read_header(flat))[13:33, 13:33]
    assert np.linalg.norm(got - expected) < 0.12 * np.linalg.norm(expected)
    behind = ("--background", "environment", "--env", made / "map.exr", "--size", "24,16")
    succeed("shrm", "render", made / "glossy.h5", ball, *words[:2], "--exposure", 0, *behind)
    picture = read_image(read_header(ball))
    assert picture.shape == (16, 24, 3)
    assert picture[:2].min() > 0.0
    clear = ("--background", "transparent", "--size", 16)
    succeed("shrm", "render", made / "glossy.h5", tmp_path / "a.png", *words[:2], *clear)
    with pytest.importorskip("PIL.Image").open(tmp_path / "a.png") as opened:
        assert opened.mode == "RGBA"
    several = ("--turntable", 2, "--size", 16)
    for views in ("distant", "pixel"):
        words_of = (*words[:2], "--views", views, *several)
        text = succeed("shrm", "render", made / "glossy.h5", tmp_path / "v%d.png", *words_of).out
        assert ("dynamic maps" in text) == (views == "distant")
        assert "pictures a second" in text


def test_turntables_are_animated(made, tmp_path):
    image = pytest.importorskip("PIL.Image")
    for name in ("t.gif", "t.apng"):
        words = ("--turntable", 3, "--size", 16, "--turns", "view", "--about", "0,1,0")
        succeed("shrm", "render", made / "glossy.h5", tmp_path / name, *words)
        with image.open(tmp_path / name) as opened:
            assert (opened.n_frames, opened.size) == (3, (16, 16))
            assert name == "t.gif" or opened.format == "PNG"


def test_fibres_take_maps_without_azimuth(made, tmp_path):
    words = ("--brdf", "kajiya-kay", "--exponent", 4)
    told = succeed("shrm", "build", made / "map.exr", tmp_path / "k.h5", *words, "--json").json
    assert (told["frame"], told["maps"], told["centre"]) == ("zonal", told["order"] + 1, "tangent")
    asked = ("--degree", told["degree"], "--order", told["order"], "--frame", "global")
    whole = succeed("shrm", "build", made / "map.exr", tmp_path / "g.h5", *words, *asked, "--json").json
    assert whole["maps"] == (told["order"] + 1) ** 2
    for name in "kg":
        succeed("shrm", "render", tmp_path / f"{name}.h5", tmp_path / f"{name}.exr", "--exposure", 0, "--size", 32)
    fewer, all_ = (read_image(read_header(tmp_path / f"{name}.exr")) for name in "kg")
    np.testing.assert_allclose(fewer, all_, atol=2e-3 * all_.max())
    ended = call("shrm", "build", made / "map.exr", tmp_path / "m.h5", "--sigma", 0.4, "--frame", "zonal")
    assert ended.code == 0
    assert "the rest differs by azimuth" in ended.err


def test_plan_says_what_build_takes(made):
    told = succeed("shrm", "plan", "--sigma", 0.3, "--epsilon", 0.03, "--json").json
    assert (told["degree"], told["order"], told["rows"]) == (7, 2, 70)
    text = succeed("shrm", "plan", made / "map.exr", "--brdf", "phong", "--exponent", 8).out
    assert "bilinear error" in text
    assert "reflectance" in text


@pytest.mark.parametrize(
    ("short", "long"),
    [
        ("microfacet:0.3", ("--sigma", 0.3)),
        ("phong:8", ("--brdf", "phong", "--exponent", 8)),
        ("kajiya-kay:4", ("--brdf", "kajiya-kay", "--exponent", 4)),
    ],
)
def test_a_name_has_its_number_behind_a_colon(made, tmp_path, short, long):
    succeed("shrm", "build", made / "small.exr", tmp_path / "a.h5", "--brdf", short, "--degree", 3, "--order", 0)
    succeed("shrm", "build", made / "small.exr", tmp_path / "b.h5", *long, "--degree", 3, "--order", 0)
    first, second = (read_shrm(tmp_path / name) for name in ("a.h5", "b.h5"))
    assert first.config == second.config
    assert float(short.partition(":")[2]) in first.config.values()
    np.testing.assert_array_equal(first.maps_khwc, second.maps_khwc)
    by_name = build_reflection(made / "light.h5", short, degree=3, order=0)
    assert by_name.config == first.config
    plans = [succeed("shrm", "plan", *words, "--json").json for words in (("--brdf", short), long)]
    assert plans[0] | {"seconds": 0} == plans[1] | {"seconds": 0}
    told = succeed("brdf", "info", short, "--json").json
    assert told["config"] == first.config
    assert told["shares"] == plans[0]["shares"]
    assert f"angles from the {first.centre}" in succeed("brdf", "info", short).out


def test_plan_draws(made, tmp_path):
    pytest.importorskip("matplotlib")
    chart = tmp_path / "a.png"
    succeed("shrm", "plan", made / "map.exr", "--brdf", "phong", "--chart", chart, "--json")
    assert read_header(chart).width > 500


def test_brdf_info(made):
    told = succeed("brdf", "info", made / "paint.brdf", "--json").json
    assert (told["pairs"], told["wavelengths"]) == (40, [450, 550, 650])
    assert "40 pairs of directions" in succeed("brdf", "info", made / "paint.brdf").out


def test_pictures_tell_the_reflectance(made, tmp_path):
    """From a ball's picture to a file, from the file to a reflection map, and to the nearest of some materials."""
    picture, found = tmp_path / "p.exr", tmp_path / "f.json"
    succeed("shrm", "render", made / "glossy.h5", picture, "--size", 48, "--exposure", 0)
    light = ("--light", made / "map.exr", "--degree", 7, "--order", 2)
    told = succeed("brdf", "estimate", picture, found, *light, "--json").json
    assert (len(told["condition"]), len(told["error"]), told["centre"]) == (8, 8, "reflection")
    assert told["residual"] < 0.05
    assert "not explained" in succeed("brdf", "estimate", picture, found, *light, "--prior", "none").out
    assert "F = 7, P = 2, 3 channel(s), angles from the reflection" in succeed("brdf", "info", found).out
    built = succeed("shrm", "build", made / "map.exr", tmp_path / "o.h5", "--brdf", found, "--epsilon", 0.1, "--json")
    assert built.json["config"]["brdf"] == "estimated"
    materials = [word for name in ("microfacet:0.3", "phong:4", "lambert", "skin") for word in ("--material", name)]
    told = succeed("brdf", "recognise", picture, *light, *materials, "--json").json
    assert told["materials"][0] == "microfacet:0.3"
    assert told["distances"][0] < 0.5 * told["distances"][1]
    assert "microfacet:0.3" in succeed("brdf", "recognise", picture, *light, *materials).out


REFUSED = [
    ("brdf estimate map.exr @o.json --light map.exr", "a sphere fills a square"),
    ("brdf estimate map.exr @o.h5 --light map.exr", "written as .json"),
    ("brdf estimate map.exr @o.json --light light.h5 --axes probe", "is for maps"),
    ("brdf estimate none.exr @o.json --light light.h5 --degree 4", "there is no image"),
    ("brdf recognise map.exr --light map.exr --material skin", "two at least"),
    ("brdf recognise map.exr --light map.exr --material skin --material phong:-1", "at least 0"),
    ("brdf recognise map.exr --light map.exr --material skin --material bad.brdf", "is no .brdf file"),
    ("shrm build map.exr @o.h5 --sigma 0", "above 0, got 0"),
    ("shrm build map.exr @o.h5 --sigma -1", "above 0, got -1"),
    ("shrm build map.exr @o.h5 --brdf phong --exponent -1", "at least 0, got -1"),
    ("shrm build map.exr @o.h5 --brdf phong --sigma 1", "phong takes exponent, got sigma"),
    ("shrm build map.exr @o.h5 --brdf chrome", "a reflectance is lambert"),
    ("shrm build map.exr @o.h5 --brdf bad.brdf", "is no .brdf file"),
    ("shrm build map.exr @o.h5 --brdf none.brdf", "cannot read"),
    ("shrm build map.exr @o.h5 --degree 4", "both of them, or epsilon"),
    ("shrm build map.exr @o.h5 --degree 4 --order 1 --epsilon 0.1", "both of them, or epsilon"),
    ("shrm build map.exr @o.h5 --degree 24 --order 2", "fine enough for degree 23"),
    ("shrm build small.exr @o.h5 --sigma 0.2", "fine enough for degree 3"),
    ("shrm build light.h5 @o.h5 --degree 7 --order 2", "the light has degree 6"),
    ("shrm build light.h5 @o.h5 --axes probe", "is for maps"),
    ("shrm build glossy.h5 @o.h5", "expected light/1"),
    ("shrm build map.exr map.exr", "that is the input"),
    ("shrm build map.exr @o.h5 --epsilon 0", "epsilon must be above 0"),
    ("shrm build map.exr @o.h5 --epsilon 1e-9", "ask for more orders or a larger epsilon"),
    ("shrm build map.exr @o.h5 --order 33 --degree 2", "33 is not in the range"),
    ("shrm render light.h5 @o.png", "expected shrm/1"),
    ("shrm render glossy.h5 @o.png --view 0,0,0", "not 0"),
    ("shrm render glossy.h5 @o.exr --tonemap clip", "--tonemap is for 8-bit files"),
    ("shrm render glossy.h5 @o.png --turntable 3", "need a number field"),
    ("shrm render glossy.h5 glossy.h5", "a picture's name ends in"),
    ("shrm render map.exr map.exr", "that is the input"),
    ("shrm render glossy.h5 @o.png --subsamples 2", "--subsamples is for --mesh"),
    ("shrm render glossy.h5 @o.png --from 1,0,0", "--from is for --mesh"),
    ("shrm render glossy.h5 @o.png --size 20,10", "a sphere fills a square"),
    ("shrm render glossy.h5 @o.png --mesh none.obj", "cannot read"),
    ("shrm render glossy.h5 @o.png --mesh ball.obj --view 0,0,1", "a view is for spheres"),
    ("shrm render glossy.h5 @o.png --mesh ball.obj --camera 0,0,0", "stands where it looks"),
    ("shrm render glossy.h5 @o.png --mesh ball.obj --background environment", "no longer holds: give --env"),
    ("shrm render glossy.h5 @o.png --env map.exr", "what --background environment shows"),
    ("shrm render glossy.h5 @o.png --axes probe", "--axes is for --env"),
    ("shrm render glossy.h5 @o.png --about 0,0,1", "axis of --turntable"),
    ("shrm build map.exr @o.h5 --brdf kajiya-kay --exponent 4 --method product", "made by fft, not product"),
    ("shrm plan --sigma -1", "above 0"),
    ("shrm plan --chart @o.png", "under a map: give one"),
    ("shrm plan map.exr --chart @o.pdf", "charts are .png files"),
    ("shrm plan --axes probe", "is for maps"),
    ("brdf info phong:glossy", "a number behind the colon"),
    ("brdf info skin:3", "takes no number"),
    ("shrm build map.exr @o.h5 --brdf phong:8 --exponent 8", "leave exponent out"),
    ("shrm build map.exr @o.h5 --brdf phong:8 --sigma 8", "leave sigma out"),
    ("shrm build map.exr @o.h5 --brdf paint:8", "phong:EXPONENT"),
    ("shrm plan --brdf microfacet:-1", "sigma"),
    ("shrm bench map.exr --table peers --brdf lambert:1", "takes no number"),
    ("brdf info bad.brdf", "is no .brdf file"),
    ("brdf info none.json", "cannot read"),
    ("shrm build map.exr @o.h5 --brdf none.json", "cannot read"),
    ("brdf info map.exr", "no text file"),
]


@pytest.mark.parametrize(("words", "expected"), REFUSED, ids=[words for words, _ in REFUSED])
def test_refused(made, tmp_path, words, expected):
    before = sorted(made.iterdir())
    arguments = [tmp_path / word[1:] if word.startswith("@") else word for word in words.split()]
    arguments = [made / word if isinstance(word, str) and (made / word).is_file() else word for word in arguments]
    ended = call(*arguments)
    assert ended.code == 2
    assert expected in ended.err
    assert ended.out == ""
    assert ended.err.count("\n") == 1 or "Usage" in ended.err
    assert sorted(made.iterdir()) == before
    assert not list(tmp_path.iterdir())


def test_files_keep_float64(tmp_path):
    light = Light(np.random.default_rng(1).standard_normal((16, 1)))
    shrm = build_reflection(light, Microfacet(0.5), degree=3, order=1, rows=4)
    write_shrm(tmp_path / "a.h5", shrm)
    read_back = read_shrm(tmp_path / "a.h5")
    np.testing.assert_array_equal(read_back.maps_khwc, shrm.maps_khwc)
    assert read_back.config == shrm.config
    write_light(tmp_path / "l.h5", light)
    with pytest.raises(StoreFormatError, match="expected shrm/1"):
        read_shrm(tmp_path / "l.h5")
    report = render_reflection(shrm, tmp_path / "s.exr", size=8)
    assert report.facts["order"] == 1


def test_tables_have_their_rows(device):
    light = Light(np.random.default_rng(1).standard_normal((64, 3)))
    (lobe,) = time_phong(light, device, 16, (8,))
    assert lobe["apart"] < 0.1
    (facets,) = time_microfacets(light, device, 16, (0.5,))
    assert (facets["degree"], facets["order"]) == (4, 2)
    assert min(frame_rates(2, device).values()) > 0
    radiance = np.random.default_rng(0).random((32, 64, 3), np.float32)
    assert prefilter_shares(radiance, device).keys() == {"whole", "host", "with_reflectance", "transforms"}
    assert cost_slopes.__doc__


def test_codecs_take_reflection_maps(made, device):
    """Their error is that of radiance over all views; so many principal axes hold no less than so many maps."""
    shrm = read_shrm(made / "glossy.h5")
    rows = {row["codec"]: row for row in code_maps(shrm, device)}
    assert rows["half"]["bits"] == 16
    assert rows["half"]["error"] < 1e-3
    assert rows["klt"]["bytes"] < rows["wavelet"]["bytes"] < rows["half"]["bytes"]
    assert max(row["error"] for row in rows.values()) < 0.05
    shares = principal_shares(shrm)
    energy = np.sort((shrm.maps_khwc.astype(np.float64) ** 2).sum(axis=(1, 2, 3)))[::-1]
    assert (shares >= np.cumsum(energy) / energy.sum() - 1e-9).all()
    assert shares[-1] == pytest.approx(1.0)


def test_orders_beat_earlier_methods(made):
    """Microfacets under noise with a sun: P = 5 is nearer than a texture without azimuth and than twelve maps."""
    from clrelight.lighting.projection import project_environment

    radiance = read_image(read_header(made / "map.exr")).astype(np.float32)
    light = project_environment(Environment(radiance, "latlong"), 15)
    found = compare_peers(light, Microfacet(0.4), degree=15, texels=32, rows=6, orders=(0, 2, 5))
    errors = [found["orders"][p]["error"] for p in (0, 2, 5)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < min(found["texture"], found["icosahedron"])
    assert found["orders"][5]["share"] > 0.99


@pytest.mark.parametrize("table", ["phong", "peers", "codecs"])
def test_a_black_map_has_no_errors_to_measure(tmp_path, table):
    write_image(tmp_path / "black.exr", np.zeros((8, 16, 3), np.float32))
    ended = call("shrm", "bench", tmp_path / "black.exr", "--table", table)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "the map is black" in ended.err
