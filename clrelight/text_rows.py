"""Lines of text files as people write them: any encoding, and numbers with any separators between them."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from clrelight.errors import InputError

NUMBER = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[ed][+-]?[0-9]+)?|nan|inf(?:inity)?)", re.IGNORECASE)
"""A number with a decimal point; its exponent may be Fortran's."""

_MAX_FILE_BYTES = 64 << 20
_AROUND = "[](){},; \t"
_COMMENTS = ("#", "%", ";", "//")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[ed][+-]?[0-9]+)?", re.IGNORECASE)


def read_lines(path: Path) -> tuple[list[tuple[int, str]], list[str]]:
    """Return the lines that say something, stripped, with their numbers from 1, and notes.

    Left out are comments, and lines of blanks or brackets alone.
    """
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise InputError(f"{path} is larger than {_MAX_FILE_BYTES >> 20} MiB, which no light file is")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    text, encoding = _decode(content)
    if text is None or re.search(r"[\x00-\x08\x0e-\x1b\x7f]", text):
        raise InputError(f"{path} is no text file (expected UTF-8, UTF-16 or Windows-1252)")
    lines = [(i, line.strip()) for i, line in enumerate(text.replace("\u2212", "-").splitlines(), start=1)]
    notes = [f"{path.name} is not UTF-8, and was read as {encoding}"] if encoding == "Windows-1252" else []
    return [(i, line) for i, line in lines if line.strip(_AROUND) and not line.startswith(_COMMENTS)], notes


def _decode(content: bytes) -> tuple[str | None, str]:
    """Return the text and its encoding: by its byte order mark, by zeros as UTF-16 has them, or UTF-8 if it is."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        trials = ["utf-16"]
    elif b"\0" in content:
        trials = ["utf-16-le" if content[1:2] == b"\0" else "utf-16-be"]
    else:
        trials = ["utf-8-sig", "windows-1252"]
    for encoding in trials:
        try:
            return content.decode(encoding), encoding.capitalize()
        except UnicodeDecodeError:
            continue
    return None, ""


def split_fields(path: Path, line: int, text: str, strict: bool = True) -> list[str]:
    """Return the fields of a line, decimal commas made points: split at semicolons, else at commas or blanks.

    InputError where commas have two meanings, unless not `strict`.
    """
    text = text.strip(_AROUND)
    if re.fullmatch(r'(?:"[^"]*"[\s,;]*)+', text):
        parts = re.findall(r'"([^"]*)"', text)
    elif ";" in text:
        parts = [part.strip() for part in text.split(";")]
    elif "," in text:
        parts = _split_at_commas(path, line, text, strict)
    else:
        parts = text.split()
    parts = [part.strip("\"'") for part in parts]
    return [part.replace(",", ".") if _DECIMAL_COMMA.fullmatch(part) else part for part in parts]


def _split_at_commas(path: Path, line: int, text: str, strict: bool = True) -> list[str]:
    tokens = text.split()
    inner = [token.rstrip(",") for token in tokens]
    decimal = [_DECIMAL_COMMA.fullmatch(token) is not None for token in inner]
    unclear = any("," in token for token, found in zip(inner, decimal, strict=True) if not found)
    # Between blanks a comma is decimal; with commas before the blanks too, where it is so more than once.
    spaced = inner == tokens or (sum(decimal) > 1 and all(token.endswith(",") for token in tokens[:-1]))
    if len(tokens) > 1 and any(decimal) and spaced and not unclear:
        if strict and "." in text:
            raise InputError(f"{path} line {line}: has decimal commas and points, expected one of them: {text[:60]!r}")
        return inner
    parts = re.split(r"\s*,\s*|\s+", text)
    whole, after = parts[::2], parts[1::2]
    if (
        strict
        and len(whole) == len(after)
        and all(re.fullmatch(r"[+-]?[01]", part) for part in whole)
        and all(re.fullmatch(r"[0-9]+", part) for part in after)
        and any(len(part) > 2 for part in after)
    ):
        raise InputError(
            f"{path} line {line}: commas both as decimal commas and between numbers in {text[:60]!r}; "
            "expected decimal points, or blanks or semicolons between"
        )
    return parts
