import os
from pathlib import Path

import pytest


@pytest.fixture
def device(request, monkeypatch):
    """Return the default device; `tests.styles.both_styles` chooses kernels, also for devices that the test opens."""
    from clrelight.device import STYLE_VARIABLE, open_device

    if hasattr(request, "param"):
        monkeypatch.setenv(STYLE_VARIABLE, request.param)
    return open_device()


@pytest.fixture(scope="session")
def real_data():
    """Return the folder of the real stacks, or skip with the reason."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CLRELIGHT_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"real data is absent: no folder {folder} (set CLRELIGHT_DATA)")
    return folder
