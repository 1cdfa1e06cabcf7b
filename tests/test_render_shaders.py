"""GLSL that is written out computes what the package does: translated into Python, and on a GL where there is one."""

import os

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.lighting.irradiance import evaluate_irradiance
from clrelight.lighting.light import Light
from clrelight.store import write_fit, write_light
from clrelight.transfer.shaders import irradiance_shader, transfer_shader
from tests.commands import call, succeed
from tests.glsl import run, vector
from tests.reference.surfaces import received
from tests.rendering import sphere, unit

NORMALS = unit(np.random.default_rng(0).standard_normal((40, 3)))


def some_light(degree, channels=3, scale=1.0):
    rng = np.random.default_rng(degree)
    return Light(scale * rng.standard_normal(((degree + 1) ** 2, channels)), 'a "map".hdr\nfloat x; \\')


@pytest.mark.parametrize("form", ["irradiance_matrix", "irradiance_polynomial"])
@pytest.mark.parametrize(("degree", "channels"), [(2, 3), (2, 1), (0, 3), (1, 3), (5, 3)])
def test_irradiance_is_that_of_the_package(form, degree, channels):
    light = some_light(degree, channels)
    function = run(irradiance_shader(light))[form]
    expected = evaluate_irradiance(light, NORMALS)
    made = np.array([function(vector(normal)) for normal in NORMALS])
    np.testing.assert_allclose(made, np.broadcast_to(expected, (40, 3)), atol=1e-5 * np.abs(expected).max())


def test_constants_have_all_digits():
    light = some_light(2, scale=1e-7)
    space = run(irradiance_shader(light), mat4=lambda *numbers: np.array(numbers).reshape(4, 4).T)
    from clrelight.lighting.irradiance import irradiance_matrix

    np.testing.assert_array_equal(
        [space[f"IRRADIANCE_{name}"] for name in "RGB"], irradiance_matrix(light), strict=True
    )
    text = transfer_shader(light, 2)
    held = run(text, vec3=lambda *numbers: numbers)["LIGHT"]
    np.testing.assert_array_equal(held, light.coeffs_kc)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("degree", "light_degree"), [(0, 2), (1, 3), (4, 4), (6, 3)])
def test_transfer_is_the_sum_of_products(degree, light_degree, channels):
    n_coeff = (degree + 1) ** 2
    light = some_light(light_degree)
    rng = np.random.default_rng(1)
    vectors = rng.standard_normal((5, n_coeff, channels)).astype(np.float32)
    padded = np.zeros((n_coeff, 3))
    shared = min(n_coeff, len(light.coeffs_kc))
    padded[:shared] = light.coeffs_kc[:shared]
    expected = np.einsum("vkc,kc->vc", np.broadcast_to(vectors, (5, n_coeff, 3)), padded)
    text = transfer_shader(light, degree, channels=channels)
    for held_kc, row in zip(vectors, expected, strict=True):
        rows = [vector(*each) if channels == 3 else each[0] for each in held_kc]
        made = run(text)["transfer_radiance"](rows)
        np.testing.assert_allclose(made, row, atol=1e-5 * np.abs(expected).max())
        fours = np.concatenate([held_kc[:, 0], np.zeros(-n_coeff % 4)]).reshape(-1, 4)
        pieces = held_kc if channels == 3 else fours
        layers = [vector(*piece, *([0] * (4 - len(piece)))) for piece in pieces]
        if len(layers) <= 15:
            named = {f"transfer_{j}": vector(*piece) for j, piece in enumerate(pieces)}
            made = run(text, **named)["transfer_from_attributes"]()
            np.testing.assert_allclose(made, row, atol=1e-5 * np.abs(expected).max())
        else:
            assert "transfer_from_attributes" not in text
        look = run(
            transfer_shader(light, degree, channels=channels, form="texture"),
            texture=lambda held, place: held[int(place[2])],
            vec3=vector,
        )
        made = look["transfer_from_texture"](layers, vector(0.5, 0.5))
        np.testing.assert_allclose(made, row, atol=1e-5 * np.abs(expected).max())


def test_fits_of_the_hemisphere_have_the_autocorrelation_in_the_light():
    light = some_light(5)
    coeffs_k = np.random.default_rng(3).standard_normal(16)
    made = run(transfer_shader(light, 3, hemispherical=True))["transfer_radiance"](coeffs_k.astype(np.float32))
    coeffs_kvc = np.broadcast_to(coeffs_k[:, None, None], (16, 1, 3))
    expected = received(coeffs_kvc, np.eye(3)[None], light.coeffs_kc, upper_only=True)[0]
    np.testing.assert_allclose(made, expected, atol=1e-5 * np.abs(expected).max())


def test_what_is_no_shader_is_refused():
    with pytest.raises(InputError, match="attributes, texture"):
        transfer_shader(some_light(1), 1, form="uniform")
    with pytest.raises(InputError, match="1 or 3 channels"):
        transfer_shader(some_light(1), 1, channels=2)


