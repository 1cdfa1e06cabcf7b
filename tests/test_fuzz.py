"""Compiled decoders under clang's fuzzer, where there is a clang: see tests/fuzz."""

import pytest

from tests.fuzz.__main__ import Campaign
from tests.fuzz.build import NoCompilerError, find_clang


@pytest.fixture
def clang():
    try:
        return find_clang()
    except NoCompilerError as error:
        pytest.skip(str(error))


def test_a_fuzzer_finds_nothing(clang, tmp_path):
    told = Campaign(3000, seconds=60, findings=tmp_path).run("units")
    assert told["findings"] == []
    assert told["executions"] > 300
    assert told["edges"] > 200  # the decoder by masks has some 280
