"""clrelight render from files to pictures: lights, frames, backgrounds, turntables, and what is refused."""

from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.dataset import CoefficientMap
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.images import write_image
from clrelight.lighting.lamps import cap_light
from clrelight.lighting.rotation import rotate_light
from clrelight.store import write_fit, write_light
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera, Framing
from clrelight.transfer.views import render_surface
from tests.commands import call, contents, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import encode as encode_srgb
from tests.reference.surfaces import quadrature, received
from tests.rendering import meet_sphere, pixel_rays, sphere, tangents_of, torus_grid, trimesh, unit

DEGREE = 4
CAMERA = Camera((3.0, -4.0, 2.0), field_of_view=33.0)
SMALL = 40


def clamped_cosine(surface, degree=DEGREE, channels=1, **fields):
    """Return unshadowed transfer max(0, n.s) / pi in the surface's frames, by quadrature."""
    nodes, weights = quadrature(60)
    zonal_k = real_harmonics(nodes, degree).T @ (weights * np.maximum(0, nodes[:, 2])) / np.pi
    z_v3 = np.einsum("vab,vb->va", surface.frames(), surface.normals_v3)
    basis_vk = real_harmonics(z_v3, degree)
    l = np.arange(degree + 1)
    axis_l = zonal_k[l * l + l] * np.sqrt(4 * np.pi / (2 * l + 1))
    coeffs_kv = (np.repeat(axis_l, 2 * l + 1) * basis_vk).T
    coeffs = np.repeat(coeffs_kv[..., None], channels, axis=2).reshape(-1, *surface.map_shape, channels)
    held = {"method": "transfer", "peak": 1.0, "transfer": "linear", "directions_i3": np.eye(3), **fields}
    return CoefficientMap(coeffs.astype(np.float32), degree, surface=surface, **held)


BALL = sphere(4)
LOCAL = sphere(4, tangents=True)
LIGHT = cap_light((0.4, -0.6, 0.7), 40, 6, (1.0, 0.8, 0.5))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("render")
    write_fit(place / "ball.h5", clamped_cosine(BALL))
    write_fit(place / "local.h5", clamped_cosine(LOCAL))
    write_fit(place / "bare.h5", replace(clamped_cosine(BALL), surface=None))
    write_light(place / "cap.h5", LIGHT)
    eyes = replace(LOCAL, argument="view")
    write_fit(place / "eyes.h5", replace(clamped_cosine(LOCAL), surface=eyes))
    mesh = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in BALL.vertices_v3.tolist())
    mesh += "".join(f"vn {x!r} {y!r} {z!r}\n" for x, y, z in BALL.normals_v3.tolist())
    mesh += "".join(f"f {a + 1}//{a + 1} {b + 1}//{b + 1} {c + 1}//{c + 1}\n" for a, b, c in BALL.faces_f3.tolist())
    (place / "ball.obj").write_text(mesh)
    write_image(place / "sky.exr", np.random.default_rng(0).random((32, 64, 3), np.float32))
    return place


def read_picture(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT), np.float64)


def test_a_ball_under_a_light_is_its_irradiance(folder):
    """Every pixel against the sum over coefficients at the sphere's own normal there."""
    image = cr.render(folder / "ball.h5", LIGHT, camera=CAMERA, size=SMALL, subsamples=1)
    assert (image.shape, image.dtype) == ((SMALL, SMALL, 3), np.float32)
    points, met = meet_sphere(*pixel_rays(CAMERA, SMALL, SMALL))
    inner = np.abs(np.linalg.norm(np.cross(points, unit(CAMERA.eye_3)), axis=-1)) < 0.93
    inner &= met
    one = clamped_cosine(Surface(points[inner], [[0, 1, 2]], unit(points[inner])))
    expected = received(
        np.repeat(one.coeffs_khwc[:, :, 0].astype(np.float64), 3, axis=2), one.surface.frames(), LIGHT.coeffs_kc
    )
    np.testing.assert_allclose(image[inner], expected, atol=4e-3 * expected.max())
    np.testing.assert_array_equal(image[0, 0], 0)


