"""The bytes of mesh files as trimesh reads them rightly: in one encoding, whole, faces with counts from the start."""

from __future__ import annotations

import re

from clrelight.errors import InputError

_TEXTS = ("ply", "obj", "stl", "off")
_STL_HEADER, _STL_FACE = 80, 50
_ODD_INDEX = re.compile(rb"^ *f (?:[^\n]*[ /])?(?:-|0+(?=[\s/]|\Z))", re.MULTILINE)
"""A line of a face that counts from its end, or from 0."""
_ELEMENT = re.compile(rb"^[ \t]*element[ \t]+\S+[ \t]+(\d+)[ \t\r]*$", re.MULTILINE)
_COUNTED = {b"v": 0, b"vt": 1, b"vn": 2}
_NAMES = ("v", "vt", "vn")


def readable(content: bytes, kind: str) -> bytes:
    """Return a file's content, in which only what trimesh takes otherwise than the format means is changed.

    Parameters
    ----------
    content : bytes
    kind : str
        Its format: one of `clrelight.transfer.mesh_files.FORMATS`.

    Raises
    ------
    InputError
        If fewer lines are there than its header says, or a face of an OBJ names vertex 0, or one before the first.
    """
    if kind not in _TEXTS:
        return content
    if kind == "stl":
        if not is_binary_stl(content):  # one byte a character: trimesh looks at the first 80 bytes by themselves
            return content.decode("latin-1").encode("ascii", "replace")
        return b" " * _STL_HEADER + content[_STL_HEADER:]  # a remark, or colours of some program: not for reading
    if kind == "ply":
        return _ply(content)
    text = _as_utf8(content.removeprefix(b"\xef\xbb\xbf"))
    if kind == "off":
        _check_off(text)
    return _obj(text) if kind == "obj" else text


def is_binary_stl(content: bytes) -> bool:
    """Return whether there are as many triangles as a binary STL of these bytes says."""
    start = _STL_HEADER + 4
    if len(content) < start:
        return False
    return len(content) == start + _STL_FACE * int.from_bytes(content[_STL_HEADER:start], "little")


def _as_utf8(content: bytes) -> bytes:
    """Return content with one character for each byte where it is in another encoding, of names and remarks."""
    try:
        content.decode()
    except UnicodeDecodeError:
        return content.decode("latin-1").encode()
    return content


def _ply(content: bytes) -> bytes:
    head, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply"):
        return content
    if not mark:
        raise InputError("it is cut short: its header has no end")
    head = _as_utf8(head)
    if b"format ascii" in head:
        counts = [int(number) for number in _ELEMENT.findall(head)]
        last = _ELEMENT.split(head)[-1].split()
        _check_lines(body, sum(counts), last[:2] == [b"property", b"list"])
        body = _as_utf8(body)
    return head + mark + body


def _check_off(text: bytes) -> None:
    words = re.sub(rb"#[^\n]*", b"", text).split(None, 4)
    if len(words) == 5 and words[1].isdigit() and words[2].isdigit():
        _check_lines(words[4], int(words[1]) + int(words[2]), True)


def _check_lines(body: bytes, wanted: int, ends_in_lists: bool) -> None:
    """Raise InputError where lines are missing, or the end of the last, which begins with how many numbers follow."""
    held = body.strip()
    lines = held.count(b"\n") + 1
    if lines < wanted:
        raise InputError(f"it is cut short: its header says {wanted} vertices and faces, {lines} lines follow")
    last = held.rsplit(b"\n", 1)[-1].split()
    if ends_in_lists and lines == wanted and last and last[0].isdigit() and len(last) <= int(last[0]):
        raise InputError(f"it is cut short: its last face has {len(last) - 1} of {int(last[0])} vertices")


def _obj(text: bytes) -> bytes:
    """Return the text with blanks between words, and faces that count vertices from 1."""
    if b"\n" not in text:
        text = text.replace(b"\r", b"\n")
    text = text.replace(b"\t", b" ")
    if _ODD_INDEX.search(text) is None:
        return text
    counts, lines = [0, 0, 0], text.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").split(b"\n")
    for number, line in enumerate(lines):
        words = line.split(None, 1)
        if not words:
            continue
        if words[0] in _COUNTED:
            counts[_COUNTED[words[0]]] += 1
        elif words[0] == b"f" and len(words) == 2:
            corners = words[1].split(b"#")[0].split()
            lines[number] = b"f " + b" ".join(_counted(corner, counts) for corner in corners)
    return b"\n".join(lines)


def _counted(corner: bytes, counts: list[int]) -> bytes:
    found = []
    for word, name, count in zip(corner.split(b"/"), _NAMES, counts, strict=False):
        if word.startswith(b"-") and word[1:].isdigit():
            number = count + 1 + int(word)
            if number < 1:
                raise InputError(f"a face names {name} {int(word)}, there are {count} before it")
            word = b"%d" % number
        elif word.isdigit() and int(word) == 0:
            raise InputError(f"a face names {name} 0, they count from 1, or back from -1")
        found.append(word)
    return b"/".join(found)
