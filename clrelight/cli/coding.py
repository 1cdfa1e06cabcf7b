"""``clrelight encode`` and ``decode``."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.coding_parts import check_memory, decode_again, encode_source, fits, take_source
from clrelight.cli.options import ByteCount, device_option, given, json_option, memory_option
from clrelight.cli.output import decibel, print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import measure, psnr_lines
from clrelight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clrelight.codec import Codec, Encoded


_MAX_DECIBELS = 1000.0
_IN_PARTS = "half, s3tc, bc6h, uniform, wavelet and jpeg2000 take parts"
_TARGET_HOLDS = 5
"""Times the bytes of a map that a search for a quality takes at least."""


@click.command()
@click.argument("fit_file", metavar="FIT", type=click.Path())
@click.argument("out", type=click.Path())
@click.option("--codec", help="half, s3tc, bc6h, uniform, wavelet, jpeg2000, vq, cpca or klt; default s3tc, or klt.")
@click.option(
    "--basis",
    type=click.Choice(["sh", "whitened", "klt"]),
    default="sh",
    show_default=True,
    help="Coordinates that are coded: as fitted; in the metric of the image; its principal axes.",
)
@click.option("--bytes", "byte_budget", type=ByteCount(), metavar="BYTES", help="Use no more (klt, wavelet, jpeg2000).")
@click.option("--target-psnr", type=float, metavar="DB", help="Fewest bytes for this pooled PSNR; needs --stack.")
@click.option("--rate", type=float, help="Bits per coefficient (wavelet, jpeg2000: default 4; klt: default 0.1).")
@click.option("--step", type=float, help="Quantiser step, instead of a rate (klt).")
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    help="Errors are alike in radiance, or in sRGB code values (klt); default: what the fit's stack holds.",
)
@click.option("--bits", type=int, help="Bits per code (uniform, cpca), log2 of the codebook (vq); default 8.")
@click.option("--allocation", help="How wavelet rates are shared: map (each alike) or global (one step for all).")
@click.option("--levels", type=int, help="Levels of the wavelet transform (wavelet); default 3.")
@click.option("--clusters", type=int, help="Clusters of pixels (cpca); default 16.")
@click.option("--components", type=int, help="Axes of a cluster (cpca); default 8.")
@click.option("--planes", type=int, help="Principal axes kept (basis klt); default: all but 1e-4 of the energy.")
@click.option("--block", type=int, help="Side of the coded blocks, 0 for pixels (vq); default 0.")
@click.option("--clamp", is_flag=True, default=None, help="Clamp what a half float cannot hold (half, bc6h).")
@click.option("--stack", type=click.Path(), help="Measure PSNR of the decoded result against this stack.")
@memory_option("256MiB", "parts of the map")
@device_option
@json_option
@click.pass_context
def encode(
    context: click.Context,
    fit_file: str,
    out: str,
    codec: str | None,
    basis: str,
    byte_budget: int | None,
    target_psnr: float | None,
    stack: str | None,
    memory: int,
    device: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Compress the coefficients of a fit.

    A target is met at the lights of the stack that the fit has not seen, where there are any, else at those it has.
    Maps that --memory does not hold are taken in parts, beside a temporary copy on the disk of OUT.

    \b
    Example:
      clrelight encode fit.h5 enc.h5 --codec wavelet --rate 1 --stack stack.h5
      clrelight encode fit.h5 enc.h5 --bytes 20k
      clrelight encode fit.h5 enc.h5 --target-psnr 31 --stack stack.h5
    """
    from clrelight import codec as codecs
    from clrelight.device import open_device
    from clrelight.experiment.noise import coding_psnr, predicted_psnr
    from clrelight.experiment.target import encode_to_quality
    from clrelight.store import check_output, open_fit, open_stack, write_encoded
    from clrelight.store.scratch import scratch_room

    if target_psnr is not None and not abs(target_psnr) <= _MAX_DECIBELS:
        raise InputError(f"--target-psnr must be a number of decibels, got {target_psnr}")
    wanted = given(**options)
    if target_psnr is not None and (
        stack is None
        or byte_budget is not None
        or wanted
        or basis == "whitened"
        or (basis == "klt" and codec not in (None, "klt"))
    ):
        raise InputError("--target-psnr needs --stack to measure against, and no other size or option beside it")
    if byte_budget is not None and ("rate" in wanted or "step" in wanted):
        raise InputError("--bytes says the size already, leave out --rate and --step")
    codec = codec or ("klt" if basis == "klt" or byte_budget or target_psnr is not None else "s3tc")
    if byte_budget is not None and not hasattr(codecs.codec_class(codec), "rate"):
        raise InputError(f"--bytes: what {codec} takes follows from its options; klt, wavelet and jpeg2000 meet a size")
    if target_psnr is None and byte_budget is None:
        _choose(codec, basis, wanted)  # says what is wrong before the fit is read
    check_output(out, [fit_file] if stack is None else [fit_file, stack])
    opened = open_device(device)
    asked = context.get_parameter_source("memory") is click.core.ParameterSource.COMMANDLINE
    seconds: dict[str, float] = {}
    notes: list[str] = []
    noise = None
    with open_fit(fit_file) as coefficients, scratch_room(Path(out).parent, memory) as room:
        shape = tuple(coefficients.coeffs_khwc.shape)
        since = time.perf_counter()
        if target_psnr is not None and stack is not None:
            needed = _TARGET_HOLDS * 4 * math.prod(shape)
            notes += check_memory(f"encoding to a quality by {codec}", needed, memory, asked, f"without it {_IN_PARTS}")
            _say(notes, as_json)
            coefficients = coefficients.to_float32()
            seconds["read"] = time.perf_counter() - since
            since = time.perf_counter()
            with open_stack(stack) as source:
                encoded, trials, why = encode_to_quality(coefficients, source, target_psnr, codec=codec, device=opened)
            told = [f"tried {t.byte_count} bytes: {t.psnr:.2f} dB" for t in trials]
            told += [f"took {encoded.encoded_bytes} bytes: {why}", *source.notes]
        else:
            if byte_budget is not None:
                key, value = (
                    ("byte_budget", byte_budget) if codec == "klt" else ("rate", 8.0 * byte_budget / math.prod(shape))
                )
                wanted[key] = value
            chosen = _choose(codec, basis, wanted).for_transfer(coefficients.transfer)
            notes += check_memory(f"encoding by {chosen.id}", chosen.bytes_to_encode(shape), memory, asked, _IN_PARTS)
            _say(notes, as_json)
            told = []
            maps = take_source(coefficients, chosen, opened, room)
            seconds["read"] = time.perf_counter() - since
            since = time.perf_counter()
            with progress_bar(f"encoding {codec}") as room.progress:
                noise = codecs.predict_noise_of(maps, chosen)
                seconds["predict"] = time.perf_counter() - since
                since = time.perf_counter()
                encoded = encode_source(maps, chosen, room)
        seconds["encode"] = time.perf_counter() - since
        facts = {"file": out, **_size_facts(encoded), "config": dict(encoded.config), "device": opened.info.label}
        facts["coding_noise"] = predicted_psnr(noise)
        if stack is not None:
            with open_stack(stack) as source:
                with progress_bar("decoding") as room.progress:
                    since = time.perf_counter()
                    decoded = decode_again(encoded, coefficients, opened, room)
                    seconds["decode"] = time.perf_counter() - since
                since = time.perf_counter()
                facts["coding_noise"] = coding_psnr(noise, coefficients.coeffs_khwc, decoded.coeffs_khwc)
                facts["psnr"] = measure(decoded, source, opened)
                told += [note for note in source.notes if note not in told]
                seconds["measure"] = time.perf_counter() - since
        facts["notes"] = notes + told
        since = time.perf_counter()
        write_encoded(out, encoded, coefficients)
        seconds["write"] = time.perf_counter() - since
    facts["seconds"] = seconds
    if as_json:
        print_json(facts)
        return
    clamped = int(encoded.info.get("clamped", 0))
    print_notes(told + ([f"{clamped} coefficients were clamped"] if clamped else []))
    print_facts(
        {
            "encoded": out,
            **_size_lines(encoded),
            **_noise_line(facts["coding_noise"]),
            **psnr_lines(facts.get("psnr")),
            "time": seconds_line(seconds),
        }
    )


