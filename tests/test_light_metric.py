"""What errors cost where lights are, against sums over directions in float64; and what that is worth in bytes."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, encode
from clrelight.codec.transforms.light_metric import light_root, light_weights
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import quantise_axes
from clrelight.codec.transforms.whitening import AXES
from clrelight.dataset import CoefficientMap
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.sampling import make_pattern

DEGREE, N_COEFF = 5, 36


def cap_of(lights: int, lowest: float) -> np.ndarray:
    """Return lights that share a cap around the zenith."""
    around, up = 2.4 * np.arange(lights), 1.0 - (1.0 - lowest) * (np.arange(lights) + 0.5) / lights
    radius = np.sqrt(1.0 - up**2)
    return np.stack([radius * np.cos(around), radius * np.sin(around), up], axis=1)


def test_weights_are_as_large_as_solid_angles_and_follow_the_lights() -> None:
    nodes_n3, weight_n = product_rule(20)
    cost_n = light_weights(nodes_n3, weight_n, cap_of(40, 0.8))
    assert cost_n.sum() == pytest.approx(weight_n.sum())
    ratio_n = cost_n / weight_n
    assert ratio_n[nodes_n3[:, 2] > 0.9].min() > 2.0
    assert ratio_n[nodes_n3[:, 2] < 0.2].max() < 0.1
    assert ratio_n.min() >= 0.0199


def test_even_lights_leave_the_hemisphere_as_it_is() -> None:
    nodes_n3, weight_n = product_rule(20)
    ratio_n = light_weights(nodes_n3, weight_n, make_pattern("uniform", 200)) / weight_n
    assert 0.95 < ratio_n.min() < ratio_n.max() < 1.05


@pytest.mark.parametrize("lights_i3", [None, np.array([[0.0, 0.0, 1.0]] * 3), cap_of(30, 0.5) * [1, 1, -1]])
def test_where_nothing_is_known_all_the_hemisphere_costs_alike(lights_i3) -> None:
    metric = hemisphere_metric(N_COEFF, AXES)
    assert np.array_equal(light_root(metric, "sh", lights_i3), np.eye(len(metric.forward_jk)))


def test_the_root_gives_what_an_error_costs_over_directions() -> None:
    lights_i3, metric = cap_of(25, 0.6), hemisphere_metric(N_COEFF, AXES)
    error_k = np.random.default_rng(0).standard_normal(N_COEFF)
    nodes_n3, weight_n = product_rule(16)
    cost_n = light_weights(nodes_n3, weight_n, lights_i3)
    expected = cost_n @ (evaluate_basis(nodes_n3, DEGREE) @ error_k) ** 2
    root_nn = light_root(metric, "sh", lights_i3)
    assert np.array_equal(root_nn, np.triu(root_nn))
    assert ((root_nn @ metric.forward_jk @ error_k) ** 2).sum() == pytest.approx(expected, rel=1e-6)


def test_entries_make_up_for_each_others_rounding() -> None:
    rng = np.random.default_rng(1)
    root_nn = light_root(hemisphere_metric(N_COEFF, AXES), "sh", cap_of(40, 0.8))
    vectors_jd = np.linalg.qr(rng.standard_normal((108, 108)))[0][:20] @ np.kron(np.eye(3), np.linalg.inv(root_nn).T)

    def cost(axes) -> float:
        errors_jcn = (axes.vectors_jd - vectors_jd).reshape(20, 3, -1)
        return float(((errors_jcn @ root_nn.T) ** 2).sum())

    chosen = quantise_axes(vectors_jd, np.full(20, 1.0), 10_000, 0.1, root_nn)
    exact = vectors_jd * np.exp2(chosen.scales_j[:, None] / 4)
    alone = np.sign(exact) * np.floor(np.abs(exact) + 0.3)
    assert cost(chosen) < 0.7 * cost(replace(chosen, entries_jd=alone.astype(np.int64)))


def test_lights_in_a_cap_are_shown_better_at_the_same_bytes(device) -> None:
    rng, lights_i3 = np.random.default_rng(2), cap_of(40, 0.75)
    rough_hwk = rng.standard_normal((48, 48, N_COEFF)).cumsum(axis=0).cumsum(axis=1)
    coeffs_khwc = np.ascontiguousarray(rough_hwk.transpose(2, 0, 1)[..., None] / 500.0, np.float32)
    codec, basis_ik = codec_class("klt").from_config({"rate": 0.5}), evaluate_basis(lights_i3, DEGREE)

    def error(lights_i3: np.ndarray | None) -> float:
        encoded = encode(coeffs_khwc, codec, device, lights_i3=lights_i3)
        wrong_kp = (decode(encoded.to_bytes(), device).astype(np.float64) - coeffs_khwc).reshape(N_COEFF, -1)
        return float(((basis_ik @ wrong_kp) ** 2).mean())

    assert error(lights_i3) < 0.6 * error(None)


def test_lights_of_a_fit_are_those_of_its_directions(device) -> None:
    given = CoefficientMap(np.zeros((4, 2, 2, 1), np.float32), 1, "uls", 1.0, "linear", cap_of(5, 0.5))
    assert np.array_equal(given.fitted_lights, given.directions_i3)
