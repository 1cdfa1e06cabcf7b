"""The recipe for batch systems in docs/batches.md, with an ``sbatch`` that starts the job here."""

import os
import re
import subprocess
import sys

import pytest

from tests.batches import FIT, finish_batch, make_stacks, results_in
from tests.commands import ROOT, call, environment

SBATCH = """#!/bin/sh
cp "$1" "$JOBS/job.sh"
setsid sh "$1" > "$JOBS/job.log" 2>&1 < /dev/null &
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
for job in "$@"; do kill -TERM -- "-$job"; done
"""


def recipe():
    """Return the program of the page, for one job, with a scheduler that only this machine sees."""
    page = (ROOT / "docs" / "batches.md").read_text()
    (code,) = re.findall(r"```python\n(import dask\n.*?)```", page, re.DOTALL)
    code, count = re.subn(r"jobs=\d+", "jobs=1", code)
    assert count == 1
    code = code.replace("    cores=", '    scheduler_options={"host": "127.0.0.1"},\n    cores=')
    return code.replace("print(cluster.scheduler_address)", "print(cluster.scheduler_address, flush=True)")


def test_the_recipe_for_slurm(tmp_path):
    pytest.importorskip("dask_jobqueue", reason="batch systems: pip install dask-jobqueue")
    stacks, programs = make_stacks(tmp_path / "in", ["a", "b"]), tmp_path / "bin"
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    path = os.pathsep.join([str(programs), os.environ["PATH"]])
    code = recipe() + "import sys; sys.stdin.read(); cluster.close()\n"
    cluster = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment(PATH=path, JOBS=str(tmp_path), PYTHONPATH=os.environ.get("PYTHONPATH", str(ROOT))),
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        address = cluster.stdout.readline().strip()
        assert address.startswith("tcp://")
        ended, _, complaint = finish_batch(stacks, tmp_path / "out", *FIT, "--engine", address)
        assert ended == 0, complaint + (tmp_path / "job.log").read_text()
    finally:
        cluster.communicate("", timeout=30)
    assert cluster.returncode == 0
    script = (tmp_path / "job.sh").read_text()
    assert "#SBATCH --cpus-per-task=16" in script
    assert "POCL_MAX_PTHREAD_COUNT=16" in script
    assert script.rstrip().endswith("--nthreads 1")
    assert call("batch", stacks, tmp_path / "alone", *FIT).code == 0
    assert results_in(tmp_path / "out") == results_in(tmp_path / "alone")
