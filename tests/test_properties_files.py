"""What is stored comes back, and what is typed is understood or refused in one line."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from clrelight.store import open_stack, write_stack
from tests.commands import call

FIXED = settings(derandomize=True, deadline=None, database=None)
NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=12)


@settings(FIXED, max_examples=25)
@given(
    shape=st.tuples(*[st.integers(1, 6)] * 3, st.integers(1, 4)),
    dtype=st.sampled_from(["uint8", "uint16", "float16", "float32"]),
    peak=st.floats(1e-37, 1e37),
    transfer=st.sampled_from(["linear", "srgb"]),
    name=NAMES,
    masked=st.booleans(),
    seed=st.integers(0, 99),
)
def test_stacks_come_back(shape, dtype, peak, transfer, name, masked, seed):
    rng = np.random.default_rng(seed)
    images = (rng.random(shape) * 200).astype(dtype)
    mask = rng.random(shape[1:3]) < 0.5 if masked else None
    stack = LightStack(images, make_pattern("uniform", shape[0]), peak, transfer, rng.random(shape[0]), mask, name)
    with tempfile.TemporaryDirectory() as folder:
        write_stack(Path(folder) / "s.h5", stack)
        with open_stack(Path(folder) / "s.h5") as found:
            np.testing.assert_array_equal(found.images_ihwc[:], images)
            np.testing.assert_array_equal(found.directions_i3, stack.directions_i3)
            np.testing.assert_array_equal(found.weights_i, stack.weights_i)
            assert (found.mask_hw is None) == (mask is None)
            if mask is not None:
                np.testing.assert_array_equal(found.mask_hw, mask)
            assert (found.peak, found.transfer, found.name) == (peak, transfer, name)
            assert found.images_ihwc.dtype == images.dtype


WORDS = st.one_of(
    st.text(max_size=8),
    st.floats().map(str),
    st.integers().map(str),
    st.sampled_from(["auto", "cls", "1e400", "-0", "0x10", "1,2", "½", "--", "-", "NaN"]),
)
OPTIONS = ["--degree", "--energy", "--holdout", "--iterations", "--lam", "--memory", "--method", "--per", "--solver"]


@settings(FIXED, max_examples=120)
@given(option=st.sampled_from(OPTIONS), word=WORDS)
def test_options_of_fit_are_understood_or_refused_in_one_line(option, word):
    # There is no such stack, so that what is understood ends at the file.
    with tempfile.TemporaryDirectory() as folder:
        ended = call("fit", f"{folder}/none.h5", f"{folder}/out.h5", f"{option}={word}")
        assert list(Path(folder).iterdir()) == []
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert ended.err.startswith("clrelight")


@settings(FIXED, max_examples=60)
@given(words=st.lists(WORDS.filter(lambda word: word not in ("-h", "--help")), min_size=1, max_size=4))
def test_any_words_are_refused_in_one_line(words):
    ended = call("relight", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
