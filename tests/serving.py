"""A web server on this machine, as good or as bad as a test wants it."""

import re
import ssl
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Served:
    """A file that is served, what is to go wrong, and what was asked for."""

    def __init__(self, content):
        self.content, self.etag = content, '"one"'
        self.ranges, self.paths = [], []
        self.fault = None  # called with the handler before each answer; true where it answered
        self.url = ""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = -1  # headers and content go together, and nobody waits for an acknowledgement

    def do_GET(self):
        served = self.server.served
        served.paths.append(self.path)
        served.ranges.append(self.asked())
        if served.fault is None or not served.fault(self):
            self.answer()

    def asked(self):
        match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"] or "")
        return None if match is None else (int(match[1]), int(match[2]) + 1)

    def answer(self, content=None, **changes):
        """Send the range that was asked for; `changes` replace headers, None leaves one out."""
        whole = self.server.served.content
        start, end = self.asked()
        if start >= len(whole):
            self.reply(416, b"", {"Content-Range": f"bytes */{len(whole)}"})
            return
        end = min(end, len(whole))
        part = whole[start:end] if content is None else content
        self.reply(206, part, {"Content-Range": f"bytes {start}-{end - 1}/{len(whole)}", **changes})

    def reply(self, status, content, headers=()):
        sent = {"Content-Length": str(len(content)), "ETag": self.server.served.etag, **dict(headers)}
        self.send_response(status)
        for name, value in sent.items():
            if value is not None:
                self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def drip(self, seconds):
        """Send headers, and then a byte at a time."""
        (start, end), whole = self.asked(), self.server.served.content
        end = min(end, len(whole))
        self.send_response(206)
        self.send_header("Content-Length", str(end - start))
        self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(whole)}")
        self.end_headers()
        for byte in whole[start:end]:
            self.wfile.write(bytes([byte]))
            self.wfile.flush()
            time.sleep(seconds)

    def hang_up(self):
        self.close_connection = True

    def log_message(self, *arguments):
        pass


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request, client_address):
        pass  # clients go away where they should


@contextmanager
def serving(content, certificate=None):
    """Serve bytes under any name on loopback; yield what tells of it."""
    server = _Server(("127.0.0.1", 0), _Handler)
    server.served = served = Served(content)
    scheme = "http"
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
        scheme = "https"
    served.url = f"{scheme}://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