@pytest.mark.parametrize("shading", ["vertex", "pixel"])
@pytest.mark.parametrize(
    "light",
    [
        LIGHT,
        (0.3, -0.8, 0.5),
        cr.PointLight((2.0, -2.0, 1.5), (4.0, 2.0, 1.0)),
        cr.SphereLight((2.0, -2.0, 1.5), 0.7),
        cr.PolygonLight([[2, -1, 0], [2, 1, 0], [2, 1, 2], [2, -1, 2]], two_sided=True),
        cr.LocalLights([LIGHT, cap_light((0, 0, 1), 90, 3)], [[1, 0, 0], [0, 0, 1]], power=2.0),
    ],
    ids=["everywhere", "direction", "point", "sphere", "polygon", "local"],
)
def test_local_frames_give_the_picture_of_global_axes(folder, shading, light):
    pictures = [
        cr.render(folder / name, light, camera=CAMERA, size=SMALL, subsamples=2, shading=shading)
        for name in ("ball.h5", "local.h5")
    ]
    assert pictures[0].max() > 0.01
    np.testing.assert_allclose(pictures[1], pictures[0], atol=2e-6 * pictures[0].max())
    if shading == "pixel":
        by_vertex = cr.render(folder / "ball.h5", light, camera=CAMERA, size=SMALL, subsamples=2)
        np.testing.assert_allclose(pictures[0], by_vertex, atol=0.03 * by_vertex.max())


def test_a_point_light_is_sharp_where_pixels_are_shaded():
    """On a coarse plate a lamp near its middle is missed by vertices, but not by pixels."""
    plate = Surface([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], [[0, 1, 2], [0, 2, 3]], [[0, 0, 1.0]] * 4)
    flat = clamped_cosine(plate, 8)
    lamp, camera = cr.PointLight((0.2, 0.1, 0.5)), Framing(direction_3=(0, 0, 1), orthographic=True)
    by_pixel, by_vertex = (
        cr.render(flat, lamp, camera=camera, size=41, subsamples=1, shading=each) for each in ("pixel", "vertex")
    )
    assert by_pixel.max() > 10 * by_vertex.max()
    placed = camera.place(plate)
    across = (np.arange(41) + 0.5 - 20.5) / 41 * placed.height
    x, y = np.meshgrid(across, -across)
    way = np.stack([0.2 - x, 0.1 - y, np.full_like(x, 0.5)], axis=-1)
    distance = np.linalg.norm(way, axis=-1)
    one = flat.coeffs_khwc[:, 0, 0, 0].astype(np.float64)
    expected = real_harmonics((way / distance[..., None]).reshape(-1, 3), 8) @ one / distance.ravel() ** 2
    inside = (np.abs(x) < 1.95) & (np.abs(y) < 1.95)
    np.testing.assert_allclose(by_pixel[..., 0][inside], expected.reshape(41, 41)[inside], atol=1e-4)


def test_functions_of_the_eye_are_seen_from_it(folder):
    """max(0, n.v) / pi of a glossy ball is brightest in the middle; per pixel the eye's direction is each pixel's."""
    for shading in ("vertex", "pixel"):
        image = cr.render(folder / "eyes.h5", camera=CAMERA, size=SMALL, subsamples=1, shading=shading)[..., 0]
        points, met = meet_sphere(*pixel_rays(CAMERA, SMALL, SMALL))
        cosine = np.einsum("hwa,hwa->hw", points, unit(np.asarray(CAMERA.eye_3) - points))
        inner = met & (cosine > 0.3)
        nodes, weights = quadrature(60)
        zonal_k = real_harmonics(nodes, DEGREE).T @ (weights * np.maximum(0, nodes[:, 2])) / np.pi
        expected = real_harmonics(np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], -1).reshape(-1, 3), DEGREE)
        expected = (expected @ zonal_k).reshape(cosine.shape)
        np.testing.assert_allclose(image[inner], expected[inner], atol=4e-3)
    with pytest.raises(cr.InputError, match="one fixed light"):
        cr.render(folder / "eyes.h5", LIGHT)


