"""Single bytes of klt 4 changed: see tests/byte_changes.py, which tries all values."""

import pytest

from tests.byte_changes import change_bytes, small_payloads


@pytest.fixture(scope="module")
def payloads(device):
    return small_payloads(device)


def test_payloads_are_of_all_kinds(payloads):
    kinds = " ".join(payloads)
    assert all(kind in kinds for kind in ("perceptual", "srgb", "(81,", ", 1) {", ", 3) {", ", 4) {", "600"))


@pytest.mark.parametrize("kind", ["(1, 9, 14, 1)", "(81, 5, 6, 3)", "(64, 33, 2, 1)"])
def test_no_changed_byte_is_taken(device, payloads, kind):
    (payload,) = [content for name, content in payloads.items() if kind in name]
    tally = change_bytes(kind, payload, device, values=2)
    assert tally.failures == []
    assert tally.counts["refused"] == tally.counts["changes"] > 3 * len(payload)
