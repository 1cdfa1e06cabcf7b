"""The command that draws the papers' figures of surfaces."""

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import surface_figures
from clrelight.images import read_image

pytest.importorskip("trimesh", reason="surfaces need trimesh: pip install 'clrelight[surfaces]'")
pytest.importorskip("embreex", reason="surfaces need embreex: pip install 'clrelight[surfaces]'")


def test_figures_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(surface_figures, "DATA", tmp_path / "nowhere")
    ended = CliRunner().invoke(
        surface_figures.main, ["--out", str(tmp_path), "--scale", "0.15", "--samples", "16"], catch_exceptions=False
    )
    assert "figures 1 and 4 are left out" in ended.output
    found = sorted(path.name for path in tmp_path.glob("*.jpg"))
    assert found == [f"surface_{name}.jpg" for name in ("bounce", "functions", "lights", "product", "transfer")]
    for name in found:
        picture = read_image(tmp_path / name)
        assert picture.std() > 5
    # In the corner of the room it is darker with shadows, and lighter again with bounces.
    transfer = read_image(tmp_path / "surface_transfer.jpg")
    flat, dark, light = (part.mean() for part in np.split(transfer, 3, axis=1))
    assert dark < light
    assert dark < flat