def test_operators_are_seen_under_their_light():
    """A glossy surface: what `reflect` makes of each vertex towards the eye, interpolated."""
    ring = torus_grid(20, 12)
    ring = replace(ring, grid=None)
    glossy = cr.transfer_operators(ring, "phong:20", 4, diffuse=0.3, specular=0.6, samples=64)
    made = cr.render(glossy, LIGHT, camera=CAMERA, size=SMALL)
    towards = cr.reflect(glossy, LIGHT, view=unit(np.asarray(CAMERA.eye_3) - ring.vertices_v3))
    expected = render_surface(ring, towards.reshape(ring.n_vertex, 3), CAMERA, SMALL)
    np.testing.assert_allclose(made, expected, atol=1e-5 * expected.max())
    assert cr.render(glossy, LIGHT, camera=CAMERA, size=SMALL, shading="pixel").shape == made.shape
    for lamp, options in (
        ((0, 0, 1), {}),
        (None, {}),
        (LIGHT, {"degree": 1}),
        (LIGHT, {"turntable": 2, "turns": "light"}),
    ):
        with pytest.raises(cr.InputError):
            cr.render(glossy, lamp, size=8, **options)


def test_a_grid_is_read_as_a_texture():
    ring = torus_grid(16, 12)
    held = clamped_cosine(ring)
    camera = Framing(direction_3=(1, 1, 1))
    fine = torus_grid(16 * 12, 12 * 12)
    expected = cr.render(clamped_cosine(fine), LIGHT, camera=camera, size=SMALL)
    by_vertex, by_pixel = (
        cr.render(held, LIGHT, camera=camera, size=SMALL, shading=each) for each in ("vertex", "pixel")
    )
    assert np.abs(by_pixel - by_vertex).max() > 1e-4
    assert np.abs(by_pixel - expected).mean() < 0.02 * expected.max()


@pytest.mark.filterwarnings("ignore::clrelight.Note")
def test_a_mesh_comes_beside_a_map_that_holds_none(folder):
    with_surface = cr.render(folder / "ball.h5", LIGHT, camera=CAMERA, size=SMALL)
    for mesh in (folder / "ball.obj", folder / "ball.h5", BALL):
        made = cr.render(folder / "bare.h5", LIGHT, camera=CAMERA, size=SMALL, mesh=mesh)
        np.testing.assert_allclose(made, with_surface, atol=1e-6)
    z_up = "\n".join((folder / "ball.obj").read_text().splitlines())
    swapped = [
        " ".join((words[0], words[1], words[3], repr(-float(words[2])))) if words[0] in ("v", "vn") else line
        for line in z_up.splitlines()
        if (words := line.split())
    ]
    (folder / "y_up.obj").write_text("\n".join(swapped))  # z goes to y, and y to -z
    made = cr.render(folder / "bare.h5", LIGHT, camera=CAMERA, size=SMALL, mesh=folder / "y_up.obj", mesh_up="y")
    np.testing.assert_allclose(made, with_surface, atol=1e-6)
    coded = cr.encode(folder / "bare.h5", "half")
    made = cr.render(coded, LIGHT, camera=CAMERA, size=SMALL, mesh=BALL)
    np.testing.assert_allclose(made, with_surface, atol=2e-3 * with_surface.max())


@pytest.mark.filterwarnings("ignore::clrelight.Note")
def test_a_mesh_wears_a_map_as_its_texture(folder):
    """Two charts of a bent sheet, apart in the texture: as by vertices, and without a seam."""
    rows, columns = 24, 20
    u, v = np.meshgrid(np.arange(rows) / (rows - 1), np.arange(columns) / (columns - 1), indexing="ij")
    points, charts, faces = [], [], []
    for chart in range(2):
        x = u.ravel() + chart
        points.append(np.stack([x, 2 * v.ravel(), 0.4 * np.sin(2 * x)], axis=1))
        charts.append(np.stack([0.05 + 0.4 * u.ravel() + 0.5 * chart, 0.05 + 0.9 * v.ravel()], axis=1))
        at = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel() + chart * rows * columns
        faces += [np.stack([at, at + columns, at + columns + 1], 1), np.stack([at, at + columns + 1, at + 1], 1)]
    points = np.concatenate(points)
    normals = unit(np.stack([-0.8 * np.cos(2 * points[:, 0]), 0 * points[:, 0], 1 + 0 * points[:, 0]], axis=1))
    sheet = Surface(points, np.concatenate(faces), normals, texture_v2=np.concatenate(charts))
    texels = cr.transfer(sheet, kind="unshadowed", texels=(128, 128), degree=3)
    options = {"camera": Framing(direction_3=(0.2, -1, 1.5)), "size": 60}
    for lights in (LIGHT, [LIGHT, cr.PointLight((1, 1, 2), (3,))]):
        expected = cr.render(cr.transfer(sheet, kind="unshadowed", degree=3), lights, **options)
        for shading in ("vertex", "pixel"):
            worn = cr.render(texels, lights, mesh=sheet, shading=shading, **options)
            np.testing.assert_allclose(worn, expected, atol=0.02 * expected.max())
    coded = cr.encode(texels, "half")
    again = cr.render(coded, lights, mesh=sheet, shading="pixel", **options)
    np.testing.assert_allclose(again, worn, atol=3e-3 * worn.max())
    with pytest.raises(cr.InputError, match="leave out --mesh"):
        cr.render(texels, LIGHT, mesh=BALL, **options)


