import re

import pytest

from clrelight import kernel_source
from clrelight.device import open_device
from clrelight.errors import KernelBuildError
from clrelight.kernel_source import kernel_folder, kernel_for, read_kernel_source


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty kernel folder, with a space in its path."""
    path = tmp_path / "my kernels"
    (path / "common").mkdir(parents=True)
    monkeypatch.setattr(kernel_source, "kernel_folder", lambda: path)
    read_kernel_source.cache_clear()
    yield path
    read_kernel_source.cache_clear()


def test_a_checkout_finds_its_kernels():
    kernel_folder.cache_clear()
    files = {path.relative_to(kernel_folder()).as_posix() for path in kernel_folder().rglob("*.cl")}
    assert {"matmul.cl", "fit/cls.cl", "fit/ceb.cl", "metrics/relit_error.cl"} <= files


def test_an_installed_package_comes_first(tmp_path, monkeypatch):
    installed, checkout = tmp_path / "installed", tmp_path / "checkout"
    monkeypatch.setattr(kernel_source, "_PACKAGE_FOLDER", installed)
    monkeypatch.setattr(kernel_source, "_CHECKOUT_FOLDER", checkout)
    kernel_folder.cache_clear()
    try:
        with pytest.raises(FileNotFoundError, match=r"installed.*checkout.*reinstall"):
            kernel_folder()
        (checkout / "common").mkdir(parents=True)
        assert kernel_folder() == checkout
        kernel_folder.cache_clear()
        (installed / "common").mkdir(parents=True)
        assert kernel_folder() == installed
    finally:
        kernel_folder.cache_clear()


def test_a_gpu_gets_the_twin_where_there_is_one():
    assert kernel_for("fit/cls.cl", "gpu") == "fit/cls.gpu.cl"
    assert kernel_for("fit/cls.cl", "cpu") == "fit/cls.cl"
    assert kernel_for("fit/cls_columns.cl", "gpu") == "fit/cls_columns.cl"
    # A twin stands beside what it is the twin of, and has kernels of the same names.
    for twin in kernel_folder().rglob("*.gpu.cl"):
        texts = [path.read_text("ascii") for path in (twin, twin.with_name(twin.name.replace(".gpu", "")))]
        of_gpu, of_cpu = (set(re.findall(r"void\s+(\w+)\(", text)) for text in texts)
        assert of_gpu & of_cpu, twin


def test_every_include_of_every_kernel_resolves():
    read_kernel_source.cache_clear()
    for path in sorted(kernel_folder().rglob("*.cl")):
        file = path.relative_to(kernel_folder()).as_posix()
        assert "#include" not in read_kernel_source(file)


def test_includes_are_taken_once_with_true_lines(folder):
    (folder / "common" / "a.clh").write_text("int a;\n")
    (folder / "common" / "b.clh").write_text('  #  include "common/a.clh"\nint b;\n')
    (folder / "x.cl").write_text('// first\n#include "common/b.clh"\n#include "common/a.clh"\nint x;')
    assert read_kernel_source("x.cl").splitlines() == [
        '#line 1 "x.cl"',
        "// first",
        '#line 1 "common/b.clh"',
        '#line 1 "common/a.clh"',
        "int a;",
        '#line 2 "common/b.clh"',
        "int b;",
        '#line 3 "x.cl"',
        '#line 4 "x.cl"',
        "int x;",
    ]


def test_an_include_of_itself_ends(folder):
    (folder / "common" / "a.clh").write_text('#include "common/b.clh"\n')
    (folder / "common" / "b.clh").write_text('#include "common/a.clh"\n')
    (folder / "x.cl").write_text('#include "common/a.clh"\n')
    assert read_kernel_source("x.cl").count("#line 1") == 3


def test_build_error_names_file_line_and_defines(folder):
    (folder / "common" / "broken.clh").write_text("#define N 1\n\n\nthis is no OpenCL;\n")
    (folder / "outer.cl").write_text('#include "common/broken.clh"\n__kernel void f(__global int *a_p) {}\n')
    with pytest.raises(KernelBuildError) as caught:
        open_device().launch("outer.cl", "f", (1,), defines={"TILE": 7})
    assert caught.value.file == "outer.cl"
    assert caught.value.defines == {"TILE": 7}
    assert "broken.clh:4:" in caught.value.log
    assert str(caught.value).startswith("outer.cl does not build (defines: TILE=7): error: ")
    assert "broken.clh:4:" in str(caught.value).partition("\n")[0]  # before all that drivers say around it


def test_build_error_names_a_line_after_an_include(folder):
    (folder / "common" / "long.clh").write_text("//\n" * 40)
    (folder / "late.cl").write_text('//\n#include "common/long.clh"\n//\nnonsense here;\n')
    with pytest.raises(KernelBuildError, match=r"late\.cl:4:"):
        open_device().launch("late.cl", "f", (1,))


@pytest.mark.parametrize(
    ("file", "defines", "names"),
    [
        ("fit/cls.cl", {}, "ROOM must be defined"),
        ("fit/ceb.cl", {}, "CROSSING must be defined"),
        ("metrics/relit_error.cl", {"SAMPLE_T": "float", "SAMPLE_HALF": 0}, "ENCODE must be defined"),
        ("metrics/relit_error.cl", {"SAMPLE_T": "float", "SAMPLE_HALF": 0, "ENCODE": 0}, "COEFF_HALF must be defined"),
    ],
)
def test_a_missing_define_is_an_error(device, file, defines, names):
    with pytest.raises(KernelBuildError, match=names):
        device.launch(file, "f", (1,), defines=defines)
