"""The benchmark that counts the tables of unit streams runs on the coder of today."""

import sys

import numpy as np

import clrelight as cr
from benchmarks.unit_tables import main
from clrelight.codec.entropy.unit_streams import CONTEXTS, FLAGS, ONE, SYMBOLS
from tests.commands import ROOT


def test_tables_are_counted_in_the_format_that_streams_start_from(tmp_path, monkeypatch):
    y, x = np.mgrid[0:64, 0:64] / 10.0
    coeffs_khwc = np.stack([np.cos(x), np.sin(y), np.cos(x + y), np.sin(x - y)])[..., None].astype(np.float32)
    fitted = cr.CoefficientMap(
        coeffs_khwc, degree=1, method="uls", peak=1.0, transfer="linear", directions_i3=np.eye(3)[[2]]
    )
    cr.write_fit(tmp_path / "f.h5", fitted)
    monkeypatch.setattr(sys, "argv", ["unit_tables", str(tmp_path / "f.h5"), "--out", str(tmp_path / "t")])
    monkeypatch.setattr("benchmarks.unit_tables.RATES", (0.3, 1.0))
    main()
    made = (tmp_path / "t").read_bytes()
    before = (ROOT / "clrelight" / "codec" / "entropy" / "units.tables").read_bytes()
    assert len(made) == len(before)
    assert made != before
    zeros, worth = np.frombuffer(made[CONTEXTS * SYMBOLS :], "<u2").reshape(FLAGS, 2).T
    assert (zeros > 0).all()
    assert (zeros < ONE).all()
    assert (worth == 20).all()
