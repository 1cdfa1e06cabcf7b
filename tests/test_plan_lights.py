"""Planning lights: noise against dense float64 algebra and real noise, choices against brute force, and the command."""

import math

import numpy as np
import pytest

from clrelight.dataset import split_lights
from clrelight.errors import InputError
from clrelight.experiment.light_counts import measure_choices
from clrelight.light_files import read_light_file
from clrelight.plan_lights import CHOICES, PROPOSALS, assess_lights, choose_lights, propose_lights
from clrelight.sampling import make_pattern
from tests.commands import call, contents, succeed
from tests.reference import fit as reference_fit
from tests.reference import psnr
from tests.reference.basis import real_harmonics, sphere_quadrature
from tests.stacks import make_stack, samples_of

COUNT = 30


def hemisphere_products(degree, sphere=False):
    """Return G, the integrals of products of basis functions, by a quadrature over the sphere (and z's symmetry)."""
    nodes_j3, area_j = sphere_quadrature(2 * degree + 2)
    basis_jk = real_harmonics(nodes_j3, degree)
    if sphere:
        return basis_jk.T @ (area_j[:, None] * basis_jk)
    # Gauss's rule on z in [0, 1] from the one on [-1, 1]: the substitution is linear.
    z = 0.5 * (nodes_j3[:, 2] + 1.0)
    scale = np.sqrt((1.0 - z**2) / (1.0 - nodes_j3[:, 2] ** 2))
    upper_jk = real_harmonics(np.column_stack([nodes_j3[:, :2] * scale[:, None], z]), degree)
    return upper_jk.T @ (0.5 * area_j[:, None] * upper_jk)


def dense_noise(directions_i3, degree, sphere=False):
    basis_ik = real_harmonics(directions_i3, degree)
    inverse_kk = np.linalg.inv(basis_ik.T @ basis_ik)
    area = (4 if sphere else 2) * np.pi
    return np.trace(inverse_kk @ hemisphere_products(degree, sphere)) / area, np.trace(inverse_kk)


@pytest.mark.parametrize(("degree", "sphere"), [(0, False), (2, False), (4, False), (3, True)])
def test_noise_is_the_trace(degree, sphere):
    directions = propose_lights("uniform", COUNT, degree, below=sphere)
    found = assess_lights(directions, degree, sphere=sphere)
    expected = dense_noise(directions, degree, sphere)
    np.testing.assert_allclose((found.image_noise, found.coefficient_noise), expected, rtol=1e-7)
    singular = np.linalg.svd(real_harmonics(directions, degree), compute_uv=False)
    assert found.condition == pytest.approx(singular[0] / singular[-1], rel=1e-9)
    assert found.n_light == COUNT


def test_noise_is_that_of_noisy_fits():
    degree, rng = 3, np.random.default_rng(1)
    directions = make_pattern("scattered", 40, seed=2)
    samples_ip = rng.standard_normal((40, 4000))
    coeffs_kp = reference_fit.least_squares(real_harmonics(directions, degree), samples_ip, np.ones(40))
    relit_jp = real_harmonics(make_pattern("uniform", 4000), degree) @ coeffs_kp
    found = assess_lights(directions, degree)
    # Of 4000 draws the mean square is known to about 2 / sqrt(4000 * 16); few directions carry most of it.
    assert found.image_noise == pytest.approx(np.mean(relit_jp**2), rel=0.08)
    assert found.coefficient_noise == pytest.approx(np.mean(np.sum(coeffs_kp**2, axis=0)), rel=0.08)


def test_twice_every_light_halves_the_noise():
    directions = make_pattern("uniform", 60)
    once, twice = (assess_lights(each, 5) for each in (directions, np.repeat(directions, 2, axis=0)))
    assert twice.image_noise == pytest.approx(0.5 * once.image_noise, rel=1e-9)
    assert twice.condition == pytest.approx(once.condition, rel=1e-9)


def test_too_few_lights_have_no_finite_noise():
    few = assess_lights(make_pattern("uniform", 15), 3)
    assert (few.condition, few.image_noise, few.coefficient_noise) == (math.inf, math.inf, math.inf)
    # Enough of them, but on rings: functions of high m are not seen.
    assert assess_lights(make_pattern("grid", 64), 6).image_noise == math.inf