@click.command()
@click.argument("encoded_file", metavar="ENC", type=click.Path())
@click.argument("out", type=click.Path())
@memory_option("256MiB", "parts of the map")
@device_option
@json_option
@click.pass_context
def decode(context: click.Context, encoded_file: str, out: str, memory: int, device: str | None, as_json: bool) -> None:
    """Turn an encoded file back into a fit.

    \b
    Example:
      clrelight decode enc.h5 decoded.h5
    """
    from clrelight.codec import bytes_to_decode, decode_stream
    from clrelight.codec.streams import Room
    from clrelight.device import open_device
    from clrelight.store import check_output
    from clrelight.store.coding import RowTarget
    from clrelight.store.encodings import create_decoded, stage_encoded
    from clrelight.store.scratch import scratch_room
    from clrelight.streaming import writing_behind

    check_output(out, [encoded_file])
    opened = open_device(device)
    asked = context.get_parameter_source("memory") is click.core.ParameterSource.COMMANDLINE
    seconds: dict[str, float] = {}
    since = time.perf_counter()
    with scratch_room(Path(out).parent, memory) as room:
        encoded, record = stage_encoded(encoded_file, room)
        seconds["read"] = time.perf_counter() - since
        notes = check_memory(f"decoding {encoded.codec}", bytes_to_decode(encoded), memory, asked)
        _say(notes, as_json)
        with create_decoded(out, encoded, record) as sink:

            def write(rows: tuple[int, NDArray[np.float32]]) -> None:
                sink.write_rows(*rows, None, None)

            since = time.perf_counter()
            with (
                progress_bar(f"decoding {encoded.codec}") as room.progress,
                writing_behind(write) as put,
            ):

                def hand_on(first: int, coeffs_khwc: NDArray[np.float32]) -> None:
                    put((first, coeffs_khwc))

                target = RowTarget(
                    encoded.shape,
                    opened,
                    Room() if fits(room, encoded.shape) else room,
                    hand_on,
                    codec_id=encoded.codec,
                    row_step=sink.coeffs_khwc.chunks[1],
                )
                decode_stream(encoded, target, opened)
                seconds["decode"] = time.perf_counter() - since
                since = time.perf_counter()
        seconds["write"] = time.perf_counter() - since
    if as_json:
        facts = {"file": out, **_size_facts(encoded), "notes": notes, "seconds": seconds}
        print_json({**facts, "device": opened.info.label})
        return
    print_facts({"fit": out, **_size_lines(encoded), "time": seconds_line(seconds)})


