"""A map of which a few pixels outshine all others: said, or refused with the pixel's place."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.codec import encode
from clrelight.codec.formats.klt import Klt
from clrelight.errors import InputError
from clrelight.jobs.outshining import outshining_notes
from clrelight.sampling import make_pattern
from clrelight.store import write_fit
from tests.test_klt_encoding import rough_map


def flat_map(*hot):
    coeffs = np.ones((4, 40, 50, 3), np.float32)
    for row, column, value in hot:
        coeffs[:, row, column] = value
    return coeffs


def notes_of(coeffs, rows=40):
    parts = [(first, coeffs[:, first : first + rows]) for first in range(0, 40, rows)]
    return outshining_notes(parts, coeffs.shape)


@pytest.mark.parametrize("hot", [(), [(3, 4, 30.0)], [(3, 4, 1000.0), (30, 4, 1000.0), (31, 7, 1000.0)]])
def test_what_others_have_a_part_in_is_not_told(hot):
    assert notes_of(flat_map(*hot)) == []


@pytest.mark.parametrize("value", [3e3, -1e10, 1e30])
def test_the_brightest_pixel_is_told(value):
    coeffs = flat_map((3, 4, value), (9, 9, value / 10))
    (note,) = notes_of(coeffs)
    assert note.startswith("2 pixels of 2000 hold over 99.9%")
    assert "row 3, column 4" in note
    assert notes_of(coeffs, 7) == notes_of(coeffs, 1) == [note]  # of parts as of the whole
    assert notes_of(coeffs[:, ::-1], 7) == [note.replace("row 3", "row 36")]
    assert notes_of(np.zeros((1, 40, 50, 1), np.float32)) == []


def test_encode_tells_it_of_a_file_beyond_memory(tmp_path, monkeypatch):
    coeffs = flat_map((33, 4, 1e5))
    write_fit(tmp_path / "fit.h5", cr.CoefficientMap(coeffs, 1, "uls", 1.0, "linear", make_pattern("uniform", 9)))
    monkeypatch.setattr("clrelight.jobs.parts.fits", lambda *arguments: False)
    report = cr.Report()
    cr.encode(tmp_path / "fit.h5", "uniform", out=tmp_path / "enc.h5", report=report)
    assert [note for note in report.notes if "row 33, column 4" in note]


def test_encode_tells_it():
    fitted = cr.CoefficientMap(flat_map((3, 4, 1e5)), 1, "uls", 1.0, "linear", make_pattern("uniform", 9))
    report = cr.Report()
    cr.encode(fitted, "uniform", report=report)
    assert [note for note in report.notes if "row 3, column 4" in note]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("options", [{"step": 0.05}, {"rate": 0.2}])
@pytest.mark.parametrize("value", [1e9, -1e18, 3.4e38])
def test_klt_names_a_pixel_that_it_cannot_hold(device, options, value):
    """One that no axes are of: its indices would be cut off, or its squares be infinite and no axis worth its bits."""
    coeffs = rough_map(330, 310)
    coeffs[1, 200, 301] = value
    with pytest.raises(InputError, match=r"\(k, row, column, channel\) = \(1, 200, 301, 0\) is .*too large"):
        encode(coeffs, Klt(**options), device)


@pytest.mark.parametrize("options", [{"step": 0.05}, {"rate": 1.0}])
def test_numbers_below_what_klt_holds_are_not_made_zeros(device, options):
    coeffs = np.zeros((4, 9, 11, 3), np.float32)
    assert encode(coeffs, Klt(**options), device).info["planes"] == 0
    coeffs[0, 3, 4, 1] = 1e-45
    with pytest.raises(InputError, match="0 everywhere"):
        encode(coeffs, Klt(**options), device)
