import email
import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import clrelight

ROOT = Path(__file__).resolve().parents[1]

# Opens a device and runs two kernels, one with includes.
PROGRAM = """
import numpy as np
from clrelight.dataset import LightStack
from clrelight.jobs.fit import fit
from clrelight.kernel_source import kernel_folder
stack = LightStack(np.ones((1, 1, 1, 1), np.uint8), np.array([[0.0, 0.0, 1.0]]), 1.0)
print(kernel_folder(), fit(stack, "cls", 0).coeffs_khwc.item())
"""


def kernels_of_checkout():
    return {path.relative_to(ROOT).as_posix() for path in (ROOT / "kernels").rglob("*.cl*")}


def run(command, folder, **environment):
    return subprocess.run(
        command, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, timeout=300
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy of what the project file names, so that nothing is left in the checkout."""
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed, and the wheel is built offline")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("clrelight", "datasets_synth", "kernels"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "LICENSE", ".gitignore"):  # hatchling leaves out what git ignores
        shutil.copy(ROOT / name, source)
    readme = ROOT / "README.md"
    (source / "README.md").write_bytes(readme.read_bytes() if readme.exists() else b"")
    # What `python -m build --wheel --no-isolation` runs, which may be missing itself.
    build = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"
    built = run([sys.executable, "-c", build, str(out)], source)
    assert built.returncode == 0, built.stderr
    (path,) = out.glob("*.whl")
    return path


def test_a_wheel_holds_every_kernel(wheel):
    packed = set(zipfile.ZipFile(wheel).namelist())
    kernels = {name for name in packed if name.endswith((".cl", ".clh"))}
    assert kernels == {f"clrelight/{name}" for name in kernels_of_checkout()}
    assert len(kernels) > 10


def test_a_wheel_holds_every_module(wheel):
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".py")}
    modules = {
        path.relative_to(ROOT).as_posix()
        for name in ("clrelight", "datasets_synth")
        for path in (ROOT / name).rglob("*.py")
    }
    assert packed == modules


def test_a_wheel_holds_the_page_of_the_viewer(wheel):
    packed = set(zipfile.ZipFile(wheel).namelist())
    parts = {path.relative_to(ROOT).as_posix() for path in (ROOT / "clrelight" / "view" / "page").iterdir()}
    assert len(parts) > 15
    assert packed >= parts | {"clrelight/view/skies.npy", "clrelight/codec/entropy/units.tables"}


def test_a_wheel_says_whose_it_is_and_that_it_has_types(wheel):
    packed = zipfile.ZipFile(wheel)
    assert "clrelight/py.typed" in packed.namelist()
    (place,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
    told = email.message_from_bytes(packed.read(place))
    assert (told["License-Expression"], told["Author"]) == ("MIT", "The clrelight authors")
    assert packed.read(place.replace("METADATA", "licenses/LICENSE")) == (ROOT / "LICENSE").read_bytes()
    # One version: of the package, of the wheel, and of the command.
    assert told["Version"] == clrelight.__version__ == place.split("-")[1].removesuffix(".dist")
    assert "clrelight = clrelight.cli:main" in packed.read(place.replace("METADATA", "entry_points.txt")).decode()


def test_there_is_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert ("version" in project, project["dynamic"]) == (False, ["version"])
    done = run([sys.executable, "-m", "clrelight", "--version"], ROOT)
    assert done.stdout == f"clrelight {clrelight.__version__}\n"


def test_an_installed_package_runs_its_own_kernels(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path / "site packages")
    site = str(tmp_path / "site packages")
    done = run([sys.executable, "-c", PROGRAM], tmp_path, PYTHONPATH=site)
    assert done.returncode == 0, done.stderr
    folder, value = done.stdout.strip().rsplit(" ", 1)
    assert Path(folder) == tmp_path / "site packages" / "clrelight" / "kernels"
    assert float(value) == pytest.approx(3.5449, rel=1e-4)


def test_a_bare_checkout_runs_its_kernels(tmp_path):
    done = run([sys.executable, "-c", PROGRAM], tmp_path, PYTHONPATH=str(ROOT))
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.rsplit(" ", 1)[0]) == ROOT / "kernels"


def test_what_a_bare_import_loads():
    # Listing commands and reading a stack need no OpenCL; contexts are never made on import.
    code = "import sys, clrelight.fit, clrelight.metrics, clrelight.relight; print('pyopencl' in sys.modules)"
    done = run([sys.executable, "-c", code], ROOT)
    assert done.stdout.strip() == "False", done.stderr
