"""Matrices of rotations that are made once: functions, lights and reflection maps that they turn."""

import numpy as np
import pytest

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.harmonics.rotations import make_rotations, turns_about_y
from clrelight.lighting.light import Light
from clrelight.lighting.rotation import rotate_maps
from clrelight.shrm.prefilter import build_shrm
from clrelight.shrm.rotation import map_degree, rotate_shrm, turn_shrm
from tests.commands import call, succeed
from tests.styles import both_styles

TURNS = np.stack(
    [
        np.eye(3),
        rotation_matrix("euler", (20.0, 50.0, -70.0)),
        rotation_matrix("axis", (1.0, 0.0, 0.0, 180.0)),
        rotation_matrix("axis", (0.0, 0.0, 1.0, 33.0)),
        rotation_matrix("euler", (10.0, 180.0, 0.0)),
    ]
)


def some_places(count, seed=0):
    places = np.random.default_rng(seed).standard_normal((count, 3))
    return places / np.linalg.norm(places, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [0, 1, 2, 7, 30])
def test_a_turned_function_says_of_rd_what_it_said_of_d(degree):
    """By values at directions, of which no matrix knows."""
    coeffs_kx = np.random.default_rng(1).standard_normal(((degree + 1) ** 2, 2, 3))
    turned_nkx = make_rotations(TURNS, degree).apply(coeffs_kx)
    places_i3 = some_places(40)
    expected = np.tensordot(evaluate_basis(places_i3, degree), coeffs_kx, axes=1)
    for turn, turned_kx in zip(TURNS, turned_nkx, strict=True):
        got = np.tensordot(evaluate_basis(places_i3 @ turn.T, degree), turned_kx, axes=1)
        np.testing.assert_allclose(got, expected, atol=1e-12 * np.abs(expected).max())


def test_blocks_stay_orthogonal_at_high_degrees():
    block_nij = make_rotations(TURNS, 100).blocks_lnij[100]
    np.testing.assert_allclose(
        block_nij @ block_nij.transpose(0, 2, 1), np.broadcast_to(np.eye(201), (5, 201, 201)), atol=1e-10
    )


def test_many_rotations_are_each_by_itself():
    """More than are made together, and more than one product takes."""
    many_n33 = np.stack([rotation_matrix("axis", (0.3, 0.2, 1.0, 7.0 * i)) for i in range(70)])
    coeffs_kx = np.random.default_rng(2).standard_normal((36, 1))
    together = make_rotations(many_n33, 5)
    assert (len(together), together.degree) == (70, 5)
    for i in (0, 33, 69):
        alone = make_rotations(many_n33[i : i + 1], 5).apply(coeffs_kx)[0]
        np.testing.assert_allclose(together.apply(coeffs_kx)[i], alone, atol=1e-13)
        np.testing.assert_allclose(together[i : i + 1].apply(coeffs_kx)[0], alone, atol=1e-13)
    each = together.apply_each(np.broadcast_to(coeffs_kx, (70, 36, 1)))
    np.testing.assert_allclose(each, together.apply(coeffs_kx), atol=1e-13)


def test_precision_is_that_of_the_matrices():
    coeffs_kx = np.random.default_rng(3).standard_normal((49, 500))
    double, single = make_rotations(TURNS, 6), make_rotations(TURNS, 6, np.float32)
    assert single.dtype == single.apply(coeffs_kx).dtype == np.float32
    assert double.apply(coeffs_kx.astype(np.float32)).dtype == np.float64
    np.testing.assert_allclose(
        single.apply(coeffs_kx), double.apply(coeffs_kx), atol=13 * 2.0**-23 * np.abs(coeffs_kx).max()
    )
    complexes = coeffs_kx + 1j * coeffs_kx[:, ::-1]
    expected = double.apply(coeffs_kx) + 1j * double.apply(coeffs_kx[:, ::-1])
    np.testing.assert_allclose(double.apply(complexes), expected, atol=1e-12)
    np.testing.assert_array_equal(double.apply(coeffs_kx[:16]).shape, (5, 16, 500))  # fewer degrees


def test_turns_about_y_are_rotations():
    found = turns_about_y((0.3, 2.0), 4)
    about = np.stack([rotation_matrix("axis", (0.0, 1.0, 0.0, np.degrees(angle))) for angle in (0.3, 2.0)])
    for ours, theirs in zip(found.blocks_lnij, make_rotations(about, 4).blocks_lnij, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-13)


