"""Scripts of the viewer's page without the page: run by Node where it is there, else by a headless Chromium."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[1] / "clrelight" / "view" / "page"
DECODER = ("bytes.js", "units.js", "details.js", "body.js", "planes.js", "straight.js")
_NODE = """
const fs = require("fs"), vm = require("vm");
const { files, code, data } = JSON.parse(fs.readFileSync(0, "utf8"));
for (const file of files) vm.runInThisContext(fs.readFileSync(file, "utf8"), file);
vm.runInThisContext(`(async (data) => {${code}})`)(data).then((found) => fs.writeSync(1, JSON.stringify(found)));
"""


def evaluate(code, data, files=DECODER, timeout=120):
    """Return what a body of an asynchronous function of `data` returns, behind some of the page's scripts."""
    paths = [str(PAGE / name) for name in files]
    if node := shutil.which("node"):
        sent = json.dumps({"files": paths, "code": code, "data": data})
        # What does not end is a fault of the scripts, and is ended here.
        done = subprocess.run([node, "-e", _NODE], input=sent, capture_output=True, text=True, timeout=timeout)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout or "null")
    from tests.browser import find_chromium, opened_browser

    if not find_chromium():
        pytest.skip("neither node nor chromium is installed: apt-get install chromium")
    scripts = "\n".join(Path(path).read_text("utf-8") for path in paths)
    with opened_browser("about:blank") as page:
        page.evaluate(scripts)
        return page.evaluate(f"(async (data) => {{{code}}})({json.dumps(data)})", timeout=timeout)
