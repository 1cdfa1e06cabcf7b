import getpass
import os
import tempfile
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # PoCL's cache of kernels is not made for several processes that build at once.
    _cache = f"clrelight-tests-{getpass.getuser()}-{os.environ['PYTEST_XDIST_WORKER']}"
    os.environ["POCL_CACHE_DIR"] = str(Path(tempfile.gettempdir(), _cache))


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
