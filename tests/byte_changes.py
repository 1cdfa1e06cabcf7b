"""Every byte of payloads of klt 4 changed, one at a time: each change must be refused.

``python -m tests.byte_changes --values 255`` changes each byte of small payloads to every other value. Each change is
made twice: in the whole payload, which its checksum guards, and in the body alone, as a reader of regions takes it,
which looks at the checksums of the tables, of the index and of each unit.
"""

import math

import numpy as np
from click import IntRange, command, option

from clrelight.codec import Encoded, decode
from clrelight.device import open_device
from clrelight.errors import PayloadError
from tests import campaign
from tests.campaign import Tally
from tests.mutations import UNITS_CASES, make_units

CASES = {
    f"{shape} {options}": number
    for number, (shape, options) in enumerate(UNITS_CASES)
    if math.prod(shape) < 8000 or "600" in str(shape)
}
"""Of `tests.mutations` those that are small, and one with many streams."""


def change_bytes(name, payload, device, values, seed=1):
    """Change every byte to so many other values, in the payload and in its body; return the tally."""
    tally = Tally("changes", "refused")
    original = Encoded.from_bytes(payload)
    expected = decode(payload, device)
    rng = np.random.default_rng(seed)
    front = len(payload) - len(original.body)
    for at in range(len(payload)):
        others = (payload[at] + 1 + rng.permutation(255)[:values]) % 256
        for value in others.tolist():
            changed = payload[:at] + bytes([value]) + payload[at + 1 :]
            ways = {"payload": changed}
            if at >= front:
                ways["body"] = Encoded(original.codec, {}, original.shape, changed[front:])
            for way, given in ways.items():
                tally.run(
                    f"{name}: byte {at} of its {way} is {value}",
                    lambda given=given: _refuse(given, device),
                    first="changes",
                )
    np.testing.assert_array_equal(decode(payload, device), expected)
    return tally


def _refuse(given, device):
    try:
        decode(given, device)
    except PayloadError:
        return ["refused"]
    raise AssertionError("it was decoded")


@command()
@option("--values", type=IntRange(1, 255), default=255, show_default=True, help="Other values of each byte.")
@option("--seed", type=IntRange(min=0), default=1, show_default=True, help="Which values, where they are not all.")
@option("--only", metavar="TEXT", default="", help="Only payloads whose shape and options hold TEXT.")
def main(values, seed, only):
    """Change every byte of small payloads; print one JSON object for each payload, exit 1 on a failure."""
    device = open_device("cpu")
    tallies = (
        (name, change_bytes(name, make_units(number, device), device, values, seed))
        for name, number in CASES.items()
        if only in name
    )
    campaign.conclude("payload", tallies)


if __name__ == "__main__":
    main(prog_name="python -m tests.byte_changes")