def test_small_memory_gives_the_same_picture(folder):
    for shading in ("vertex", "pixel"):
        options = {"camera": CAMERA, "size": (50, 40), "shading": shading, "background": (0.1, 0.2, 0.3)}
        lights = [LIGHT, cr.PointLight((2.0, -2.0, 1.5))]
        whole, parts = (cr.render(folder / "local.h5", lights, memory=each, **options) for each in ("1GiB", "100k"))
        np.testing.assert_allclose(parts, whole, atol=1e-6)


def test_backgrounds(folder):
    options = {"camera": CAMERA, "size": SMALL}
    black = cr.render(folder / "ball.h5", LIGHT, **options)
    clear = cr.render(folder / "ball.h5", LIGHT, background="transparent", **options)
    np.testing.assert_array_equal(clear[..., :3], black)
    cover = clear[..., 3:]
    assert (cover.min(), cover.max(), 0.2 < cover.mean() < 0.95) == (0, 1, True)
    red = cr.render(folder / "ball.h5", LIGHT, background=(1, 0, 0), **options)
    np.testing.assert_allclose(red, black + (1 - cover) * (1, 0, 0), atol=1e-6)
    _, directions = pixel_rays(CAMERA, SMALL, SMALL)
    band = np.maximum(real_harmonics(directions.reshape(-1, 3), 6) @ LIGHT.coeffs_kc, 0).reshape(SMALL, SMALL, 3)
    around = cr.render(folder / "ball.h5", LIGHT, background="environment", **options)
    np.testing.assert_allclose(around, black + (1 - cover) * band, atol=1e-5)
    sky, _ = cr.read_environment(folder / "sky.exr")
    black = cr.render(folder / "ball.h5", sky, **options)
    around = cr.render(folder / "ball.h5", sky, background="environment", **options)
    empty = cover[..., 0] == 0
    assert np.all(around[empty].max(axis=-1) > 0)
    turned = cr.render(folder / "ball.h5", sky, background="environment", rotate=90, **options)
    spun = rotated_texels(sky, directions)
    np.testing.assert_allclose(turned[empty], spun[empty], atol=1e-5)


def rotated_texels(sky, directions):
    """Return what a map shows after a turn by 90 degrees about z, counterclockwise."""
    from clrelight.lighting.lookup import look_up

    back = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    return look_up(sky, directions.reshape(-1, 3) @ back.T).reshape(*directions.shape)


def test_turntables(folder):
    views = cr.render(folder / "ball.h5", LIGHT, size=32, turntable=4)
    lights = cr.render(folder / "ball.h5", LIGHT, size=32, turntable=4, turns="light")
    assert views.shape == lights.shape == (4, 32, 32, 3)
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    # A ball that is seen from elsewhere looks as if its light had gone the other way.
    back = cr.render(folder / "ball.h5", rotate_light(LIGHT, turn.T), size=32, turntable=2)
    assert np.abs(views[1] - back[0]).mean() < 1e-3 * views.max()  # but for the outline, which faces cut
    forward = cr.render(folder / "ball.h5", rotate_light(LIGHT, turn), size=32)
    np.testing.assert_allclose(lights[1], forward, atol=1e-5)
    sun = cr.render(folder / "ball.h5", (1, 0, 0.3), size=32, turntable=4, turns="light")
    np.testing.assert_allclose(sun[1], cr.render(folder / "ball.h5", (0, 1, 0.3), size=32), atol=1e-5)
    # Nothing leaves the picture on the way round.
    box = trimesh.creation.box((9, 0.3, 1))
    long = Surface(box.vertices, box.faces.astype(np.int32), unit(box.vertices))
    around = cr.render(clamped_cosine(long), LIGHT, size=64, turntable=8, background="transparent")[..., 3]
    edges = np.concatenate([around[:, 0], around[:, -1], around[:, :, 0], around[:, :, -1]])
    assert not edges.any()


