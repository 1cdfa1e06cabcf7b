"""Light on surfaces against float64: from everywhere, from a direction, points, balls, polygons and local samples."""

import numpy as np
import pytest

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.harmonics.polygon import polygon_coefficients
from clrelight.harmonics.rotation import rotation_blocks
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.lighting.lamps import blend_lights, cap_light, directional_light
from clrelight.lighting.light import Light
from clrelight.surface import Surface
from clrelight.transfer.lighting_points import lighting_points
from clrelight.transfer.local_light import LocalLights, light_polyhedron, polyhedron_weights
from clrelight.transfer.near_lights import PointLight, PolygonLight, SphereLight
from clrelight.transfer.shading import cut_degree, is_hemispherical, shade_recoloured, shade_vertices, shade_views
from clrelight.transfer.sources import DirectionalLight, DistantLight
from tests.reference.basis import real_harmonics
from tests.reference.surfaces import at_direction, quadrature, received, triangle_coefficients
from tests.rendering import sphere, tangents_of, torus_grid, trimesh, unit

DEGREE = 4
OUTSIDE = (2.0, -1.5, 1.8)


def some_map(surface, degree=DEGREE, channels=3, method="transfer", seed=0):
    rng = np.random.default_rng(seed)
    coeffs = rng.standard_normal(((degree + 1) ** 2, *surface.map_shape, channels)).astype(np.float32)
    return CoefficientMap(coeffs, degree, method, 1.0, "linear", np.array([[0.0, 0, 1]]), surface=surface)


def held(coefficients):
    return coefficients.coeffs_khwc.reshape(coefficients.n_coeff, -1, coefficients.image_shape[2]).astype(np.float64)


def close(made, expected, tolerance=1e-6):
    np.testing.assert_allclose(made, expected, atol=tolerance * np.abs(expected).max())


SURFACES = {"global": sphere(1), "local": sphere(1, tangents=True), "grid": torus_grid(6, 5)}


@pytest.fixture(params=SURFACES)
def surface(request):
    return SURFACES[request.param]


@pytest.mark.parametrize("degree", [0, 1, 6])
def test_many_rotations_are_each_one_rotation(degree):
    rng = np.random.default_rng(degree)
    from scipy.spatial.transform import Rotation

    some = Rotation.random(40, random_state=1).as_matrix()
    edge = Rotation.from_rotvec(
        [[0, 0, 0], [np.pi, 0, 0], [0, np.pi, 0], [0, 0, 2], [1e-9, 2e-9, 0], [np.pi - 1e-9, 0, 0]]
    )
    matrices = np.concatenate([some, edge.as_matrix()])
    coeffs_kc = rng.standard_normal(((degree + 1) ** 2, 2))
    for matrix, made in zip(matrices, rotate_many(coeffs_kc, matrices), strict=True):
        blocks = rotation_blocks(matrix, degree)
        expected = np.concatenate([block @ coeffs_kc[l * l : (l + 1) ** 2] for l, block in enumerate(blocks)])
        np.testing.assert_allclose(made, expected, atol=1e-12)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("light_degree", [2, DEGREE, 7])