def _say(notes: list[str], as_json: bool) -> None:
    # Before the work begins; a JSON object holds them at its end.
    if not as_json:
        print_notes(notes)


def _choose(codec: str, basis: str, options: dict[str, Any]) -> Codec:
    """Return the codec in a basis; InputError where the two do not go together."""
    from clrelight.codec import codec_class

    options = dict(options)
    if basis == "whitened":
        return codec_class("whitened").from_config({"codec": codec, "options": options})
    planes = options.pop("planes", None)
    if basis == "klt" and codec != "klt":
        config = {"codec": codec, "options": options, "planes": planes}
        return codec_class("principal").from_config(config)
    if planes is not None:
        raise InputError("--planes is for --basis klt with a codec other than klt, which chooses its own")
    return codec_class(codec).from_config(options)


def _size_facts(encoded: Encoded) -> dict[str, Any]:
    return {
        "codec": encoded.codec,
        "encoded_bytes": encoded.encoded_bytes,
        "bits_per_coefficient": encoded.bits_per_coefficient,
        **encoded.info,
    }


def _noise_line(noise: dict[str, float]) -> dict[str, str]:
    words = {"coding_psnr_predicted": "predicted", "coding_psnr": "measured"}
    known = [f"{decibel(noise[key])} {word}" for key, word in words.items() if not math.isnan(noise.get(key, math.nan))]
    return {"noise": ", ".join(known) + " (of coding alone, below the peak)"} if known else {}


def _size_lines(encoded: Encoded) -> dict[str, str]:
    lines = {
        "codec": encoded.codec,
        "size": f"{encoded.encoded_bytes} bytes, {encoded.bits_per_coefficient:.4g} bit per coefficient",
    }
    if "entropy_bits" in encoded.info:
        lines["entropy"] = f"{encoded.info['entropy_bits']:.4g} bit per coefficient (estimate)"
    return lines


COMMANDS = (encode, decode)
