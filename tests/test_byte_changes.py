"""Single bytes of klt 4 changed: see tests/byte_changes.py, which tries all values."""

import pytest

from tests.byte_changes import CASES, change_bytes
from tests.mutations import make_units


def test_payloads_are_of_all_kinds():
    kinds = " ".join(CASES)
    assert all(kind in kinds for kind in ("perceptual", "srgb", "(81,", ", 1) {", ", 3) {", ", 4) {", "600"))


@pytest.mark.parametrize("kind", ["(1, 9, 14, 1)", "(1, 1, 1, 1)", "(81, 5, 6, 3)"])
def test_no_changed_byte_is_taken(device, kind):
    (number,) = [number for name, number in CASES.items() if kind in name]
    payload = make_units(number, device)
    tally = change_bytes(kind, payload, device, values=2)
    assert tally.failures == []
    assert tally.counts["refused"] == tally.counts["changes"] > 2 * len(payload)