@pytest.mark.parametrize("sphere", [False, True])
def test_greedy_takes_what_lowers_the_trace_most(sphere):
    degree = 2
    directions = propose_lights("uniform", COUNT, degree, below=sphere)
    basis_ik, products = real_harmonics(directions, degree), hemisphere_products(degree, sphere)
    chosen = choose_lights("greedy", directions, 14, degree, sphere=sphere)
    taken = []
    for light in chosen:
        # The information of the beginning is 1e-3 in functions that are orthonormal there, so 1e-3 G in these.
        def trace(i, taken=tuple(taken)):
            rows = basis_ik[[*taken, i]]
            return np.trace(np.linalg.inv(1e-3 * products + rows.T @ rows) @ products)

        traces = [math.inf if i in taken else trace(i) for i in range(COUNT)]
        assert traces[light] <= min(traces) * (1 + 1e-6)
        taken.append(int(light))
    assert len(set(taken)) == 14


@pytest.mark.parametrize("choice", CHOICES)
def test_choices_are_distinct_and_can_be_all(choice):
    directions = make_pattern("scattered", COUNT)
    for count in (1, 7, COUNT):
        chosen = choose_lights(choice, directions, count, 3, seed=4)
        assert len(set(chosen.tolist())) == count
        if choice != "every":
            np.testing.assert_array_equal(chosen, choose_lights(choice, directions, COUNT, 3, seed=4)[:count])
    np.testing.assert_array_equal(choose_lights("every", directions, 10, 3), np.arange(0, COUNT, 3))


def test_greedy_proposals_beat_the_patterns():
    noise = {p: assess_lights(propose_lights(p, 40, 4), 4).image_noise for p in ("greedy", "farthest", "uniform")}
    assert noise["greedy"] < noise["farthest"]
    assert noise["greedy"] < noise["uniform"]


@pytest.mark.parametrize("pattern", PROPOSALS)
def test_proposals_are_above_the_horizon(pattern):
    directions = propose_lights(pattern, 32, 3)
    assert directions.shape == (32, 3)
    assert directions[:, 2].min() > 0
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)


@pytest.mark.parametrize("pattern", ["uniform", "farthest", "greedy"])
def test_proposals_cover_the_sphere(pattern):
    directions = propose_lights(pattern, 32, 3, below=True)
    assert np.abs(directions.mean(axis=0)).max() < 0.1
    # On the sphere Y'Y is nearly n / (4 pi) times the identity, so the noise is nearly n_coeff / n_light.
    assert assess_lights(directions, 3, sphere=True).image_noise == pytest.approx(0.5, rel=0.15)


def test_measured_choices_never_see_the_held_out_lights():
    stack = make_stack(60, (2, 5, 3))
    (found,) = measure_choices(stack, [20], ["farthest"], ["uls", "cls"], 2, holdout=4)
    seen, held = split_lights(60, 4)
    chosen = seen[choose_lights("farthest", stack.directions_i3[seen], 20, 2)]
    samples_ip, basis_ik = samples_of(stack), real_harmonics(stack.directions_i3, 2)
    coeffs_kp = reference_fit.least_squares(basis_ik[chosen], samples_ip[chosen], np.ones(20))
    error = np.clip(basis_ik[held] @ coeffs_kp, 0, 1) - samples_ip[held]
    assert found.psnr["uls"] == pytest.approx(psnr.psnr(np.mean(error**2)), abs=1e-3)
    assert found.quality == assess_lights(stack.directions_i3[chosen], 2)
    (few,) = measure_choices(stack, [5], ["every"], ["uls", "cls"], 2)
    assert math.isnan(few.psnr["uls"])
    assert math.isfinite(few.psnr["cls"])
    with pytest.raises(InputError, match="49 lights cannot be chosen: the stack has 60, of which 12 are held out"):
        measure_choices(stack, [49], ["every"], ["cls"], 2)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    succeed("synth", "ring", folder / "ring.h5", "--size", 8, "--lights", 40)
    (folder / "given.lp").write_text("3\na b.png 0 0 2\nc.png 0.6 0 0.8\nd.png 0 0.6 0.8\n")
    (folder / "below.lp").write_text("2\na.png 0 0 1\nb.png 0 0 -1\n")
    return folder