def test_exposure_is_judged_by_the_surface(folder):
    options = {"camera": CAMERA, "size": 32}
    report = cr.Report()
    made = cr.render(folder / "ball.h5", LIGHT, exposure="auto", background=(50.0,), report=report, **options)
    plain = cr.render(folder / "ball.h5", LIGHT, **options)
    cover = cr.render(folder / "ball.h5", LIGHT, background="transparent", **options)[..., 3] == 1
    white = np.percentile(plain[cover].max(axis=-1), 99)
    assert report.facts["exposure"] == pytest.approx(-np.log2(white), abs=1e-5)
    np.testing.assert_allclose(made[cover], plain[cover] / white, rtol=1e-5)
    np.testing.assert_allclose(
        cr.render(folder / "ball.h5", LIGHT, exposure=2, **options), 4 * plain, rtol=1e-6, atol=1e-9
    )


def test_four_coefficients_in_any_colour(folder):
    four = cr.render(folder / "ball.h5", LIGHT, camera=CAMERA, size=32, degree=1, recolour=(0.5, 1.0, 0.25))
    held = clamped_cosine(BALL, 1)
    np.testing.assert_allclose(
        four, cr.render(held, LIGHT, camera=CAMERA, size=32) * np.float32([0.5, 1.0, 0.25]), atol=1e-6
    )


def test_the_command_writes_what_the_verb_returns(folder, tmp_path):
    line = ("--camera", "3,-4,2", "--target", "0,0,0", "--fov", 33, "--size", "40,30")
    options = {"camera": CAMERA, "size": (40, 30)}
    lamps = [(0, 0, 1), LIGHT, cr.PointLight((2, -2, 1.5), (4,)), cr.SphereLight((0, 0, 4), 0.5, (1, 2, 3))]
    told = succeed(
        *("render", folder / "ball.h5", tmp_path / "a.exr", *line, "--light", "0,0,1", "--light", folder / "cap.h5"),
        *("--point", "2,-2,1.5,4", "--sphere", "0,0,4,0.5,1,2,3", "--json"),
    ).json
    image = cr.render(folder / "ball.h5", lamps, **options)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), image)
    assert (told["files"], told["vertices"], told["degree"]) == ([str(tmp_path / "a.exr")], BALL.n_vertex, DEGREE)
    assert told["camera"]["eye"] == [3.0, -4.0, 2.0]
    assert told["seconds"].keys() >= {"read", "render", "write"}
    succeed("render", folder / "ball.h5", tmp_path / "b.png", *line, "--light", folder / "cap.h5", "--exposure", 1)
    image = cr.render(folder / "ball.h5", LIGHT, exposure=1, **options).astype(np.float64)
    shown = 255 * read_picture(tmp_path / "b.png")
    assert np.abs(shown - 255 * encode_srgb(np.clip(image, 0, 1))).max() <= 0.5 + 1e-3
    area = "2,-1,0,2,1,0,2,1,2,2,-1,2:1,0.5,0.25"
    succeed(
        "render", folder / "ball.h5", tmp_path / "c.exr", *line, "--area", area, "--two-sided", "--shading", "pixel"
    )
    polygon = cr.PolygonLight(np.array(area.split(":")[0].split(","), float).reshape(-1, 3), (1, 0.5, 0.25), True)
    image = cr.render(folder / "ball.h5", polygon, shading="pixel", **options)
    np.testing.assert_array_equal(read_picture(tmp_path / "c.exr"), image)
    places = [word for at in ("1,0,0", "0,0,1") for word in ("--local", f"{folder / 'cap.h5'}@{at}")]
    succeed("render", folder / "ball.h5", tmp_path / "d.exr", *line, *places, "--power", 2)
    local = cr.render(folder / "ball.h5", LIGHT, **options)
    np.testing.assert_allclose(read_picture(tmp_path / "d.exr"), local, atol=1e-6)
    told = succeed("render", folder / "ball.h5", tmp_path / "e.exr", *line, "--sky", "clear", "--sun", "30,200")
    assert "vertices" in told.out
    sky = cr.sky_light("clear", 30, 200, degree=DEGREE)
    image = cr.render(folder / "ball.h5", sky, **options)
    np.testing.assert_array_equal(read_picture(tmp_path / "e.exr"), image)
    succeed("render", folder / "ball.h5", tmp_path / "f.exr", *line, "--env", folder / "sky.exr", "--axes", "camera")
    environment, _ = cr.read_environment(folder / "sky.exr", axes="camera")
    image = cr.render(folder / "ball.h5", environment, **options)
    np.testing.assert_array_equal(read_picture(tmp_path / "f.exr"), image)


