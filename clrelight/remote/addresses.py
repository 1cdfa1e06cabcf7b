"""Where a file on another machine is, and through what it is reached."""

from __future__ import annotations

import math
import os
import ssl
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPSConnection
from urllib.parse import SplitResult, quote, urljoin, urlsplit
from urllib.request import getproxies, proxy_bypass

from clrelight.errors import RemoteError

TIMEOUT_VARIABLE = "CLRELIGHT_TIMEOUT"
_TIMEOUT = 30.0
_PLAIN = "/%:@!$&'()*+,;=~-._?"
"""What of a path or a query is sent as it is, beside letters and digits."""


@dataclass(frozen=True)
class Address:
    """A URL taken apart.

    Attributes
    ----------
    url : str
        As it is shown.
    scheme, host : str
    port : int or None
    target : str
        Path and query, as they are sent.
    """

    url: str
    scheme: str
    host: str
    port: int | None
    target: str

    @classmethod
    def of(cls, url: str) -> Address:
        """Take a URL apart; RemoteError where it is none."""
        try:
            parts = urlsplit(url)
            host, port = parts.hostname or "", parts.port
            host.encode("idna")
        except ValueError:
            raise RemoteError(f"{url} is no address of a file: expected such as https://host/view.h5") from None
        if not host:
            raise RemoteError(f"{url} names no host: expected such as https://host/view.h5")
        if parts.username is not None or parts.password is not None:
            raise RemoteError(f"{_without_user(parts)}: names and passwords in an address are not sent, leave them out")
        target = quote(parts.path or "/", safe=_PLAIN) + (f"?{quote(parts.query, safe=_PLAIN)}" if parts.query else "")
        return cls(url, parts.scheme.lower(), host, port, target)

    def move(self, location: str) -> Address:
        """Return where a server sends us; RemoteError where we do not go."""
        there = Address.of(urljoin(self.url, location))
        if there.scheme not in ("http", "https") or (self.scheme, there.scheme) == ("https", "http"):
            raise RemoteError(f"the server sends to {there.url}, which is not followed")
        return there

    def connect(self, timeout: float) -> tuple[HTTPConnection, str]:
        """Return a connection that is opened when it is used, and what to ask it for.

        A proxy stands between where the environment or the system names one.
        """
        proxy = None if proxy_bypass(self.host) else getproxies().get(self.scheme)
        through = Address.of(proxy if "://" in proxy else f"http://{proxy}") if proxy else self
        if self.scheme == "https":
            context = ssl.create_default_context()
            secure = HTTPSConnection(through.host, through.port, timeout=timeout, context=context)
            if proxy:
                secure.set_tunnel(self.host, self.port)
            return secure, self.target
        plain = HTTPConnection(through.host, through.port, timeout=timeout)
        host = f"[{self.host}]" if ":" in self.host else self.host
        place = host if self.port is None else f"{host}:{self.port}"
        return plain, f"http://{place}{self.target}" if proxy else self.target


def read_timeout() -> float:
    """Return the seconds that a server may say nothing; RemoteError where the environment names no such number."""
    text = os.environ.get(TIMEOUT_VARIABLE) or str(_TIMEOUT)
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds <= 86400.0:
        raise RemoteError(f"{TIMEOUT_VARIABLE} must be seconds, above 0 and up to 86400, got {text!r}")
    return seconds


def _without_user(parts: SplitResult) -> str:
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
