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


@pytest.mark.parametrize(("target", "edges"), [("units", 300), ("subbands", 100)])
def test_a_fuzzer_finds_nothing(clang, tmp_path, target, edges):
    told = Campaign(3000, seconds=60, findings=tmp_path).run(target)
    assert told["findings"] == []
    assert told["executions"] > 300
    assert told["edges"] > edges


BREAKS = {
    "heap-buffer-overflow": ("d->at + 2 > d->end", "0"),
    "use-after-poison": ("(rows + 2) * PITCH; i += 16", "(rows + 9) * PITCH; i += 16"),
    "memory that nobody wrote": ("clear_sizes(work, band, rows);", ""),
    "shift exponent|signed integer overflow|an index": ("magnitude > MAX_MAGNITUDE >> shift", "0"),
}
"""What a fuzzer says of a decoder without one of its checks."""


@pytest.mark.parametrize("said", BREAKS)
def test_a_fuzzer_finds_what_is_broken(clang, tmp_path, said):
    sound, broken = BREAKS[said]

    def sabotage(source):
        assert sound in source
        return source.replace(sound, broken)

    told = Campaign(100_000, seconds=60, findings=tmp_path).run("units", sabotage)
    assert any(word in finding for word in said.split("|") for finding in told["findings"]), told
    assert list(tmp_path.iterdir())
