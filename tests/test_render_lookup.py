"""What an environment shows in a direction is the texel that lies there."""

import numpy as np
import pytest

from clrelight.lighting.environment import Environment
from clrelight.lighting.lookup import look_up
from tests.rendering import unit

SHAPES = {"latlong": (12, 24), "angular": (16, 16), "cube": (48, 8)}


@pytest.mark.parametrize("layout", SHAPES)
@pytest.mark.parametrize("axes", ["z-up", "probe", "camera", "left,forward,up"])
def test_at_the_centre_of_a_texel_is_that_texel(layout, axes):
    values = np.random.default_rng(0).random((*SHAPES[layout], 3), np.float32)
    environment = Environment(values, layout, axes)
    directions, weights = environment.geometry()
    found = look_up(environment, directions)
    used = weights > 0
    np.testing.assert_allclose(found[used], values.reshape(-1, 3)[used], atol=1e-5)


@pytest.mark.parametrize("layout", SHAPES)
def test_between_texels_a_slow_function_is_near(layout):
    shape = tuple(8 * side for side in SHAPES[layout])
    blank = Environment(np.ones((*shape, 1), np.float32), layout)
    directions, _ = blank.geometry()
    slow = (2 + directions @ unit([1, 2, 3])).astype(np.float32).reshape(*shape, 1)
    anywhere = unit(np.random.default_rng(1).standard_normal((4000, 3)))
    found = look_up(Environment(slow, layout), anywhere)[:, 0]
    assert np.abs(found - (2 + anywhere @ unit([1, 2, 3]))).max() < 0.06