def test_light_from_everywhere_is_the_integral(surface, channels, light_degree):
    coefficients = some_map(surface, channels=channels)
    light = Light(np.random.default_rng(9).standard_normal(((light_degree + 1) ** 2, 3)))
    expected = received(np.repeat(held(coefficients), 3 // channels, axis=2), surface.frames(), light.coeffs_kc)
    made = shade_vertices(coefficients, [DistantLight(light)])
    assert (made.shape, made.dtype) == ((surface.n_vertex, 3), np.float32)
    close(made, expected, 2e-6)
    close(shade_vertices(coefficients, [DistantLight(light)], memory=1), made, 1e-6)
    gray = Light(light.coeffs_kc[:, :1])
    expected = received(held(coefficients), surface.frames(), gray.coeffs_kc)
    close(shade_vertices(coefficients, [DistantLight(gray)]), expected, 2e-6)


def test_fits_in_local_frames_know_the_upper_hemisphere():
    surface = SURFACES["local"]
    fitted, projected = some_map(surface, method="uls"), some_map(surface, method="transfer")
    assert [is_hemispherical(each) for each in (fitted, projected, some_map(SURFACES["global"], method="uls"))] == [
        True,
        False,
        False,
    ]
    light = Light(np.random.default_rng(1).standard_normal((36, 3)))
    expected = received(held(fitted), surface.frames(), light.coeffs_kc, upper_only=True)
    close(shade_vertices(fitted, [DistantLight(light)]), expected, 2e-6)
    below = -surface.normals_v3[7]
    made = shade_vertices(fitted, [DirectionalLight(below)])
    np.testing.assert_array_equal(made[7], 0)
    expected = at_direction(held(fitted), surface.frames(), np.broadcast_to(below, (surface.n_vertex, 3)))
    above = surface.normals_v3 @ below > 1e-6
    close(made[above], expected[above], 2e-6)


def test_frames_change_nothing_but_the_coefficients():
    """The same functions in local frames and in global axes reflect the same under every kind of light."""
    ball = SURFACES["global"]
    local = Surface(ball.vertices_v3, ball.faces_f3, ball.normals_v3, tangents_of(ball.normals_v3))
    across = some_map(ball)
    turned_vkc = np.stack(
        [rotate_many(held(across)[:, v], frame[None])[0] for v, frame in enumerate(local.frames())], axis=1
    )
    inside = CoefficientMap(
        turned_vkc[:, :, None].astype(np.float32), DEGREE, "transfer", 1.0, "linear", np.eye(3), surface=local
    )
    light = Light(np.random.default_rng(2).standard_normal((49, 3)))
    for source in (
        DistantLight(light),
        DirectionalLight((1, 2, 3), (1, 0.5, 2)),
        PointLight(OUTSIDE),
        SphereLight(OUTSIDE, 0.4),
        PolygonLight([[2, 0, 0], [2, 1, 0], [2, 1, 1], [2, 0, 1]], two_sided=True),
        LocalLights([light, cap_light((0, 0, 1), 30, 3)], [[2, 0, 0], [-2, 1, 0]]),
    ):
        close(shade_vertices(inside, [source]), shade_vertices(across, [source]), 3e-6)


def test_a_direction_is_the_function_there(surface):
    coefficients = some_map(surface)
    expected = at_direction(
        held(coefficients), surface.frames(), np.broadcast_to(unit([1, 2, -1.5]), (surface.n_vertex, 3))
    )
    made = shade_vertices(coefficients, [DirectionalLight((10, 20, -15), (2, 1, 0.5))])
    close(made, expected * (2, 1, 0.5))
    lamp = directional_light((1, 2, -1.5), DEGREE, (2, 1, 0.5))
    close(shade_vertices(coefficients, [DistantLight(lamp)]), made, 3e-6)


def test_a_point_light_is_the_function_towards_it(surface):
    """Eq. 6 of noise-resistant-fitting, against direct evaluation, to 1e-5."""
    coefficients = some_map(surface)
    way = np.asarray(OUTSIDE) - surface.vertices_v3
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    expected = at_direction(held(coefficients), surface.frames(), way / distance) * (3, 1, 2) / distance**2
    close(shade_vertices(coefficients, [PointLight(OUTSIDE, (3, 1, 2))]), expected, 1e-6)
    far = shade_vertices(coefficients, [PointLight(1e4 * unit([1, 2, -1.5]), (1e8,))])
    close(far, shade_vertices(coefficients, [DirectionalLight((1, 2, -1.5))]), 2e-3)


def test_a_ball_is_the_cap_that_each_vertex_sees(surface):
    coefficients = some_map(surface)
    made = shade_vertices(coefficients, [SphereLight(OUTSIDE, 0.6, (1, 2, 3))])
    for v in range(0, surface.n_vertex, 7):
        way = np.asarray(OUTSIDE) - surface.vertices_v3[v]
        angle = np.degrees(np.arcsin(0.6 / np.linalg.norm(way)))
        cap = cap_light(way, angle, DEGREE, (1, 2, 3))
        one = received(held(coefficients)[:, v : v + 1], surface.frames()[v : v + 1], cap.coeffs_kc)
        np.testing.assert_allclose(made[v], one[0], atol=2e-6 * np.abs(made).max())
    small = shade_vertices(coefficients, [SphereLight(OUTSIDE, 0.01)])
    point = shade_vertices(coefficients, [PointLight(OUTSIDE, (np.pi * 0.01**2,))])
    close(small, point, 1e-3)
    around = shade_vertices(coefficients, [SphereLight((0, 0, 0), 9.0, (1, 1, 1))])
    close(around, held(coefficients)[0] * np.sqrt(4 * np.pi), 1e-6)


def test_a_ball_that_stands_on_the_horizon_is_cut_there():
    """Fits of the upper hemisphere: what is above counts, to 1% of the light, since edges are followed so far."""
    place = Surface(np.zeros((3, 3)), [[0, 1, 2]], [[0, 0, 1.0]] * 3, [[1.0, 0, 0]] * 3)
    nodes, weights = quadrature(60)
    above = nodes[:, 2] > 0
    cosine = np.maximum(0, nodes[:, 2]) * (nodes[:, 0] > -0.2)
    root = np.sqrt(weights[above])
    basis = real_harmonics(nodes[above], DEGREE)
    coeffs = np.linalg.lstsq(basis * root[:, None], cosine[above] * root, rcond=None)[0]
    held_k = np.repeat(coeffs[:, None], 3, axis=1)[..., None, None].astype(np.float32)
    fitted = CoefficientMap(held_k, DEGREE, "uls", 1.0, "linear", np.array([[0.0, 0, 1]]), surface=place)
    fine, solid = quadrature(400)
    values = np.where(fine[:, 2] > 0, real_harmonics(fine, DEGREE) @ coeffs, 0)
    for elevation in (50, 15, 0, -20):
        towards = np.array([np.cos(np.radians(elevation)), 0, np.sin(np.radians(elevation))])
        within = fine @ towards > np.cos(np.radians(30))
        expected = np.sum((solid * values)[within])
        made = shade_vertices(fitted, [SphereLight(tuple(4 * towards), 4 * np.sin(np.radians(30)))])
        np.testing.assert_allclose(made, expected, atol=0.01 * 0.7)
    np.testing.assert_allclose(shade_vertices(fitted, [SphereLight((0, 0, -3), 1.0)]), 0, atol=2e-3)


CORNERS = np.array([[0.2, 0.3, 1.0], [1.4, 0.2, 1.0], [1.1, 1.5, 1.0], [0.1, 1.2, 1.0]])


@pytest.mark.parametrize("degree", [0, 1, 5, 9])
def test_polygons_are_projected_exactly(degree):
    from scipy.spatial.transform import Rotation

    turned = CORNERS @ Rotation.random(random_state=4).as_matrix().T + (0, 0, 0.1)
    for corners in (CORNERS, turned):
        points = np.array([[0, 0, 0], [0.3, -0.2, 0.4], [-3, 2, 0.5]]) + 0.01
        made = polygon_coefficients(corners - points[:, None], degree)
        for point, row in zip(points, made, strict=True):
            expected = sum(triangle_coefficients(corners[[0, j, j + 1]], point, degree, 60) for j in (1, 2))
            np.testing.assert_allclose(row * np.sign(row[0]), expected, atol=1e-9)
        backwards = polygon_coefficients(corners[::-1] - points[:, None], degree)
        np.testing.assert_allclose(backwards, -made, atol=1e-13)


def test_an_octant_of_the_sphere_is_known():
    row = polygon_coefficients(np.eye(3)[None], 2)[0]
    assert row[0] == pytest.approx(np.sqrt(0.25 / np.pi) * np.pi / 2)
    np.testing.assert_allclose(row[1:4], np.sqrt(3 / 4 / np.pi) * np.pi / 4, atol=1e-12)
    # A corner that is not convex is taken away, not added.
    square = np.array([[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2.0]])
    dented = np.array([[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, 0.5, 2.0]])
    missing = np.array([[1, 0, 2], [0, 0.5, 2.0], [-1, 0, 2], [0, -1, 2.0]])
    whole, part, rest = (polygon_coefficients(each[None], 6)[0] for each in (square, dented, missing))
    np.testing.assert_allclose(part + rest, whole, atol=1e-12)


def test_a_polygon_lights_what_it_faces(surface):
    coefficients = some_map(surface)
    corners = np.array([[2.0, -1, -1], [2, -1, 1.5], [2, 1, 1.5], [2, 1, -1]])  # its normal is -x
    one, other = PolygonLight(corners, (1, 2, 3)), PolygonLight(corners[::-1], (1, 2, 3))
    made = shade_vertices(coefficients, [one])
    v = int(np.argmax(surface.vertices_v3[:, 0]))
    light_k = sum(triangle_coefficients(corners[[0, j, j + 1]], surface.vertices_v3[v], DEGREE) for j in (1, 2))
    expected = received(held(coefficients)[:, v : v + 1], surface.frames()[v : v + 1], light_k[:, None] * (1.0, 2, 3))
    np.testing.assert_allclose(made[v], expected[0], atol=3e-6 * np.abs(made).max())
    np.testing.assert_array_equal(shade_vertices(coefficients, [other]), 0)
    both = shade_vertices(coefficients, [PolygonLight(corners[::-1], (1, 2, 3), two_sided=True)])
    np.testing.assert_allclose(both, made, atol=1e-6 * np.abs(made).max())


def test_lights_add_up(surface):
    coefficients = some_map(surface, channels=1)
    sources = [DirectionalLight((0, 0, 1)), PointLight(OUTSIDE, (1, 0, 2)), SphereLight(OUTSIDE, 0.5)]
    together = shade_vertices(coefficients, sources)
    assert together.shape == (surface.n_vertex, 3)
    close(together, sum(shade_vertices(coefficients, [each]).astype(np.float64) for each in sources), 1e-6)


POSITIONS = np.array([[2, 0, 0], [-1, 2, 0], [-1, -2, 0], [0, 0, 3], [0.5, 0.5, -3.0]])


@pytest.mark.parametrize("blend", ["power", "polyhedron"])
def test_local_light_is_exact_at_a_sample_s_own_place(blend):
    rng = np.random.default_rng(3)
    lights = [Light(rng.standard_normal((n * n, 3))) for n in (2, 3, 4, 5, 6)]
    places = Surface(POSITIONS, [[0, 1, 2], [0, 1, 3]], unit(POSITIONS), tangents_of(unit(POSITIONS)))
    coefficients = some_map(places)
    local = LocalLights(lights, POSITIONS, blend, power=3.0)
    made = shade_vertices(coefficients, [local])
    for v, light in enumerate(lights):
        np.testing.assert_array_equal(made[v], shade_vertices(coefficients, [DistantLight(light)])[v])
    between = local.weights(rng.standard_normal((50, 3)))
    np.testing.assert_allclose(between.sum(axis=1), 1, atol=1e-12)
    assert between.min() >= -1e-12
    if blend == "power":
        for point in rng.standard_normal((3, 3)):
            whole = blend_lights(lights, POSITIONS, point, 3.0)
            row = np.array(whole.config["blend"])
            np.testing.assert_allclose(local.weights(point[None])[0], row, atol=1e-12)


def test_a_polyhedron_s_shares_are_barycentric():
    """On a face they return the point, off it its nearest point on the polyhedron, as trimesh finds it."""
    faces = light_polyhedron(POSITIONS)
    assert len(faces) == 6
    points = np.random.default_rng(5).standard_normal((300, 3)) * 2
    weights = polyhedron_weights(POSITIONS, faces, points)
    assert np.count_nonzero(weights, axis=1).max() <= 3
    nearest, distance, _ = trimesh.proximity.closest_point_naive(
        trimesh.Trimesh(POSITIONS, faces, process=False), points
    )
    np.testing.assert_allclose(np.linalg.norm(weights @ POSITIONS - points, axis=1), distance, atol=1e-9)
    np.testing.assert_allclose(weights @ POSITIONS, nearest, atol=1e-6)
    flat = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
    assert len(light_polyhedron(flat)) == 2


def test_four_coefficients_of_one_channel_in_any_colour():
    """spherical-harmonic-lighting: k_red * light[j] * sh[j], summed over 4."""
    ball = SURFACES["global"]
    white = some_map(ball, channels=1)
    light = Light(np.random.default_rng(1).standard_normal((16, 1)))
    colours = np.random.default_rng(2).random((ball.n_vertex, 3))
    shade_v = sum(held(white)[j, :, 0] * light.coeffs_kc[j, 0] for j in range(4))
    close(shade_recoloured(white, light, colours), shade_v[:, None] * colours)
    close(shade_recoloured(white, light, (0.2, 0.4, 0.9)), shade_v[:, None] * (0.2, 0.4, 0.9))
    assert cut_degree(white, 2).n_coeff == 9
    # Of a convex body the first two degrees are within 1/12 of the clamped cosine's light at most.
    nodes, weights = quadrature(30)
    cosine_kv = np.einsum("q,qk,qv->kv", weights, real_harmonics(nodes, 1), np.maximum(0, nodes @ ball.normals_v3.T))
    four = CoefficientMap(cosine_kv[:, :, None, None], 1, "transfer", 1.0, "linear", np.eye(3), surface=ball)
    lamp = cap_light((0, 0, 1), 90, 1)
    made = shade_recoloured(four, lamp, (1, 1, 1))[:, 0] / np.pi
    expected = (1 + ball.normals_v3[:, 2]) / 2
    np.testing.assert_allclose(made, expected, atol=1e-3)


def test_the_eye_s_direction(surface):
    from dataclasses import replace

    coefficients = some_map(replace(surface, argument="view"))
    eyes = unit(np.asarray(OUTSIDE) - surface.vertices_v3)
    close(shade_views(coefficients, eyes), at_direction(held(coefficients), surface.frames(), eyes))
    with pytest.raises(InputError, match="one fixed light"):
        shade_vertices(coefficients, [PointLight(OUTSIDE)])


def test_below_the_horizon_the_eye_sees_what_is_at_it():
    from dataclasses import replace

    surface = replace(SURFACES["local"], argument="view")
    fitted = some_map(surface, method="cls")
    level = np.cross(surface.normals_v3, surface.tangents_v3)
    at = shade_views(fitted, level)
    close(shade_views(fitted, unit(level - 0.4 * surface.normals_v3)), at, 1e-5)
    close(at, at_direction(held(fitted), surface.frames(), level), 1e-5)


def test_lighting_points_of_a_cube():
    """Eight corners with three normals each are 24; where faces meet smoothly, corners are shared."""
    box = trimesh.creation.box()
    scattered = box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3)
    for vertices, faces in ((box.vertices, box.faces), scattered):
        cube = lighting_points(vertices, faces)
        assert cube.n_vertex == 24
        assert sorted(np.abs(cube.normals_v3).max(axis=1)) == pytest.approx([1] * 24)
        assert lighting_points(vertices, faces, crease=180).n_vertex == 8
    corner = np.abs(lighting_points(box.vertices, box.faces, crease=180).normals_v3)
    np.testing.assert_allclose(corner, 1 / np.sqrt(3), atol=1e-6)
    ball = trimesh.creation.icosphere(2)
    smooth = lighting_points(ball.triangles.reshape(-1, 3), np.arange(960).reshape(-1, 3))
    assert smooth.n_vertex == len(ball.vertices)
    assert np.einsum("va,va->v", smooth.normals_v3, unit(smooth.vertices_v3)).min() > 0.999
    with pytest.raises(InputError, match="no area"):
        lighting_points(np.zeros((3, 3)), [[0, 1, 2]])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: PointLight((0, 1)), "position of a point light must be three finite"),
        (lambda: PointLight((0, 1, 2), (1, -1, 0)), "colour"),
        (lambda: SphereLight((0, 0, 0), 0.0), "radius of a sphere"),
        (lambda: PolygonLight([[0, 0, 0], [1, 0, 0]]), "3 or more corners"),
        (lambda: PolygonLight([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "no area"),
        (lambda: PolygonLight([[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0]]), "must lie in a plane"),
        (lambda: DirectionalLight((0, 0, 0)), "not be all zeros"),
        (lambda: LocalLights([], np.zeros((0, 3))), "one or more lights"),
        (lambda: LocalLights([cap_light((0, 0, 1), 9, 2)] * 2, [[0, 0, 0]] * 2), "same position"),
        (lambda: LocalLights([cap_light((0, 0, 1), 9, 2)], [[0, 0, 0]], "near"), "one of power, polyhedron"),
        (lambda: LocalLights([cap_light((0, 0, 1), 9, 2)], [[0, 0, 0]], power=-1), "power of a blend"),
        (lambda: LocalLights([cap_light((0, 0, 1), 9, 2)] * 2, [[0, 0, 0], [0, 1, 0]], "polyhedron"), "3 samples"),
        (lambda: light_polyhedron(np.concatenate([POSITIONS, [[0, 0, 0.1]]])), "within the polyhedron"),
        (lambda: light_polyhedron(np.arange(12.0).reshape(4, 3)), "not all on a line"),
    ],
)
def test_what_is_no_light_is_refused(make, told):
    with pytest.raises(InputError, match=told) as raised:
        make()
    assert "\n" not in str(raised.value)


def test_a_light_on_the_surface_is_refused():
    coefficients = some_map(SURFACES["global"])
    with pytest.raises(InputError, match="lies on the surface"):
        shade_vertices(coefficients, [PointLight(SURFACES["global"].vertices_v3[3])])
    with pytest.raises(InputError, match="the mesh has 42 vertices, the map 30 functions"):
        shade_vertices(
            CoefficientMap(np.zeros((1, 6, 5, 1)), 0, "x", 1.0, "linear", np.eye(3)),
            [PointLight(OUTSIDE)],
            surface=SURFACES["global"],
        )
    with pytest.raises(InputError, match="holds no surface"):
        shade_vertices(CoefficientMap(np.zeros((1, 6, 5, 1)), 0, "x", 1.0, "linear", np.eye(3)), [PointLight(OUTSIDE)])
    rows = some_map(SURFACES["global"], channels=2)
    with pytest.raises(InputError, match="channels"):
        shade_vertices(rows, [PointLight(OUTSIDE, (1, 2, 3))])