def test_files_with_alpha_and_in_motion(folder, tmp_path):
    line = ("render", folder / "ball.h5")
    shared = ("--size", 24, "--light", folder / "cap.h5")
    made = cr.render(folder / "ball.h5", LIGHT, size=24, background="transparent").astype(np.float64)
    for name in ("a.png", "a.exr", "a.tif"):
        succeed(*line, tmp_path / name, *shared, "--background", "transparent", "--transfer", "linear")
        spec = oiio.ImageInput.open(str(tmp_path / name)).spec()
        assert (spec.nchannels, spec.alpha_channel) == (4, 3)
        held = read_picture(tmp_path / name)  # as OpenImageIO hands it on: multiplied by alpha
        np.testing.assert_allclose(
            held, np.clip(made, -9 if name != "a.png" else 0, 9), atol=5e-3 if name == "a.png" else 1e-6
        )
    succeed(*line, tmp_path / "t%02d.png", *shared, "--turntable", 3)
    assert sorted(each.name for each in tmp_path.glob("t*")) == ["t00.png", "t01.png", "t02.png"]
    pytest.importorskip("PIL", reason="animations need Pillow")
    from PIL import Image

    succeed(*line, tmp_path / "t.gif", *shared, "--turntable", 3, "--turns", "light")
    assert Image.open(tmp_path / "t.gif").n_frames == 3


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("bare.h5 o.png --light 0,0,1", "holds no surface"),
        ("bare.h5 o.png --light 0,0,1 --mesh local.txt", "local.txt"),
        ("bare.h5 o.png --light 0,0,1 --mesh bare.h5", "holds no surface"),
        ("bare.h5 o.png --light 0,0,1 --mesh small.obj", "the mesh has 3 vertices, the map 2562 functions (2562×1)"),
        ("ball.h5 o.png --light 0,0,1 --mesh ball.obj", "leave out --mesh"),
        ("ball.h5 o.png --light 0,0,1 --mesh-up y", "--mesh-up is for the file"),
        ("bare.h5 o.png --light 0,0,1 --mesh ball.h5 --mesh-up y", "--mesh-up is for mesh files"),
        ("ball.h5 o.png", "give a light"),
        ("eyes.h5 o.png --light 0,0,1", "one fixed light"),
        ("cap.h5 o.png --light 0,0,1", "cap.h5"),
        ("ball.h5 ball.h5 --light 0,0,1", "ball.h5"),
        ("ball.h5 o.png --light 0,0,1 --size 0", "picture's size"),
        ("ball.h5 o.png --light 0,0,1 --size 8,8,8", "picture's size"),
        ("ball.h5 o.png --light 0,0,1 --camera 0,0,0 --target 0,0,1 --up 0,1,0", "stands inside"),
        ("ball.h5 o.png --light 0,0,1 --camera 0,5,0 --target 0,9,0", "sees nothing"),
        ("ball.h5 o.png --light 0,0,1 --camera 0,0,5", "up must not point along the view"),
        ("ball.h5 o.png --light 0,0,1 --target 0,0,1", "a target goes with an eye"),
        ("ball.h5 o.png --light 0,0,1 --camera 0,5,0 --from 1,1,1", "not both"),
        ("ball.h5 o.png --light 0,0,1 --fov 180", "below 180"),
        ("ball.h5 o.png --light 0,0,1 --from 0,0,0", "not all zero"),
        ("ball.h5 o.png --light 0,0,0", "not be all zeros"),
        ("ball.h5 o.jpg --light 0,0,1 --background transparent", "transparent background goes to"),
        ("ball.h5 o.png --light 0,0,1 --background environment", "needs light from everywhere"),
        ("ball.h5 o.png --light 0,0,1 --background 1,2", "1 or 3 finite numbers"),
        ("ball.h5 o.png --light 0,0,1 --background blue", "blue"),
        ("ball.h5 o.exr --light 0,0,1 --tonemap reinhard", "8-bit files"),
        ("ball.h5 o.png --light 0,0,1 --turntable 3", "number field"),
        ("ball.h5 o.png --light 0,0,1 --about 0,0,1", "axis of --turntable"),
        ("ball.h5 o%d.png --point 0,0,3 --turntable 3 --turns light", "do not go round"),
        ("ball.h5 o.png --point 0,0,3 --rotate 30", "positions of their own"),
        ("ball.h5 o.png --light 0,0,1 --degree 5", "cannot be cut to 5"),
        ("ball.h5 o.png --light 0,0,1 --recolour 1,-1,1", "not negative"),
        ("ball.h5 o.png --point 0,0,3,1,2", "--point takes"),
        ("ball.h5 o.png --sphere 0,0,3", "--sphere takes"),
        ("ball.h5 o.png --sphere 0,0,3,0", "radius of a sphere"),
        ("ball.h5 o.png --area 0,0,3,1,0,3", "three corners or more"),
        ("ball.h5 o.png --light 0,0,1 --sun 3,4", "--sun is for --sky"),
        ("ball.h5 o.png --light 0,0,1 --power 3", "--power is for --local"),
        ("ball.h5 o.png --light 0,0,1 --layout cube", "--layout is for --env"),
        ("ball.h5 o.png --sky clear", "needs the sun"),
        ("ball.h5 o.png --local cap.h5@0,0,1 --local-blend polyhedron", "3 samples or more"),
        ("ball.h5 o.xyz --light 0,0,1", "xyz"),
        ("nowhere.h5 o.png --light 0,0,1", "nowhere.h5"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(folder, monkeypatch, words, told):
    monkeypatch.chdir(folder)
    (folder / "small.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "local.txt").write_text("none")
    before = contents(folder)
    ended = call("render", *words.split(), *([] if "--size" in words else ["--size", 16]), "--subsamples", 1)
    lines = [line for line in ended.err.splitlines() if not line.startswith("note: ")]
    assert (ended.code, ended.out, len(lines)) == (2, "", 1)
    assert told in lines[0]
    assert contents(folder) == before


@pytest.mark.parametrize(
    "options",
    [
        {"light": "nowhere.h5"},
        {"light": 7},
        {"light": [LIGHT, {}]},
        {"light": (0, 0)},
        {"camera": "above"},
        {"camera": (1, 2)},
        {"size": "large"},
        {"subsamples": 0},
        {"subsamples": 2.5},
        {"shading": "flat"},
        {"background": "blue"},
        {"turntable": 0},
        {"turns": "eye"},
        {"recolour": "red"},
        {"memory": "lots"},
        {"transfer": "gamma"},
        {"tonemap": "filmic"},
        {"exposure": "bright"},
        {"out": 3},
        {"mesh": 3},
        {"about": "z"},
        {"rotate": "left"},
    ],
    ids=lambda options: next(iter(options)),
)
def test_bad_arguments_are_named(folder, options):
    with pytest.raises(cr.InputError) as told:
        cr.render(folder / ("bare.h5" if "mesh" in options else "ball.h5"), **{"light": LIGHT, "size": 8, **options})
    assert "\n" not in str(told.value)


def test_without_the_extra_it_is_said(folder, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(cr.InputError, match=r"clrelight\[surfaces\]"):
        cr.render(folder / "ball.h5", LIGHT, size=8)


def test_a_picture_of_plain_values():
    """`render_surface`, which scenes use: the same rays, any values."""
    turned = rotate_many(LIGHT.coeffs_kc, np.eye(3)[None])[0]
    np.testing.assert_allclose(turned, LIGHT.coeffs_kc, atol=1e-12)
    frames = tangents_of(BALL.normals_v3)
    image = render_surface(BALL, frames, CAMERA, 24)
    assert (image.shape, image.dtype) == ((24, 24, 3), np.float32)
