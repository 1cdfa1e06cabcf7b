import numpy as np
import pytest

from clrelight import selftest
from clrelight.selftest import Statement, run_selftest
from tests.commands import call


@pytest.fixture
def short(monkeypatch):
    """A selftest of few cases."""
    monkeypatch.setattr(selftest, "PRECISION_DEGREES", (4,))
    for name, values in {"DEGREES": (2,), "CAPS": (10,), "SCALES": (1e30,), "FACTORS": (1e-12,)}.items():
        monkeypatch.setattr(selftest, name, values)


def test_everything_holds(device, short):
    statements = list(run_selftest(device))
    assert [s for s in statements if not s.holds] == []
    assert {s.part for s in statements} == {
        *("basis", "cls", "ceb", "uls", "spline", "half", "uniform", "wavelet", "relight", "psnr"),
        *("cls single", "cls double", "ceb double", "spline double"),
    }
    limits = {s.limit for s in statements if s.part == "cls double" and s.what.startswith("image error")}
    assert limits == {2e-7}
    assert len({(s.part, s.case, s.what) for s in statements}) == len(statements)


def test_a_statement_is_no_more_than_its_limit():
    assert Statement("cls", "", "", 1.0, 1.0).holds
    assert not Statement("cls", "", "", np.nextafter(1.0, 2.0), 1.0).holds
    assert not Statement("cls", "", "", float("nan"), 1.0).holds


@pytest.mark.parametrize(("off", "what"), [(1.0 + 1e-4, "image error"), (1.0 + 1e-5, "above the bound"), (np.nan, "")])
def test_a_device_that_is_off_is_found(short, monkeypatch, off, what):
    fit = selftest._fit

    def wrong(*arguments):
        fitted = fit(*arguments)
        fitted.coeffs_khwc[0] *= off
        return fitted

    monkeypatch.setattr(selftest, "_fit", wrong)
    statements = call("selftest", "--json").json["statements"]
    failed = {(s["part"], s["what"]) for s in statements if not s["holds"]}
    assert any(part == "cls" and what in text for part, text in failed)


def test_the_command(short, monkeypatch):
    ended = call("selftest")
    assert (ended.code, ended.err) == (0, "")
    assert "statements hold on" in ended.out.splitlines()[-1]
    told = call("selftest", "--json").json
    assert told["failed"] == 0
    assert all(s["holds"] and s["figure"] <= s["limit"] for s in told["statements"])
    lines = call("selftest", "--markdown").out.splitlines()
    assert len(lines) == 2 + len(told["statements"])
    assert {line.count("|") for line in lines} == {7}
    monkeypatch.setattr(selftest, "run_selftest", lambda device: iter([Statement("cls", "x", "y", 2.0, 1.0)]))
    ended = call("selftest")
    assert ended.code == 1
    assert "0 of 1 statements hold" in ended.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--device", "warp"], "no OpenCL device matches 'warp'; there are"),
        (["--json", "--markdown"], "exclude each other"),
        (["more"], "unexpected extra argument"),
    ],
)
def test_refusals(words, message):
    ended = call("selftest", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert message in ended.err
