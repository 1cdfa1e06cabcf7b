"""Files behind URLs, from a server on this machine: what is fetched of them, and all that can go wrong."""

import shutil
import socket
import subprocess
import time

import numpy as np
import pytest

import clrelight as cr
from clrelight.dataset import LightStack
from clrelight.errors import InputError, RemoteError
from clrelight.remote import ranges
from clrelight.remote.ranges import RangedFile
from tests.commands import call
from tests.serving import serving
from tests.test_salvage import damage, find_unit, make_fit, outside

HEIGHT, WIDTH = 576, 1100
LIGHT = (0.2, 0.3, 1.0)
REGION = (700, 100, 150, 120)


@pytest.fixture(autouse=True)
def no_proxies(monkeypatch):
    for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A file of klt whose payload is 200 kB or so."""
    path = tmp_path_factory.mktemp("remote") / "view.h5"
    cr.encode(make_fit(HEIGHT, WIDTH), "klt", step=0.01, out=path)
    return path


@pytest.fixture
def served(path):
    with serving(path.read_bytes()) as server:
        yield server


def count_bytes(served):
    size = len(served.content)
    return sum(min(end, size) - start for start, end in served.ranges)


def test_a_region_is_fetched_alone(served, path, tmp_path):
    words = ("--light", "0.2,0.3,1", "--region", ",".join(map(str, REGION)))
    ended = call("relight", f"{served.url}/a/view.h5", tmp_path / "o.exr", *words, "--json")
    assert (ended.code, ended.err) == (0, "")
    facts = ended.json["fetched"]
    assert facts == {"bytes": count_bytes(served), "of": path.stat().st_size, "requests": len(served.ranges)}
    assert facts["bytes"] < 0.45 * facts["of"], facts
    assert set(served.paths) == {"/a/view.h5"}
    report = cr.Report()
    found = cr.relight(f"{served.url}/view.h5", LIGHT, region=REGION, report=report)
    np.testing.assert_array_equal(found, cr.relight(path, LIGHT, region=REGION))
    assert report.facts["fetched"] == facts

    ended = call("decode", f"{served.url}/view.h5", tmp_path / "part.h5", *words[2:])
    assert f"fetched  {facts['bytes']} of {facts['of']} bytes, in {facts['requests']} requests\n" in ended.out
    part_khwc = cr.decode(path, region=REGION).coeffs_khwc
    np.testing.assert_array_equal(cr.read_fit(tmp_path / "part.h5").coeffs_khwc, part_khwc)


def test_a_level_takes_what_is_coarse(served, path):
    report = cr.Report()
    small = cr.relight(f"{served.url}/view.h5", LIGHT, level=3, report=report)
    np.testing.assert_array_equal(small, cr.relight(path, LIGHT, level=3))
    assert report.facts["fetched"]["bytes"] < 0.35 * path.stat().st_size


def test_all_of_a_file_is_fetched_once(served, path, tmp_path):
    for run in (
        lambda url: cr.decode(url).coeffs_khwc,
        lambda url: cr.relight(url, LIGHT),
        lambda url: cr.read_encoded(url)[0].to_bytes(),
    ):
        served.ranges.clear()
        np.testing.assert_array_equal(run(f"{served.url}/view.h5"), run(path))
        assert sorted(served.ranges) == sorted(set(served.ranges))
        assert count_bytes(served) <= len(served.content)
    assert call("decode", f"{served.url}/view.h5", tmp_path / "o.h5").code == 0
    np.testing.assert_array_equal(cr.read_fit(tmp_path / "o.h5").coeffs_khwc, cr.decode(path).coeffs_khwc)
    assert call("unpack", f"{served.url}/view.h5", tmp_path / "photos", "--format", "png").code == 0
    assert len(list((tmp_path / "photos").iterdir())) == 10


def test_info_reads_no_payload(served, path):
    ended = call("info", f"{served.url}/view.h5", "--json")
    assert ended.code == 0, ended.err
    facts, here = ended.json, call("info", path, "--json").json
    assert facts.pop("fetched")["bytes"] < 50_000
    assert facts.pop("file") == f"{served.url}/view.h5"
    del here["file"]
    assert facts == here


def test_other_verbs_and_other_files(path, tmp_path):
    fitted = make_fit(60, 70)
    cr.write_fit(tmp_path / "fit.h5", fitted)
    cr.encode(fitted, "half", out=tmp_path / "half.h5")
    images = np.clip(255 * cr.relight(fitted, fitted.directions_i3), 0, 255).astype(np.uint8)
    cr.write_stack(tmp_path / "stack.h5", LightStack(images, fitted.directions_i3, 255.0, "linear"))
    for name in ("fit.h5", "half.h5"):
        with serving((tmp_path / name).read_bytes()) as one, serving((tmp_path / "stack.h5").read_bytes()) as other:
            found = cr.measure(f"{one.url}/{name}", f"{other.url}/stack.h5")
            assert found == cr.measure(tmp_path / name, tmp_path / "stack.h5")
            np.testing.assert_array_equal(cr.relight(f"{one.url}/{name}", LIGHT), cr.relight(tmp_path / name, LIGHT))
            ended = call("relight", f"{one.url}/{name}", tmp_path / "o.png", "--light", "0,0,1", "--region", "5,5,9,9")
            assert ended.code == 0, ended.err
            assert call("export", f"{one.url}/{name}", tmp_path / f"{name}.dds").code == 0


def test_damage_far_away(path, tmp_path):
    number, rows, columns = find_unit(2, 300, 600)
    with serving(damage(path, tmp_path / "broken.h5", number).read_bytes()) as served:
        url = f"{served.url}/view.h5"
        np.testing.assert_array_equal(  # which hangs on nothing that is damaged
            cr.relight(url, LIGHT, region=(0, 0, 60, 60)), cr.relight(path, LIGHT, region=(0, 0, 60, 60))
        )
        ended = call("relight", url, tmp_path / "o.exr", "--light", "0,0,1", "--region", "600,300,50,50")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert f"unit {number} of the klt body is damaged" in ended.err
        report = cr.Report()
        found = cr.relight(url, LIGHT, salvage=True, report=report)
        far = outside(rows, columns, 2)
        np.testing.assert_array_equal(found[far], cr.relight(path, LIGHT)[far])
        assert [each["level"] for each in report.facts["damaged"]] == [2]


def fail_from(number, action):
    """Return a fault that happens from so many answers on."""
    seen = []

    def fault(handler):
        seen.append(handler.path)
        return len(seen) > number and (action(handler), True)[1]

    return fault


def once(action):
    seen = []

    def fault(handler):
        seen.append(handler.path)
        return len(seen) == 2 and (action(handler), True)[1]

    return fault


def cut(handler):
    start, end = handler.asked()
    handler.reply(
        206,
        b"xyz",
        {
            "Content-Range": f"bytes {start}-{end - 1}/{len(handler.server.served.content)}",
            "Content-Length": str(end - start),
        },
    )
    handler.hang_up()


def change_tag(handler):
    handler.answer(ETag='"two"')


def move_to(place):
    return lambda handler: handler.reply(302, b"", {"Location": place})


FAULTS = {
    "no ranges": (lambda h: h.reply(200, h.server.served.content), "sends whole files only, no ranges of bytes"),
    "404": (lambda h: h.reply(404, b"no"), "there is no such file (404 Not Found)"),
    "403": (lambda h: h.reply(403, b"no"), "it may not be read (403 Forbidden)"),
    "503": (lambda h: h.reply(503, b"busy"), "the server answers 503 Service Unavailable"),
    "cut short": (cut, "the answer was cut short, twice: 3 of "),
    "hangs up": (lambda h: h.hang_up(), "the answer was cut short, twice"),
    "silent": (lambda h: time.sleep(1.5), "the server is too slow: no answer in 0.4 s (CLRELIGHT_TIMEOUT allows more)"),
    "drips": (lambda h: h.drip(0.02), "the server is too slow"),
    "other range": (lambda h: h.answer(**{"Content-Range": "bytes 7-9/100"}), "answers 'bytes 7-9/100' where bytes"),
    "no range": (lambda h: h.answer(**{"Content-Range": None}), "the server answers '' where bytes"),
    "compressed": (lambda h: h.answer(**{"Content-Encoding": "gzip"}), "the server sends it compressed"),
    "in a circle": (move_to("/view.h5"), "from place to place, more than 5 times"),
    "to a file": (move_to("file:///etc/hosts"), "names no host"),
    "to ftp": (move_to("ftp://localhost/x"), "the server sends to ftp://localhost/x, which is not followed"),
    "nowhere": (lambda h: h.reply(301, b""), "the server answers 301, and not where the file is"),
    "no HTTP": (lambda h: h.wfile.write(b"220 hello\r\n") and h.hang_up(), "does not answer as HTTP has it"),
}


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("name", FAULTS)
def test_a_bad_server_is_one_line(served, tmp_path, monkeypatch, name, number):
    monkeypatch.setenv("CLRELIGHT_TIMEOUT", "0.4")
    action, told = FAULTS[name]
    served.fault = fail_from(number, action)
    ended = call("relight", f"{served.url}/view.h5", tmp_path / "o.png", "--light", "0,0,1", "--region", "0,0,99,99")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
    assert ended.err.startswith(f"clrelight: {served.url}/view.h5: ")
    assert told in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("salvage", [False, True])
@pytest.mark.parametrize("change", ["tag", "size"])
def test_a_file_that_changes_is_refused(served, change, salvage):
    """Also where damage is let pass: what cannot be fetched is not damaged."""

    def cut_file(handler):
        served.content = served.content[:-1]
        handler.answer()

    served.fault = fail_from(1, change_tag if change == "tag" else cut_file)
    with pytest.raises(RemoteError, match=r"view\.h5 changed while it was read: begin again"):
        cr.relight(f"{served.url}/view.h5", LIGHT, salvage=salvage)


@pytest.mark.parametrize("action", [cut, lambda h: h.hang_up()])
def test_what_breaks_once_is_tried_again(served, path, action):
    served.fault = once(action)
    np.testing.assert_array_equal(cr.relight(f"{served.url}/view.h5", LIGHT, level=2), cr.relight(path, LIGHT, level=2))


def test_servers_that_send_elsewhere(served, path):
    small = cr.relight(path, LIGHT, level=4)
    with serving(b"") as first:
        first.fault = fail_from(0, move_to(f"{served.url}/there/view.h5?key=a%20b"))
        np.testing.assert_array_equal(cr.relight(f"{first.url}/view.h5", LIGHT, level=4), small)
        assert len(first.paths) == 1
        assert set(served.paths) == {"/there/view.h5?key=a%20b"}
    served.fault = lambda h: h.path == "/old/view.h5" and (move_to("../new.h5")(h), True)[1]
    np.testing.assert_array_equal(cr.relight(f"{served.url}/old/view.h5", LIGHT, level=4), small)
    assert served.paths[-1] == "/new.h5"


def test_secure_servers(path, tmp_path, monkeypatch):
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("no openssl to make a certificate with")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subject = ["-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"]
    made = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", certificate, *subject]
    subprocess.run(made, check=True, capture_output=True)
    with serving(path.read_bytes(), (certificate, key)) as secure, serving(path.read_bytes()) as plain:
        url = f"{secure.url}/view.h5"
        assert url.startswith("https://")
        with pytest.raises(InputError, match=r"the certificate of 127\.0\.0\.1 is not trusted: self.signed"):
            cr.relight(url, LIGHT, level=4)
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        small = cr.relight(path, LIGHT, level=4)
        np.testing.assert_array_equal(cr.relight(url, LIGHT, level=4), small)
        plain.fault = lambda h: (move_to(url)(h), True)[1]
        np.testing.assert_array_equal(cr.relight(f"{plain.url}/view.h5", LIGHT, level=4), small)
        plain.fault = None
        secure.fault = lambda h: (move_to(f"{plain.url}/view.h5")(h), True)[1]
        with pytest.raises(RemoteError, match="which is not followed"):
            cr.relight(url, LIGHT, level=4)
        with pytest.raises(RemoteError, match=r"no secure connection to 127\.0\.0\.1"):
            cr.relight(plain.url.replace("http:", "https:") + "/view.h5", LIGHT, level=4)


def test_proxies(served, path, monkeypatch):
    monkeypatch.setenv("http_proxy", served.url)
    monkeypatch.delenv("no_proxy", raising=False)
    small = cr.relight("http://somewhere.invalid:81/view.h5", LIGHT, level=4)
    np.testing.assert_array_equal(small, cr.relight(path, LIGHT, level=4))
    assert set(served.paths) == {"http://somewhere.invalid:81/view.h5"}


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("http://", "names no host"),
        ("http:///view.h5", "names no host"),
        ("http://host:port/view.h5", "is no address of a file"),
        ("http://somebody:secret@host/view.h5", "names and passwords in an address are not sent"),
        ("HTTP://no-such-host.invalid/view.h5", "there is no host no-such-host.invalid"),
    ],
)
def test_addresses_that_are_none(url, told):
    ended = call("info", url)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert told in ended.err
    assert "secret" not in ended.err


def test_nobody_there_and_files_of_others():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/view.h5"
        ended = call("info", url)
    assert (ended.code, ended.err) == (2, f"clrelight: {url}: 127.0.0.1 cannot be reached: Connection refused\n")
    for content, told in ((b"", "is empty, expected an HDF5 file"), (b"<html>" * 20_000, "is not an HDF5 file")):
        with serving(content) as served:
            ended = call("info", f"{served.url}/view.h5")
            assert (ended.code, ended.err.count("\n")) == (2, 1)
            assert told in ended.err


def test_a_timeout_that_is_none(served, monkeypatch):
    for text in ("soon", "0", "-3", "nan", "1e9"):
        monkeypatch.setenv("CLRELIGHT_TIMEOUT", text)
        with pytest.raises(InputError, match="CLRELIGHT_TIMEOUT must be seconds"):
            cr.read_encoded(f"{served.url}/view.h5")


def test_a_damaged_file_far_away_is_refused_as_one_here(path, tmp_path):
    """Each byte of HDF5's own records, changed: whatever is said, it is one line that names the file."""
    content = path.read_bytes()
    with serving(content) as served:
        url = f"{served.url}/view.h5"
        for at in (*range(0, 2000, 97), len(content) - 1000, len(content) - 50):
            changed = bytearray(content)
            changed[at] ^= 0xFF
            served.content = bytes(changed)
            refused = ""
            try:
                assert cr.read_encoded(url)[0].to_bytes() == cr.read_encoded(path)[0].to_bytes()
            except InputError as error:
                refused = str(error)
            assert not refused or (refused.startswith(url) and "\n" not in refused)


def test_reading_is_that_of_a_file(monkeypatch):
    """Random reads, with memory for few of them: right bytes, and of what is held none is fetched again."""
    rng = np.random.default_rng(1)
    content = rng.bytes(300_001)
    with serving(content) as served:
        file = RangedFile(f"{served.url}/x")
        for _ in range(150):
            start, count = int(rng.integers(0, 300_001)), int(rng.integers(0, 20_000))
            if rng.random() < 0.3:
                file.prefetch([(start, start + count), (0, 5), (max(start - 9000, 0), start)])
            assert file.read_at(start, start + count) == content[start : start + count]
        covered = np.zeros(len(content), int)
        for start, end in served.ranges:
            covered[start:end] += 1
        assert covered.max() == 1
        assert file.fetched_bytes == covered.sum()

        monkeypatch.setattr(ranges, "_HELD_BYTES", 40_000)
        file = RangedFile(f"{served.url}/x")
        for _ in range(60):
            start, count = int(rng.integers(0, 300_001)), int(rng.integers(0, 60_000))
            if rng.random() < 0.3:
                file.prefetch([(start, start + count)])
            assert file.read_at(start, start + count) == content[start : start + count]
            file.seek(start)
            assert file.read(100) == content[start : start + 100]
        file.close()
