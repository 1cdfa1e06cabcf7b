"""Which codec is meant where none is named, and what to do where memory does not hold one."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.codec import codec_class
from clrelight.errors import InputError
from clrelight.jobs.coding_request import advise_codecs, read_request
from tests.commands import call, contents, succeed
from tests.test_store_nexus import make_fit


@pytest.mark.parametrize(
    ("options", "basis", "codec"),
    [
        ({}, "sh", "s3tc"),
        ({"rate": 0.2}, "sh", "klt"),
        ({"step": 0.01}, "sh", "klt"),
        ({"rate": None, "transfer": "srgb"}, "sh", "klt"),
        ({"metric": "perceptual"}, "sh", "klt"),
        ({}, "klt", "klt"),
        ({"rate": 0.2}, "klt", "klt"),
        ({"planes": 4}, "klt", "s3tc"),
        ({}, "whitened", "s3tc"),
        ({"rate": 1.0}, "whitened", "wavelet"),
    ],
)
def test_a_codec_that_is_not_named_follows_from_what_is_asked(options, basis, codec):
    request = read_request(None, basis, None, None, False, options)
    assert request.codec == codec
    request.make((4, 8, 8, 3))


@pytest.mark.parametrize(("budget", "target"), [(2000, None), (None, 30.0)])
def test_a_size_or_a_quality_is_met_by_klt(budget, target):
    assert read_request(None, "sh", budget, target, True, {}).codec == "klt"


@pytest.mark.parametrize(
    ("options", "basis", "named"),
    [
        ({"bits": 4}, "sh", ["uniform", "vq", "cpca"]),
        ({"clusters": 4}, "sh", ["cpca"]),
        ({"allocation": "global"}, "sh", ["wavelet"]),
        ({"allocation": "global", "rate": 1.0}, "sh", ["wavelet"]),
        ({"clamp": True}, "sh", ["half", "bc6h"]),
        ({"planes": 3, "rate": 1.0}, "klt", ["wavelet", "jpeg2000"]),
    ],
)
def test_options_of_other_codecs_name_those_to_add(options, basis, named):
    with pytest.raises(InputError) as refused:
        read_request(None, basis, None, None, False, options)
    told = str(refused.value)
    assert told.endswith("add " + " or ".join(f"--codec {name}" for name in named))
    for name in named:  # what is advised is taken
        read_request(name, basis, None, None, False, options)


def test_options_of_no_one_codec_are_refused():
    with pytest.raises(InputError, match="no codec has all of --bits, --rate"):
        read_request(None, "sh", None, None, False, {"bits": 4, "rate": 1.0})


SHAPE = (49, 512, 512, 3)


@pytest.mark.parametrize("refused", ["klt", "wavelet", "vq"])
def test_what_takes_less_than_the_budget_is_advised_and_the_codec_itself_never(refused):
    memory, codec = 50 << 20, codec_class(refused).from_config({})
    needed = codec.bytes_to_encode(SHAPE)
    told = advise_codecs(codec, SHAPE, memory)
    budget, _, names = told.partition(", or --codec ")
    assert needed <= int(budget.removeprefix("give --memory ").removesuffix("MiB")) << 20 < needed + (1 << 20)
    named = names.replace(" or ", ", ").split(", ")
    assert "s3tc" in named
    for name in named:
        assert codec_class(name).from_config({}).bytes_to_encode(SHAPE) <= memory
    assert refused not in named


def test_a_codec_that_memory_does_not_hold_is_refused_in_one_line(tmp_path):
    fitted = make_fit(3)
    wide = np.tile(fitted.coeffs_khwc, (1, 16, 16, 1))
    cr.write_fit(tmp_path / "fit.h5", cr.CoefficientMap(wide, 1, "uls", 1.0, "linear", fitted.directions_i3))
    before = contents(tmp_path)
    ended = call("encode", tmp_path / "fit.h5", tmp_path / "e.h5", "--codec", "klt", "--memory", "400k")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "encoding by klt takes" in ended.err
    assert "klt" not in ended.err.partition("--codec")[2]
    assert contents(tmp_path) == before
    succeed("encode", tmp_path / "fit.h5", tmp_path / "e.h5", "--codec", "uniform", "--memory", "400k")


def test_a_rate_alone_is_a_command(tmp_path):
    cr.write_fit(tmp_path / "fit.h5", make_fit(3))
    told = succeed("encode", tmp_path / "fit.h5", tmp_path / "e.h5", "--rate", "8", "--json").json
    assert told["codec"] == "klt"
    assert cr.encode(make_fit(3), rate=8.0).codec == "klt"
