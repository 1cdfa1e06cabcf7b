"""Serves the page and the data of its files on loopback, and nothing else."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from clrelight.errors import InputError
from clrelight.view.document import page_pieces
from clrelight.view.sources import PayloadSource, Source

LOOPBACK = "127.0.0.1"
_MOST_BYTES = 1 << 28
"""Of a payload in one answer."""
_IDLE_SECONDS = 30
_BODY = re.compile(r"/body/(\d{1,4})/(\d{1,15})-(\d{1,15})")
_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?", re.IGNORECASE | re.ASCII)
_TILE = re.compile(r"/tile/(\d{1,4})/(\d)/(\d{1,7})/(\d{1,7})/(\d{1,7})")


class ViewServer(ThreadingHTTPServer):
    """Answers those who know its secret, on this machine.

    Parameters
    ----------
    sources : sequence of Source
    manifest : mapping
        What the page is told.
    planes : str
        ``"half"`` or ``"uint8"``: what tiles are made of.
    port : int
        0: any that is free.
    """

    daemon_threads = True

    def __init__(self, sources: Sequence[Source], manifest: Mapping[str, Any], planes: str, port: int = 0) -> None:
        super().__init__((LOOPBACK, port), _Handler)
        self.sources, self.planes = sources, planes
        self.secret = secrets.token_urlsafe(16)
        self.page = "".join(page_pieces(manifest, (), served=True)).encode("utf-8")

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return f"http://{LOOPBACK}:{self.server_address[1]}/{self.secret}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of connections that end early, or bring what is no request."""

    def answer(self, path: str) -> tuple[bytes, str] | None:
        """Return what is at a path, and its type; None where nothing is."""
        if not path.startswith(f"/{self.secret}/"):
            return None
        rest = path[len(self.secret) + 1 :]
        if rest == "/":
            return self.page, "text/html; charset=utf-8"
        try:
            content = self._data(rest)
        except LookupError:
            return None
        return None if content is None else (content, "application/octet-stream")

    def _data(self, rest: str) -> bytes | None:
        if match := _BODY.fullmatch(rest):
            number, begin, end = map(int, match.groups())
            source = self.sources[number]
            if not isinstance(source, PayloadSource) or not 0 <= end - begin <= _MOST_BYTES or end > len(source.body):
                return None
            return source.read(begin, end)
        if match := _TILE.fullmatch(rest):
            number, *place = map(int, match.groups())
            level, row, column, light = place
            return self.sources[number].tile(level, row, column, light, self.planes)
        return None


class _Handler(BaseHTTPRequestHandler):
    server: ViewServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "clrelight", ""
    timeout = _IDLE_SECONDS

    def do_GET(self) -> None:
        """Answer a request."""
        self._answer(with_content=True)

    def do_HEAD(self) -> None:
        """Answer as GET does, without the content."""
        self._answer(with_content=False)

    def _answer(self, *, with_content: bool) -> None:
        # A page elsewhere that had its name point here would send that name.
        names = self.headers.get_all("Host", [])
        is_ours = len(names) == 1 and _HOST.fullmatch(names[0].strip()) is not None
        try:
            found = self.server.answer(self.path) if is_ours else None
        except (InputError, OSError, MemoryError) as error:
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, json.dumps({"error": str(error)}).encode(), "application/json")
            return
        if found is None:
            self._send(HTTPStatus.NOT_FOUND, b"", "text/plain")
        else:
            self._send(HTTPStatus.OK, *found, with_content=with_content)

    def _send(self, status: HTTPStatus, content: bytes, kind: str, *, with_content: bool = True) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        if with_content:
            self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is the user's."""