def test_what_is_no_rotation_is_refused():
    for bad, said in (
        ((np.ones((1, 3, 3)), 2), "determinant 1"),
        ((np.diag([1.0, 1.0, -1.0])[None], 2), "determinant 1"),
        ((np.full((1, 3, 3), np.nan), 2), "determinant 1"),
        ((np.eye(3), 2), "shape"),
        ((TURNS, 101), "degree must be"),
        ((TURNS, 2, np.float16), "float32 or float64"),
    ):
        with pytest.raises(InputError, match=said):
            make_rotations(*bad)
    rotations = make_rotations(TURNS, 2)
    with pytest.raises(InputError, match="up to 9 coefficients"):
        rotations.apply(np.zeros((16, 1)))
    with pytest.raises(InputError, match="5 rotations need as many"):
        rotations.apply_each(np.zeros((4, 9, 1)))


@both_styles
def test_coefficient_maps_take_matrices_made_before(device):
    coeffs_kp = np.random.default_rng(4).standard_normal((16, 37)).astype(np.float32)
    rotations = make_rotations(TURNS, 3)
    got = rotate_maps(coeffs_kp, rotations[1:2], device=device)
    np.testing.assert_allclose(got, rotations.apply(coeffs_kp)[1], atol=7 * 2.0**-23 * np.abs(coeffs_kp).max() * 7)
    np.testing.assert_array_equal(got, rotate_maps(coeffs_kp, TURNS[1], device=device))
    with pytest.raises(InputError, match="one rotation"):
        rotate_maps(coeffs_kp, rotations, device=device)


def made_of(light_kc, dtype=np.float64, frame="global"):
    rho = np.random.default_rng(5).standard_normal((7, 4, 4, 1))
    l, p, q = np.indices(rho.shape[:3])
    rho[q > np.minimum(l, p)] = 0.0
    return build_shrm(Light(light_kc), BrdfCoefficients(rho, np.ones(1)), 20, 41, frame=frame, dtype=dtype)


@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-12), (np.float32, 2e-6)])
@pytest.mark.parametrize("frame", ["global", "local"])
def test_a_turned_map_is_that_of_the_turned_light(dtype, bound, frame):
    light_kc = np.random.default_rng(6).standard_normal((49, 3))
    shrm = made_of(light_kc, dtype, frame)
    rotations = make_rotations(TURNS, map_degree(shrm))
    for turned_kc, turned in zip(rotations.apply(light_kc), turn_shrm(shrm, rotations), strict=True):
        expected = made_of(turned_kc).maps_khwc
        np.testing.assert_allclose(turned.maps_khwc, expected, atol=bound * np.abs(expected).max())
        assert (turned.frame, turned.maps_khwc.dtype) == ("global", dtype)
    alone = rotate_shrm(shrm, TURNS[1]).maps_khwc
    np.testing.assert_allclose(alone, list(turn_shrm(shrm, rotations))[1].maps_khwc, atol=1e-6)


def test_maps_too_coarse_to_turn_are_refused():
    light_kc = np.random.default_rng(7).standard_normal((49, 1))
    shrm = made_of(light_kc)
    coarse = type(shrm)(shrm.maps_khwc[:, :18].copy(), "global", shrm.degree)
    with pytest.raises(InputError, match="more than 18 rows and columns"):
        rotate_shrm(coarse, TURNS[1])
    with pytest.raises(InputError, match="degree 9, the rotations 4"):
        next(turn_shrm(shrm, make_rotations(TURNS, 4)))


def test_the_command_turns_and_goes_round(tmp_path):
    from clrelight.store import read_shrm, write_shrm

    shrm = made_of(np.random.default_rng(8).standard_normal((49, 3)), np.float32)
    write_shrm(tmp_path / "g.h5", shrm)
    told = succeed("shrm", "rotate", tmp_path / "g.h5", tmp_path / "t.h5", "--rotate", 90, "--json").json
    quarter = rotate_shrm(shrm, rotation_matrix("axis", (0.0, 0.0, 1.0, 90.0))).maps_khwc
    np.testing.assert_allclose(read_shrm(tmp_path / "t.h5").maps_khwc, quarter, atol=1e-5)
    assert told["files"] == [str(tmp_path / "t.h5")]
    succeed("shrm", "rotate", tmp_path / "g.h5", tmp_path / "r%d.h5", "--turntable", 4)
    np.testing.assert_allclose(read_shrm(tmp_path / "r1.h5").maps_khwc, quarter, atol=1e-5)
    np.testing.assert_allclose(read_shrm(tmp_path / "r0.h5").maps_khwc, shrm.maps_khwc, atol=1e-5)
    for words, said in (
        (("o.h5",), "say how the light turns"),
        (("o.h5", "--turntable", 2), "number field"),
        (("o%d.h5", "--turntable", 2, "--about", "0,0,0"), "all zeros"),
        (("g.h5", "--rotate", 1), "g.h5"),
    ):
        done = call("shrm", "rotate", tmp_path / "g.h5", tmp_path / words[0], *words[1:])
        assert done.code == 2
        assert said in done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["g.h5", "r0.h5", "r1.h5", "r2.h5", "r3.h5", "t.h5"]
