"""What ``clrelight view`` serves: its page and the data of its files, to this machine, and nothing else."""

import base64
import http.client
import json
import re
import signal
import socket
import subprocess
import threading
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight.lighting.light import Light
from clrelight.shrm.record import Shrm
from clrelight.store import read_fit, write_fit, write_light, write_shrm
from clrelight.transfer.reflection import OPERATOR
from clrelight.view.document import SCRIPTS, page_pieces
from clrelight.view.session import served_viewer
from clrelight.view.texels import count_levels, halve, tile_place
from tests.commands import call, command_line, environment, succeed
from tests.javascript import PAGE

FILES = ("fit.h5", "klt.h5", "wavelet.h5", "half.h5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("viewed")
    succeed("synth", "ring", place / "ring.h5", "--size", 64, "--lights", 20)
    succeed("fit", place / "ring.h5", place / "fit.h5", "--degree", 2)
    others(place)
    for codec, words in (("klt", ("--rate", 1)), ("wavelet", ("--rate", 2)), ("half", ())):
        succeed("encode", place / "fit.h5", place / f"{codec}.h5", "--codec", codec, *words)
    return place


def others(place):
    """Write files that are no view's."""
    view = read_fit(place / "fit.h5")
    for name, method, config in (
        ("surface", "transfer", {"surface": {"frame": "global"}}),
        ("operators", OPERATOR, {}),
    ):
        write_fit(place / f"{name}.h5", replace(view, method=method, config=config))
    write_shrm(place / "shrm.h5", Shrm(np.ones((4, 5, 9, 3), np.float32), "global", 3, "reflection", "sky", "", {}))
    write_light(place / "light.h5", Light(np.ones((4, 3))))
    (place / "coin.ptm").write_text("PTM_1.2")


@pytest.fixture(scope="module")
def server(folder):
    files = [folder / name for name in FILES]
    with served_viewer(files, reference=folder / "ring.h5") as opened:
        thread = threading.Thread(target=opened.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield opened
        opened.shutdown()
        thread.join()


def get(server, path):
    with urllib.request.urlopen(server.address + path) as answer:
        return answer.read()


def status(server, path, **headers):
    connection = http.client.HTTPConnection(*server.server_address, timeout=10)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


def manifest_of(page):
    return json.loads(re.search(r'<script id="manifest"[^>]*>\n(.*?)\n</script>', page, re.DOTALL)[1])


def planes_of(content, shape, count):
    texels = np.frombuffer(content, "<f2").reshape(-1, *shape, 4)
    return np.moveaxis(texels, 3, 1).reshape(-1, *shape)[:count]


def test_the_page_tells_of_its_files(server, folder):
    page = get(server, "").decode()
    manifest = manifest_of(page)
    assert [each["name"] for each in manifest["files"]] == [*FILES, "ring.h5"]
    assert [each["kind"] for each in manifest["files"]] == ["planes", "klt", "planes", "planes", "photographs"]
    assert manifest["reference"] == 4
    assert len(page) - len(json.dumps(manifest)) < 400_000
    directions = np.frombuffer(base64.b64decode(manifest["files"][4]["directions"]), "<f4").reshape(-1, 3)
    assert np.all(np.linalg.norm(directions, axis=1) == pytest.approx(1.0))


def test_pages_of_high_degrees_are_no_larger(tmp_path):
    """Tables of lights, skies and nodes behind the curve go into pages of any degree; numbers of a file are its own."""
    coeffs = 0.1 * np.random.default_rng(3).standard_normal((441, 8, 8, 1)).astype(np.float32)
    fit = cr.CoefficientMap(coeffs, 20, "spline", 1.0, "srgb", np.eye(3)[2:])
    cr.encode(fit, "klt", rate=2, transfer="srgb", out=tmp_path / "high.h5")
    cr.write_viewer(tmp_path / "high.h5", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text("utf-8")
    manifest = manifest_of(page)
    own = [manifest["files"][0].pop(name) for name in ("operator", "units", "directions")]
    body = re.search(r'<script id="data-body-0"[^>]*>\n(.*?)\n</script>', page, re.DOTALL)[1]
    assert len(own[0]) > 100_000
    assert len(page) - sum(map(len, own)) - len(body) < 250_000


def test_tiles_hold_the_coefficients(server, folder):
    fit = read_fit(folder / "fit.h5")
    expected = fit.coeffs_khwc.transpose(0, 3, 1, 2).reshape(27, 64, 64)
    found = planes_of(get(server, "tile/0/0/0/0/0"), (64, 64), 27)
    np.testing.assert_allclose(found, expected, rtol=2**-11, atol=1e-7)
    for number, name in ((2, "wavelet.h5"), (3, "half.h5")):
        coeffs = cr.decode(folder / name).coeffs_khwc
        found = planes_of(get(server, f"tile/{number}/0/0/0/0"), (64, 64), 27)
        expected = coeffs.transpose(0, 3, 1, 2).reshape(27, 64, 64)
        np.testing.assert_allclose(found, expected, rtol=2**-10, atol=1e-6)


def test_photographs_are_linear_radiance(server, folder):
    with cr.open_stack(folder / "ring.h5") as stack:
        expected = stack.images_ihwc[7:8][0].astype(float) / stack.peak
    found = planes_of(get(server, "tile/4/0/0/0/7"), (64, 64), 3)
    np.testing.assert_allclose(np.moveaxis(found, 0, 2), expected, rtol=2**-11)


def test_bodies_are_served_in_parts(server, folder):
    body = cr.read_encoded(folder / "klt.h5")[0].body
    length = manifest_of(get(server, "").decode())["files"][1]["length"]
    assert get(server, f"body/1/0-{length}") == bytes(body[:length])
    assert get(server, "body/1/10-25") == bytes(body[10:25])
    assert get(server, "body/1/7-7") == b""


@pytest.mark.parametrize(
    "rest",
    [
        *("body/1/5-4", "body/1/0-99999999999", "body/0/0-4", "body/9/0-4", "body/1/-1-4", "body/1/0-4/"),
        *(
            "tile/0/0/9/0/0",
            "tile/0/6/0/0/0",
            "tile/1/0/0/0/0",
            "tile/4/0/0/0/99",
            "tile/0/0/0/0/0?x=1",
            "tile/77/0/0/0/0",
        ),
        *("page.js", "../page", "%2e%2e/etc/passwd", "body/1/0-4\x00", "favicon.ico"),
    ],
)
def test_nothing_else_is_there(server, rest):
    raw = socket.create_connection(server.server_address)
    raw.sendall(f"GET /{server.secret}/{rest} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode())
    assert raw.makefile("rb").readline().split()[1] in (b"404", b"400")


def test_only_who_knows_the_secret_and_the_name_is_answered(server):
    assert status(server, f"/{server.secret}/") == 200
    for host in ("localhost:1", "LOCALHOST", "LocalHost:8080", "127.0.0.1"):
        assert status(server, f"/{server.secret}/", Host=host) == 200
    for host in (
        "evil.example",
        "localhost.evil.example",
        "evil.localhost",
        "localhost:80:1",
        "localhost:x",
        "",
        "[::1]",
    ):
        assert status(server, f"/{server.secret}/", Host=host) == 404
    for path in ("/", "/x/", f"/{server.secret[:-1]}/", f"/{server.secret}"):
        assert status(server, path) == 404
    assert server.server_address[0] == "127.0.0.1"


def test_garbage_ends_a_connection_and_nothing_else(server):
    rng = np.random.default_rng(5)
    garbage = [b"", b"\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"A" * 70000, b"GET /" + b"a" * 70000]
    garbage += [rng.bytes(300) for _ in range(20)]
    garbage += [f"GET /{server.secret}/ HTTP/1.1\r\n".encode() + b"X: y\r\n" * 300 + b"\r\n"]
    for hosts in ("", "Host: localhost\r\nHost: localhost\r\n", "Host: localhost localhost\r\n"):
        garbage.append(f"GET /{server.secret}/ HTTP/1.1\r\n{hosts}\r\n".encode())
    garbage += [
        f"{verb} /{server.secret}/ HTTP/1.1\r\nHost: localhost\r\n\r\n".encode() for verb in ("POST", "PUT", "X")
    ]
    for each in garbage:
        with socket.create_connection(server.server_address, timeout=10) as raw:
            raw.sendall(each)
            raw.shutdown(socket.SHUT_WR)
            try:
                answered = raw.makefile("rb").readline()
            except ConnectionError:
                continue  # it would not read so much
            assert not answered.startswith(b"HTTP/1.1 2")
    assert get(server, "").startswith(b"<!doctype html>")


def test_a_file_that_goes_bad_is_told(server, folder, monkeypatch):
    monkeypatch.setattr(server.sources[0], "tile", lambda *place: (_ for _ in ()).throw(cr.InputError("it is gone")))
    with pytest.raises(urllib.error.HTTPError) as caught:
        get(server, "tile/0/0/0/0/0")
    assert caught.value.code == 500
    assert json.loads(caught.value.read()) == {"error": "it is gone"}


def test_a_page_on_disk_asks_for_nothing(folder, tmp_path):
    out = tmp_path / "viewer.html"
    told = succeed("view", folder / "klt.h5", folder / "fit.h5", "--out", out, "--planes", "uint8", "--json").json
    page = out.read_text("utf-8")
    assert told["bytes"] == out.stat().st_size == len(page.encode())
    assert "connect-src 'none';" in page
    assert set(re.findall(r"https?://[^\s\"']*", page)) <= set()
    body = cr.read_encoded(folder / "klt.h5")[0].body
    held = re.search(r'<script id="data-body-0"[^>]*>\n(.*?)\n</script>', page, re.DOTALL)[1]
    assert base64.b64decode(held) == bytes(body[:])
    tile = base64.b64decode(re.search(r'<script id="data-tile-1-0-0-0-0"[^>]*>\n(.*?)\n</script>', page, re.DOTALL)[1])
    low, step = np.frombuffer(tile, "<f4", 56).reshape(2, 28)[:, :27]
    texels = np.frombuffer(tile, np.uint8, offset=4 * 56).reshape(7, 64, 64, 4)
    codes = np.moveaxis(texels, 3, 1).reshape(28, 64, 64)[:27]
    coeffs = read_fit(folder / "fit.h5").coeffs_khwc.transpose(0, 3, 1, 2).reshape(27, 64, 64)
    found = low[:, None, None] + step[:, None, None] * codes
    assert np.all(np.abs(found - coeffs).max(axis=(1, 2)) <= 0.502 * step + 1e-7)


def test_scripts_can_stand_in_a_page():
    assert {path.name for path in PAGE.glob("*.js")} == set(SCRIPTS)
    for path in PAGE.iterdir():
        text = path.read_text("utf-8")
        assert text.count("\n") <= 300, path.name
        assert path.suffix == ".html" or "</" not in text, path.name
    title = "</script><!--<script>{{style}}"
    page = "".join(page_pieces({"title": title}, (), served=True))
    assert page.count("<script") == page.count("</script>") == len(SCRIPTS) + 1
    assert page.count("<!--") == 0
    assert page.count("<style>") == 1
    assert manifest_of(page) == {"title": title}


def test_levels_halve_as_those_of_units_do():
    planes = np.arange(15, dtype=np.float32).reshape(1, 3, 5)
    np.testing.assert_array_equal(halve(planes)[0], [[3, 5, 6.5], [10.5, 12.5, 14]])
    assert [count_levels(*shape) for shape in ((512, 100), (513, 1), (4000, 6000), (1 << 19, 3))] == [0, 1, 4, 5]
    place = tile_place(600, 300, 0, 1, 0)
    assert (place.top, place.left, place.bottom, place.right) == (255, 0, 513, 257)
    with pytest.raises(LookupError):
        tile_place(600, 300, 0, 3, 0)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("ring.h5",), "give one that clrelight fit or pack makes of ring.h5, which may then be the --reference"),
        (("surface.h5",), "clrelight render makes pictures of them, and with --turntable one that goes round"),
        (("operators.h5",), "clrelight reflect makes radiance of them"),
        (("shrm.h5",), "clrelight shrm render makes pictures of a reflection map"),
        (("light.h5",), "by --light or, in view, by --environment"),
        (("coin.ptm",), "clrelight import makes a stack of it"),
        (("fit.h5", "--out", "fit.h5"), "fit.h5"),
        (("fit.h5", "--out", "x.html", "--port", "80"), "--port and --open are for a page that is served"),
        (("fit.h5", "other.h5"), "other.h5 has 32 × 32 pixels and fit.h5 64 × 64"),
        (("nothing.h5",), "nothing.h5"),
        (("fit.h5", "--environment", "dark.exr", "--out", "x.html"), "no light comes from it"),
    ],
)
def test_refusals(folder, monkeypatch, words, line):
    monkeypatch.chdir(folder)
    if "other.h5" in words:
        succeed("synth", "ring", "small.h5", "--size", 32, "--lights", 20)
        succeed("fit", "small.h5", "other.h5", "--degree", 1)
    if "dark.exr" in words:
        import OpenImageIO as oiio

        oiio.ImageBuf(np.zeros((8, 16, 3), np.float32)).write("dark.exr")
    before = {path.name for path in folder.iterdir()}
    ended = call("view", *words)
    assert ended.code == 2
    assert line in ended.err
    assert ended.err.count("\n") == 1
    assert {path.name for path in folder.iterdir()} == before


def test_ctrl_c_is_how_it_ends(folder):
    words = command_line("view", folder / "klt.h5")
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment())
    address, hint = process.stdout.readline().strip(), process.stdout.readline()
    assert address.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(address) as answer:
        assert answer.status == 200
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (0, "", "")
    assert hint == "Ctrl-C ends it.\n"