def test_command_writes_what_it_proposes(tmp_path):
    told = succeed(
        "plan-lights", "--degree", 3, "--count", 24, "--pattern", "farthest,grid", tmp_path / "a.lp", "--json"
    )
    written = read_light_file(tmp_path / "a.lp")
    names, directions = written.names, written.directions_i3
    assert (len(names), len(set(names))) == (24, 24)
    np.testing.assert_allclose(directions, propose_lights("farthest", 24, 3), atol=1e-9)
    row = next(r for r in told.json["rows"] if (r["n_light"], r["pattern"]) == (24, "farthest"))
    assert row["image_noise"] == pytest.approx(assess_lights(propose_lights("farthest", 24, 3), 3).image_noise)
    assert {r["n_light"] for r in told.json["rows"]} == {16, 24, 36, 48, 96}


def test_command_chooses_from_given_lights(made, tmp_path):
    succeed("plan-lights", "--lights", made / "given.lp", "--degree", 0, "--count", 2, tmp_path / "b.lp")
    written = read_light_file(tmp_path / "b.lp")
    names, directions = written.names, written.directions_i3
    assert names[0] == "a b.png"
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-8)
    told = succeed("plan-lights", made / "ring.h5", "--degree", 2, "--counts", 20, "--measure", "--json").json
    assert [row["pattern"] for row in told["rows"]] == list(CHOICES)
    assert told["rows"][0]["psnr_holdout"].keys() == {"uls", "cls", "spline"}
    text = succeed("plan-lights", made / "ring.h5", "--degree", 2, "--counts", 20, "--measure", "--methods", "cls").out
    assert f"{told['rows'][0]['psnr_holdout']['cls']:.2f}" in text


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("--degree 16", "--degree"),
        ("--count 0", "--count"),
        ("--counts 0", "proposes 1 to 4096 lights, got 0"),
        ("--pattern star @o.lp", "pattern must be one of uniform, grid, scattered, farthest, greedy, got 'star'"),
        ("--pattern grid --count 13 @o.lp", "13 lights make no regular grid"),
        ("--pattern grid --below @o.lp", "grid is a pattern of the hemisphere"),
        ("--pattern farthest --counts 5000", "proposes 1 to 4096 lights, got 5000"),
        ("--pattern uniform --counts 2000000000", "proposes 1 to 4096 lights, got 2000000000"),
        ("--count 49 @o.lp", "--force replaces it"),
        ("ring.h5 --measure --below", "--below is for lights to propose or to assess"),
        ("@o.lp @p.lp", "at most one .lp file to write"),
        ("ring.h5 given.lp2", "at most one stack"),
        ("ring.h5 --lights given.lp", "give one of them"),
        ("ring.h5 --count 41 @o.lp", "can choose 1 to 40 lights, got 41"),
        ("ring.h5 --pattern grid @o.lp", "lights are chosen by one of farthest, greedy, every, random, got 'grid'"),
        ("--lights given.lp --count 2 given.lp", "that is the input"),
        ("--lights nowhere.lp", "cannot read nowhere.lp"),
        ("--lights below.lp", "light 1 of"),
        ("@no/o.lp", "there is no folder"),
        ("--measure", "--measure takes a stack"),
        ("ring.h5 --measure @o.lp", "leave out --count and OUT.lp"),
        ("ring.h5 --holdout 5", "--holdout is an option of --measure"),
        ("ring.h5 --measure --counts 33", "33 lights cannot be chosen: the stack has 40, of which 8 are held out"),
        ("ring.h5 --measure --counts 20 --methods magic", "unknown method 'magic'"),
        ("ring.h5 --measure --holdout 41", "holdout 41 keeps no light out of 40"),
        ("nowhere.h5", "there is no file nowhere.h5"),
    ],
)
def test_refusals(made, tmp_path, line, expected):
    words = [str(tmp_path / w[1:]) if w.startswith("@") else w for w in line.split()]
    words = [str(made / w) if (made / w).exists() else w for w in words]
    (tmp_path / "o.lp").write_text("precious")
    files = contents(tmp_path), contents(made)
    ended = call("plan-lights", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
    assert expected in ended.err
    assert (contents(tmp_path), contents(made)) == files