def test_commands_write_the_texts(tmp_path):
    from clrelight.dataset import CoefficientMap

    light = some_light(2)
    write_light(tmp_path / "light.h5", light)
    told = succeed("shader", "irradiance", tmp_path / "light.h5", "--out", tmp_path / "i.glsl", "--json").json
    assert (tmp_path / "i.glsl").read_text() == irradiance_shader(light)
    assert told["functions"] == ["irradiance_matrix", "irradiance_polynomial"]
    succeed("shader", "transfer", tmp_path / "light.h5", "--out", tmp_path / "t.glsl", "--degree", 4, "--channels", 3)
    assert (tmp_path / "t.glsl").read_text() == transfer_shader(light, 4, channels=3)
    for ball, method in ((sphere(1), "transfer"), (sphere(1, tangents=True), "uls")):
        coeffs = np.zeros((25, *ball.map_shape, 3), np.float32)
        write_fit(tmp_path / "map.h5", CoefficientMap(coeffs, 4, method, 1.0, "linear", np.eye(3), surface=ball))
        ended = call(
            "shader", "transfer", tmp_path / "light.h5", "--map", tmp_path / "map.h5", "--out", tmp_path / "m.glsl"
        )
        assert (ended.code, "fit in local frames" in ended.err) == (0, method == "uls")
        assert (tmp_path / "m.glsl").read_text() == transfer_shader(light, 4, channels=3, hemispherical=method == "uls")
    before = (tmp_path / "light.h5").read_bytes()
    for words in (("irradiance", "none.h5"), ("transfer", "light.h5", "--degree", "-1"), ("irradiance", "map.h5")):
        ended = call("shader", words[0], tmp_path / words[1], *words[2:], "--out", tmp_path / "new.glsl")
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert call("shader", "irradiance", tmp_path / "light.h5", "--out", tmp_path / "light.h5").code == 2
    assert (tmp_path / "light.h5").read_bytes() == before
    assert not (tmp_path / "new.glsl").exists()


def test_a_gpu_compiles_and_computes_them():
    moderngl = pytest.importorskip("moderngl", reason="no moderngl: pip install moderngl")
    try:
        context = moderngl.create_standalone_context(require=330, backend=os.environ.get("CLRELIGHT_GL", "egl"))
    except Exception as error:
        pytest.skip(f"no OpenGL without a screen here: {error}")
    light = some_light(2)
    context.simple_framebuffer((1, 1)).use()
    out = context.buffer(reserve=40 * 6 * 4)
    program = context.program(
        vertex_shader="#version 330\nin vec3 n; out vec3 a; out vec3 b;\n"
        + irradiance_shader(light)
        + "void main() { a = irradiance_matrix(n); b = irradiance_polynomial(n); }",
        varyings=["a", "b"],
    )
    buffer = context.buffer(NORMALS.astype("f4").tobytes())
    context.vertex_array(program, [(buffer, "3f", "n")]).transform(out, moderngl.POINTS)
    made = np.frombuffer(out.read(), "f4").reshape(40, 2, 3)
    expected = evaluate_irradiance(light, NORMALS)
    np.testing.assert_allclose(made, np.repeat(expected[:, None], 2, axis=1), atol=1e-5 * np.abs(expected).max())
    vectors = (
        np.random.default_rng(4).standard_normal((40, 28)).astype("f4")
    )  # of 25 coefficients, and three of nothing
    light = some_light(4)
    program = context.program(
        vertex_shader="#version 330\nout vec3 a;\n"
        + transfer_shader(light, 4)
        + "void main() { a = transfer_from_attributes(); }",
        varyings=["a"],
    )
    named = [f"transfer_{j}" for j in range(7)]
    context.vertex_array(program, [(context.buffer(vectors.tobytes()), "4f " * 7, *named)]).transform(
        out, moderngl.POINTS
    )
    made = np.frombuffer(out.read(), "f4")[:120].reshape(40, 3)
    expected = vectors[:, :25] @ light.coeffs_kc
    np.testing.assert_allclose(made, expected, atol=1e-5 * np.abs(expected).max())
    texture = context.program(
        vertex_shader="#version 330\nuniform sampler2DArray layers; out vec3 a;\n"
        + transfer_shader(light, 4, form="texture")
        + "void main() { a = transfer_from_texture(layers, vec2((float(gl_VertexID) + 0.5) / 40.0, 0.5)); }",
        varyings=["a"],
    )
    stored = np.ascontiguousarray(vectors.reshape(40, 7, 4).swapaxes(0, 1))
    context.texture_array((40, 1, 7), 4, stored.tobytes(), dtype="f4").use(0)
    context.vertex_array(texture, []).transform(out, moderngl.POINTS, 40)
    made = np.frombuffer(out.read(), "f4")[:120].reshape(40, 3)
    np.testing.assert_allclose(made, expected, atol=1e-5 * np.abs(expected).max())
