from dataclasses import replace

import numpy as np
import pytest

from clrelight import selftest, selftest_photographs, selftest_surfaces
from clrelight.selftest import run_selftest
from clrelight.selftest_photographs import check_photographs
from clrelight.selftest_surfaces import check_surfaces
from clrelight.statements import Statement
from tests.commands import call


@pytest.fixture
def short(monkeypatch):
    """A selftest of few cases."""
    monkeypatch.setattr(selftest, "PRECISION_DEGREES", (4,))
    monkeypatch.setattr(selftest_photographs, "KINDS", (("uint8", 255, "srgb"),))
    for name, values in {"DEGREES": (2,), "CAPS": (10,), "SCALES": (1e30,), "FACTORS": (1e-12,)}.items():
        monkeypatch.setattr(selftest, name, values)


def test_everything_holds(device, short):
    statements = list(run_selftest(device))
    assert [s for s in statements if not s.holds] == []
    assert {s.part for s in statements} == {
        *("basis", "cls", "ceb", "uls", "spline", "half", "uniform", "wavelet", "relight", "psnr"),
        *("cls single", "cls double", "ceb double", "spline double"),
        *("cls newton", "cls bisection", "cls paper", "s3tc", "bc6h", "vq", "projection", "irradiance", "curve", "klt"),
        *("constrained mixed", "constrained single", "normals", "reflection", "auto", "spectrum-curve"),
    }
    limits = {s.limit for s in statements if s.part == "cls double" and s.what.startswith("image error")}
    assert limits == {2e-7}
    assert len({(s.part, s.case, s.what) for s in statements}) == len(statements)


def test_photographs_of_every_kind_hold(device):
    statements = list(check_photographs(device))
    assert [s for s in statements if not s.holds] == []
    cases = {s.case for s in statements if s.part == "cls paper"}
    kinds = ("uint8 linear", "uint8 srgb", "uint16 linear", "uint16 srgb", "float16 linear", "float32 srgb")
    assert cases == {f"degree 4, {kind}" for kind in kinds}


@pytest.mark.parametrize(
    ("name", "off", "part"),
    [
        ("decode", 1.01, "bc6h"),
        ("decode", 1.01, "s3tc"),
        ("decode", 1.01, "vq"),
        ("decode", 1.2, "wavelet"),
        ("integrate_irradiance", 1.0001, "irradiance"),
        ("_fit", 1.0001, "cls bisection"),
        ("_fit", 1.0001, "cls paper"),
        ("measure_errors", 1.001, "psnr"),
        ("collect_fit", 1.02, "auto"),
    ],
)
def test_photographs_that_are_off_are_found(device, short, monkeypatch, name, off, part):
    real = getattr(selftest_photographs, name)

    def wrong(*arguments, **options):
        found = real(*arguments, **options)
        if name in ("_fit", "collect_fit"):
            return replace(found, coeffs_khwc=found.coeffs_khwc * np.float32(off))
        return found * off

    monkeypatch.setattr(selftest_photographs, name, wrong)
    assert any(s.part == part and not s.holds for s in check_photographs(device))


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("collect_fit", "constrained mixed"),
        ("NormalSolver", "normals"),
        ("LawSolver", "normals"),
        ("integrate_on_device", "reflection"),
        ("expand_orders", "reflection"),
        ("project_latlong_on_device", "projection"),
    ],
)
def test_surfaces_that_are_off_are_found(device, monkeypatch, name, part):
    real = getattr(selftest_surfaces, name)

    def spoilt(found):
        if name == "collect_fit":
            return replace(found, coeffs_khwc=found.coeffs_khwc * np.float32(1.0001))
        if name == "LawSolver":
            return replace(found, found=spoilt_normals(found.found))
        return spoilt_normals(found) if name == "NormalSolver" else found * 1.001

    def spoilt_normals(found):
        return replace(found, normals_p3=np.roll(found.normals_p3, 1, axis=0))

    def wrong(*arguments, **options):
        if name == "expand_orders" and len(arguments) < 4:
            return real(*arguments, **options)
        made = real(*arguments, **options)
        return (lambda *more: spoilt(made(*more))) if name.endswith("Solver") else spoilt(made)

    monkeypatch.setattr(selftest_surfaces, name, wrong)
    assert any(s.part == part and not s.holds for s in check_surfaces(device))


def test_a_statement_is_no_more_than_its_limit():
    assert Statement("cls", "", "", 1.0, 1.0).holds
    assert not Statement("cls", "", "", np.nextafter(1.0, 2.0), 1.0).holds
    assert not Statement("cls", "", "", float("nan"), 1.0).holds


@pytest.mark.parametrize(("off", "what"), [(1.0 + 1e-4, "image error"), (1.0 + 1e-5, "above the bound"), (np.nan, "")])
def test_a_device_that_is_off_is_found(device, short, monkeypatch, off, what):
    fit = selftest._fit

    def wrong(*arguments):
        fitted = fit(*arguments)
        fitted.coeffs_khwc[0] *= off
        return fitted

    monkeypatch.setattr(selftest, "_fit", wrong)
    assert any(s.part == "cls" and what in s.what and not s.holds for s in run_selftest(device))


def test_the_command(short, monkeypatch):
    told = call("selftest", "--json").json
    assert told["failed"] == 0
    assert all(s["holds"] and s["figure"] <= s["limit"] for s in told["statements"])
    found = [Statement(*(s[name] for name in ("part", "case", "what", "figure", "limit"))) for s in told["statements"]]
    monkeypatch.setattr(selftest, "run_selftest", lambda device: iter(found))
    ended = call("selftest")
    assert (ended.code, ended.err) == (0, "")
    assert f"{len(found)} of {len(found)} statements hold on" in ended.out.splitlines()[-1]
    lines = call("selftest", "--markdown").out.splitlines()
    assert len(lines) == 2 + len(told["statements"])
    assert {line.count("|") for line in lines} == {7}
    monkeypatch.setattr(selftest, "run_selftest", lambda device: iter([Statement("cls", "x", "y", 2.0, 1.0)]))
    ended = call("selftest")
    assert ended.code == 1
    assert "0 of 1 statements hold" in ended.out
    monkeypatch.setattr(selftest, "run_selftest", lambda device: iter([Statement("cls", "x", "y", float("nan"), 1.0)]))
    ended = call("selftest", "--json")
    assert (ended.code, ended.json["failed"]) == (1, 1)


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
