"""Damaged payloads of every codec, in a process whose memory and time are bounded: see tests/mutations.py."""

import json
import subprocess
import sys

import numpy as np
import pytest

from clrelight.codec import Encoded, decode_view
from clrelight.codec.factored import WhitenedMaps
from clrelight.errors import PayloadError
from tests.commands import ROOT, environment
from tests.mutations import families


def test_no_decoder_crashes_hangs_or_fills_memory():
    command = [sys.executable, "-m", "tests.mutations", "--count", "2000", "--seed", "7"]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    tallies = [json.loads(line) for line in done.stdout.splitlines()]
    assert [tally["family"] for tally in tallies] == families()
    assert sum(tally["payloads"] for tally in tallies) > 1900
    # Some of all sorts: refused by their checksum or by the decoder, and decoded all the same.
    assert all(0 < tally["unsealed"] < tally["refused"] < tally["payloads"] for tally in tallies)
    assert all(tally["decoded"] > 0 for tally in tallies)


def test_a_view_of_an_unknown_codec_is_refused_as_its_coefficients_are(device):
    with pytest.raises(PayloadError, match="'zip'"):
        decode_view(Encoded("zip", {}, (1, 1, 1, 1), b"\0\0"), device)


def test_a_view_that_is_not_finite_is_refused(device):
    maps = WhitenedMaps(np.full((1, 2, 2, 1), 3e38, np.float32), np.array([[10.0]]))
    with pytest.raises(PayloadError, match="finite"):
        maps.relight(np.array([[0.0, 0.0, 1.0]]), device)
