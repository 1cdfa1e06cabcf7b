"""A headless Chromium, driven through its DevTools protocol by a WebSocket of a few lines: no package is needed."""

import base64
import json
import os
import secrets
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

FLAGS = (
    *("--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions", "--hide-scrollbars"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-pings"),
    *("--disable-dev-shm-usage", "--mute-audio", "--remote-debugging-port=0", "--force-device-scale-factor=1"),
)


def find_chromium():
    names = (os.environ.get("CLRELIGHT_CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if name and (found := shutil.which(name))), None)


class Socket:
    """Text messages over a WebSocket (RFC 6455), from the side of a client."""

    def __init__(self, port, path):
        self.raw = socket.create_connection(("127.0.0.1", port))
        key = base64.b64encode(secrets.token_bytes(16)).decode()
        self.raw.sendall(
            f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        self.file = self.raw.makefile("rb")
        while self.file.readline() not in (b"\r\n", b""):
            pass

    def send(self, text):
        content, mask = text.encode(), secrets.token_bytes(4)
        size = len(content)
        head = struct.pack("!BB", 0x81, 0x80 | 127) + struct.pack("!Q", size)
        key = (mask * (size // 4 + 1))[:size]
        masked = (int.from_bytes(content, "little") ^ int.from_bytes(key, "little")).to_bytes(size, "little")
        self.raw.sendall(head + mask + masked)

    def receive(self):
        whole, last = b"", False
        while not last:
            first, second = self.file.read(2)
            size = second & 127
            if size > 125:
                size = int.from_bytes(self.file.read(2 if size == 126 else 8), "big")
            content, last = self.file.read(size), bool(first & 128)
            if first & 15 in (0, 1):
                whole += content
        return whole.decode()


class Page:
    def __init__(self, port, path):
        self.socket, self.number, self.events = Socket(port, path), 0, []

    def call(self, method, timeout=60, **parameters):
        """Return the result of a method of the protocol."""
        self.number += 1
        self.socket.raw.settimeout(timeout)
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.receive())
            if message.get("id") == self.number:
                assert "error" not in message, message["error"]
                return message["result"]
            self.events.append(message)

    def evaluate(self, code, timeout=60):
        """Return the value of an expression, that of its promise where it is one."""
        found = self.call(
            "Runtime.evaluate", timeout, expression=code, awaitPromise=True, returnByValue=True, userGesture=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def go(self, address, width=1024, height=1024, mobile=False):
        """Go to an address and wait until it is loaded."""
        self.call("Page.enable")
        self.call("Network.enable")
        self.call("Runtime.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'")

    def wait(self, condition, seconds=30):
        end = time.monotonic() + seconds
        while not self.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, f"waited {seconds} s for {condition}"
            time.sleep(0.02)

    def picture(self, path):
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def requests(self):
        """Return the addresses that were asked for so far."""
        self.evaluate("0")
        sent = [each for each in self.events if each["method"] == "Network.requestWillBeSent"]
        return [each["params"]["request"]["url"] for each in sent]

    def faults(self):
        """Return what went wrong in the page so far."""
        self.evaluate("0")
        thrown = [each["params"] for each in self.events if each["method"] == "Runtime.exceptionThrown"]
        told = [
            e["params"]
            for e in self.events
            if e["method"] == "Runtime.consoleAPICalled" and e["params"]["type"] == "error"
        ]
        return thrown + told


@contextmanager
def opened_browser(address="about:blank", **options):
    """Lend a page of a browser of its own, which is ended behind it."""
    folder = tempfile.mkdtemp(prefix="chromium.")
    command = [find_chromium(), *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    surroundings = {**os.environ, "TMPDIR": folder}  # where else it would leave its socket
    process = subprocess.Popen(command, env=surroundings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        told, end = Path(folder) / "DevToolsActivePort", time.monotonic() + 30
        while not told.exists() or len(told.read_text().splitlines()) < 2:
            assert process.poll() is None, "chromium does not start"
            assert time.monotonic() < end, "chromium does not start in time"
            time.sleep(0.02)
        port, path = told.read_text().splitlines()[:2]
        root = Page(int(port), path)
        target = root.call("Target.createTarget", url="about:blank")["targetId"]
        page = Page(int(port), f"/devtools/page/{target}")
        if address != "about:blank":
            page.go(address, **options)
        yield page
    finally:
        process.terminate()
        process.wait(20)
        shutil.rmtree(folder, ignore_errors=True)
