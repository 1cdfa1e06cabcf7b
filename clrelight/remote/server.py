"""Asks a server for ranges of bytes of a file, over HTTP or HTTPS, and takes nothing else for an answer."""

from __future__ import annotations

import re
import socket
import ssl
import time
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse

from clrelight.errors import RemoteError
from clrelight.remote.addresses import TIMEOUT_VARIABLE, Address, read_timeout

_MOST_MOVES = 5
_MOVED = (301, 302, 303, 307, 308)
_PIECE_BYTES = 1 << 16
_LEAST_RATE = 1000.0
"""Bytes a second that an answer comes with at least, beside what a timeout allows."""
_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")
_SIZE = re.compile(r"bytes \*/(\d{1,18})")


@dataclass(frozen=True)
class Answer:
    """Bytes of a file.

    Attributes
    ----------
    content : bytes
        From where they were asked for on; fewer only where the file ends.
    size : int
        Of the file.
    stamp : tuple of str
        Its ETag and Last-Modified, empty where the server has none: another one means another file.
    """

    content: bytes
    size: int
    stamp: tuple[str, str]


class _BrokenError(Exception):
    """A connection was lost, or an answer cut short: worth another try."""


class Server:
    """Fetches ranges of one file, over one connection as long as it lasts.

    Parameters
    ----------
    url : str
        Of the file.

    Raises
    ------
    RemoteError
        In one line that names the file; of `get` too.
    """

    def __init__(self, url: str) -> None:
        self._url, self._address, self._timeout = url, Address.of(url), read_timeout()
        self._connection: HTTPConnection | None = None
        self._target = ""

    def close(self) -> None:
        """End the connection."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None

    def get(self, start: int, end: int) -> Answer:
        """Return bytes `start` to `end` of the file, or to where it ends before."""
        try:
            try:
                return self._get(start, end)
            except _BrokenError:  # servers close connections that rest, and networks break: once more from the start
                self.close()
                return self._get(start, end)
        except BaseException as error:
            self.close()
            told = _told(error, self._address, self._timeout)
            if told is None:
                raise
            raise RemoteError(f"{self._url}: {told}") from error

    def _get(self, start: int, end: int) -> Answer:
        for _ in range(_MOST_MOVES + 1):
            response = self._ask(start, end)
            if response.status not in _MOVED:
                return self._take(response, start, end)
            location = response.getheader("Location")
            self.close()
            if not location:
                raise RemoteError(f"the server answers {response.status}, and not where the file is")
            self._address = self._address.move(location)
        raise RemoteError(f"the server sends from place to place, more than {_MOST_MOVES} times")

    def _ask(self, start: int, end: int) -> HTTPResponse:
        if self._connection is None:
            self._connection, self._target = self._address.connect(self._timeout)
        headers = {"Range": f"bytes={start}-{end - 1}", "Accept-Encoding": "identity", "User-Agent": "clrelight"}
        try:
            self._connection.request("GET", self._target, headers=headers)
            return self._connection.getresponse()
        except (ConnectionResetError, BrokenPipeError, ssl.SSLEOFError) as error:  # also a server that just hangs up
            raise _BrokenError(str(error) or "the connection was closed") from error

    def _take(self, response: HTTPResponse, start: int, end: int) -> Answer:
        placed = response.getheader("Content-Range", "")
        stamp = response.getheader("ETag", ""), response.getheader("Last-Modified", "")
        if response.status == 416:
            whole = _SIZE.fullmatch(placed)
            raise RemoteError(
                "it is empty, expected an HDF5 file"
                if whole and int(whole[1]) == 0
                else f"the server has no bytes {start} to {end} of it: it is shorter than before"
            )
        if response.status != 206:
            raise RemoteError(_refusal(response))
        found = _RANGE.fullmatch(placed)
        if found is None or int(found[1]) != start or not start <= int(found[2]) < min(end, int(found[3])):
            raise RemoteError(f"the server answers {placed[:80]!r} where bytes {start} to {end - 1} were asked for")
        if response.getheader("Content-Encoding", "identity") != "identity":
            raise RemoteError("the server sends it compressed, so that its ranges are none of the file")
        size, count = int(found[3]), int(found[2]) + 1 - start
        content = self._read(response, count)
        if len(content) != count or count < min(end, size) - start:
            raise _BrokenError(f"{len(content)} of {min(end, size) - start} bytes came")
        if response.length or response.will_close or response.read(1):
            self.close()  # what is left on it would be taken for the next answer
        return Answer(content, size, stamp)

    def _read(self, response: HTTPResponse, count: int) -> bytes:
        content, since = bytearray(), time.monotonic()
        while len(content) < count:
            try:
                piece = response.read1(min(count - len(content), _PIECE_BYTES))
            except (ConnectionResetError, HTTPException, ssl.SSLEOFError):
                break
            if not piece:
                break
            content += piece
            if time.monotonic() - since > self._timeout + len(content) / _LEAST_RATE:
                raise TimeoutError
        return bytes(content)


def _refusal(response: HTTPResponse) -> str:
    reason = f"{response.status} {response.reason}".strip()
    match response.status:
        case 200 if response.getheader("Content-Length") == "0":
            return "it is empty, expected an HDF5 file"
        case 200:
            return (
                "the server sends whole files only, no ranges of bytes, of which a file is read here: download it, "
                "and read it from the disk"
            )
        case 404 | 410:
            return f"there is no such file ({reason})"
        case 401 | 403 | 407:
            return f"it may not be read ({reason})"
    return f"the server answers {reason}"


def _told(error: BaseException, address: Address, timeout: float) -> str | None:
    """Return what to say of an error; None where it is none of the network."""
    match error:
        case RemoteError():
            return str(error)
        case _BrokenError():
            return f"the answer was cut short, twice: {error}"
        case TimeoutError():
            return f"the server is too slow: no answer in {timeout:g} s ({TIMEOUT_VARIABLE} allows more)"
        case ssl.SSLCertVerificationError():
            return f"the certificate of {address.host} is not trusted: {error.verify_message}"
        case ssl.SSLError():
            return f"no secure connection to {address.host}: {error.reason or error}"
        case socket.gaierror() | UnicodeError():
            return f"there is no host {address.host}"
        case HTTPException():
            return f"{address.host} does not answer as HTTP has it: {type(error).__name__}"
        case OSError():
            return f"{address.host} cannot be reached: {error.strerror or error}"
    return None
