"""Fits and codecs of any small stack keep what they promise. Examples are the same in every run."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clrelight.codec import codec_class, decode, encode
from clrelight.codec.encoded import Encoded
from clrelight.dataset import LightStack
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.reference import fit as reference
from tests.stacks import columns_of, samples_of

FIXED = settings(derandomize=True, deadline=None, database=None)


@st.composite
def stacks(draw):
    """Return stacks of up to 30 lights in caps of any radius, with samples of any brightness."""
    count, radius = draw(st.integers(1, 30)), draw(st.sampled_from([1.0, 0.5, 0.1, 0.01]))
    lights = make_pattern("uniform", count) * [radius, radius, 1.0]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    samples = st.floats(0, 1, width=32)
    column = st.lists(samples, min_size=count, max_size=count)
    columns = np.array(draw(st.lists(column, min_size=1, max_size=3)), np.float32).T
    scale = np.float32(10.0 ** draw(st.integers(-25, 25)))
    return LightStack((columns * scale)[:, None, :, None], lights, 1.0)


@settings(FIXED, max_examples=25)
@given(stack=stacks(), method=st.sampled_from(["cls", "ceb"]), degree=st.sampled_from([0, 1, 3]))
def test_the_bound_holds(stack, method, degree):
    found_kp = columns_of(fit(stack, method, degree))
    assert np.isfinite(found_kp).all()
    energy_p = reference.bound(samples_of(stack), np.ones(stack.n_light))
    # Coefficients near float32's least are whole multiples of it.
    assert (np.sum(found_kp**2, axis=0) <= energy_p * (1 + 1e-5) + len(found_kp) * 2.0**-140 * np.sqrt(energy_p)).all()


@settings(FIXED, max_examples=20)
@given(stack=stacks(), method=st.sampled_from(["cls", "ceb", "project"]), power=st.integers(-15, 15))
def test_powers_of_two(stack, method, power):
    plain = fit(stack, method, 3).coeffs_khwc
    scaled = fit(LightStack(np.ldexp(stack.images_ihwc, power), stack.directions_i3, 1.0), method, 3).coeffs_khwc
    normal = np.abs(plain) > 1e-30
    np.testing.assert_array_equal(scaled[normal], np.ldexp(plain, power)[normal])


@settings(FIXED, max_examples=25)
@given(stack=stacks(), position=st.data(), bad=st.sampled_from([np.nan, np.inf, -np.inf, -1.0, -1e-40]))
def test_one_bad_sample_is_named(stack, position, bad):
    light = position.draw(st.integers(0, stack.n_light - 1))
    column = position.draw(st.integers(0, stack.image_shape[1] - 1))
    images = stack.images_ihwc.copy()
    images[light, 0, column, 0] = bad
    try:
        fit(LightStack(images, stack.directions_i3, 1.0), "cls", 2)
    except InputError as error:
        message = str(error)
    assert message.startswith(f"image {light} is ")
    assert f"row 0, column {column}, channel 0" in message


SHAPES = st.tuples(st.sampled_from([1, 4, 9]), st.integers(1, 9), st.integers(1, 9), st.sampled_from([1, 3]))
NEAR = {"uniform": 0.02, "wavelet": 1.0, "s3tc": 2.0, "whitened": 2.0}
"""How far a value may be off, as a part of the map's largest; of four colours in a block, only that it ends."""


@settings(FIXED, max_examples=40)
@given(shape=SHAPES, seed=st.integers(0, 99), exponent=st.integers(-30, 30), codec=st.sampled_from(sorted(NEAR)))
def test_codecs_give_back_what_is_near(shape, seed, exponent, codec):
    device = open_device()
    coeffs = (np.random.default_rng(seed).standard_normal(shape) * 10.0**exponent).astype(np.float32)
    made = codec_class(codec).from_config({"rate": 400.0} if codec == "wavelet" else {})
    payload = encode(coeffs, made, device).to_bytes()
    found = decode(Encoded.from_bytes(payload), device)
    assert found.shape == shape
    assert np.abs(found.astype(np.float64) - coeffs).max() <= NEAR[codec] * np.abs(coeffs).max()


@settings(FIXED, max_examples=40)
@given(shape=SHAPES, seed=st.integers(0, 99))
def test_halves_are_the_nearest(shape, seed):
    device = open_device()
    rng = np.random.default_rng(seed)
    coeffs = (rng.standard_normal(shape) * 10.0 ** rng.uniform(-9, 4, shape)).astype(np.float32)
    coeffs.flat[0] = 1.0
    found = decode(encode(coeffs, codec_class("half")(), device), device)
    np.testing.assert_array_equal(found, coeffs.astype(np.float16).astype(np.float32))
