"""What may import what: a lower floor never knows of a higher one, so that each part can be read, and used, alone."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

import clrelight

ROOT = Path(clrelight.__file__).parent
FLOORS = [
    {
        *("arrays", "errors", "conventions", "configurable", "described", "text_rows", "dome_files", "interrupts"),
        *("memory", "recycling", "search", "streaming", "statements", "tiles"),
    },
    {"harmonics", "bases", "durable", "remote", "threads"},
    {"opencl", "device", "kernel_source", "matmul", "matmul_gpu"},
    {
        *(
            "dataset",
            "directions",
            "holdout",
            "lights",
            "light_codes",
            "light_columns",
            "light_files",
            "masks",
            "negatives",
        ),
        *(
            "plan_lights",
            "sampling",
            "image_bands",
            "image_encoding",
            "image_colours",
            "image_header",
            "image_names",
            "image_parts",
            "image_set",
        ),
        *("image_sink", "images", "passes", "radiance_header", "surface"),
    },
    {"fit", "codec", "lighting", "brdf", "shrm", "transfer", "variation", "metrics", "perception", "relight"},
    {
        *("store", "exchange", "export", "ingest", "results"),
        *("selftest", "selftest_packing", "selftest_photographs", "selftest_surfaces", "truth"),
    },
    {"jobs"},
    {"experiment", "view"},
    {"report", "speed", "batch", "reproduction"},
    {"cli"},
    {"__main__"},
]
"""From the ground up. Within a floor rooms may use each other, as long as no circle of modules comes of it."""
MOST_LINES, MOST_LINES_OF_A_FUNCTION = 300, 60
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


@functools.cache
def read_trees():
    """Return the syntax tree of each file."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")}


def statements(node, *, for_types=True):
    """Yield all statements within a node, those that are for type checkers alone where asked for."""
    for block in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, block, ()):
            if for_types or not (isinstance(inner, ast.If) and getattr(inner.test, "id", "") == "TYPE_CHECKING"):
                yield inner
                yield from statements(inner, for_types=for_types)


@functools.cache
def read_imports():
    """Return the modules of clrelight that each of its modules imports, at any time."""
    files = {
        ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in read_trees()
    }
    imports = {}
    for module, path in files.items():
        found = imports[module] = set()
        for node in statements(read_trees()[path], for_types=False):
            if isinstance(node, ast.Import):
                found.update(alias.name for alias in node.names if alias.name in files)
            elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clrelight":
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    found.add(inner if inner in files else node.module)
    return imports


def room_of(module):
    """Return the package or module right under clrelight; None for clrelight itself, whose names are lazy."""
    return module.split(".")[1] if "." in module else None


def test_every_room_has_a_floor():
    assert {room_of(module) for module in read_imports()} - {None} == set(FLOOR_OF)


def test_no_room_knows_of_a_higher_floor():
    upward = [
        f"{module} imports {other}"
        for module, others in read_imports().items()
        for other in others
        if room_of(module) and room_of(other) and FLOOR_OF[room_of(other)] > FLOOR_OF[room_of(module)]
    ]
    assert upward == []


def test_no_circle_of_modules():
    left = {module: set(others) - {module, "clrelight"} for module, others in read_imports().items()}
    while free := [module for module, others in left.items() if not others & left.keys()]:
        for module in free:
            del left[module]
    assert sorted(left) == []


def test_files_are_short():
    lines = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8").count("\n") for path in ROOT.rglob("*.py")}
    assert {name: n for name, n in lines.items() if n > MOST_LINES} == {}


def test_functions_are_short():
    long = {}
    for path, tree in read_trees().items():
        for node in statements(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                text = node.body[0] if ast.get_docstring(node) is not None else None
                lines = node.end_lineno - node.lineno + 1 - (text.end_lineno - text.lineno + 1 if text else 0)
                if lines > MOST_LINES_OF_A_FUNCTION:
                    long[f"{path.relative_to(ROOT).as_posix()}:{node.name}"] = lines
    assert long == {}


@pytest.mark.parametrize(
    "module", ["clrelight", "clrelight.harmonics.rotation", "clrelight.images", "clrelight.errors"]
)
def test_mathematics_and_images_load_no_files_or_devices(module):
    code = f"import sys, {module}; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert module in loaded
    assert not loaded & {"h5py", "pyopencl", "click", "rich", "matplotlib"}


def test_the_verbs_know_no_command_line():
    below = [
        module for module in read_imports() if room_of(module) and FLOOR_OF[room_of(module)] <= FLOOR_OF["experiment"]
    ]
    for module in below:
        path = ROOT.parent / Path(*module.split("."))
        text = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
        assert "import click" not in text, module
        assert "from rich" not in text, module


def test_the_command_line_starts_no_threads_before_it_watches_signals():
    """NumPy's BLAS starts threads, which would take signals that only the watching thread is to get."""
    code = "import sys, clrelight.cli.app; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & {"numpy", "scipy", "h5py", "pyopencl"}
