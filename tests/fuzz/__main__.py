"""Compiled decoders of hostile bytes under clang's libFuzzer, with address and undefined-behaviour sanitisers.

``python -m tests.fuzz --executions 5000000 --only units`` compiles kernels that decode (``build.TARGETS``) as OpenCL C
for the host, with harnesses that launch them as their Python modules do: buffers exactly as large, layouts from the
same functions, memory to work in not initialised, and poisoned between its arrays. Checksums stand before kernels in
Python (``tests.byte_changes``, ``tests.mutations``): here inputs go past them. Seeds are what encoders made. It needs
clang with compiler-rt, which the package does not (Debian: ``apt-get install clang libclang-rt-14-dev``).

A finding ends its process: the input is kept under ``--findings``. An input may compute for 2 seconds.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import click

from clrelight.device import open_device
from tests.fuzz import worlds
from tests.fuzz.build import TARGETS, NoCompilerError, build

SECONDS_EACH = 120
"""After which libFuzzer ends an input that waits; harnesses end one that computes for 2 seconds."""
MEGABYTES = 512
"""What a fuzzer may hold, with its corpus and what sanitisers keep."""


@dataclass(frozen=True)
class Campaign:
    """How much is tried: executions and seconds (0 is without end) of each target, and by how many processes."""

    executions: int
    seconds: int = 0
    workers: int = 1
    seed: int = 1
    findings: Path = Path("results/fuzz")

    def run(self, name: str, edit: Callable[[str], str] = str) -> dict:
        """Build and run a target, its kernels as `edit` changes them; return what came of it."""
        self.findings.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            fuzzer, corpus = build(name, Path(folder), edit), Path(folder) / "corpus"
            corpus.mkdir()
            for number, content in enumerate(worlds.seeds(name, open_device("cpu"))):
                (corpus / f"seed{number}").write_bytes(content)
            start = time.perf_counter()
            with ThreadPoolExecutor(self.workers) as pool:
                done = list(pool.map(lambda worker: self._run(name, fuzzer, corpus, worker), range(self.workers)))
            told = [ended.stderr for ended in done]
            return {
                "target": name,
                "executions": sum(_last(r"stat::number_of_executed_units: (\d+)", text) for text in told),
                "seconds": round(time.perf_counter() - start, 1),
                "edges": max(_last(r" cov: (\d+)", text) for text in told),
                "features": max(_last(r" ft: (\d+)", text) for text in told),
                "peak_mb": max(_last(r"stat::peak_rss_mb: +(\d+)", text) for text in told),
                "findings": [_finding(ended.stderr) for ended in done if ended.returncode],
            }

    def _run(self, name: str, fuzzer: Path, corpus: Path, worker: int) -> subprocess.CompletedProcess[str]:
        options = [
            f"-runs={-(-self.executions // self.workers)}",
            f"-max_total_time={self.seconds}",
            f"-max_len={TARGETS[name].largest_input}",
            f"-timeout={SECONDS_EACH}",
            f"-rss_limit_mb={MEGABYTES}",
            "-detect_leaks=0",  # kernels allocate nothing
            "-print_final_stats=1",
            f"-artifact_prefix={self.findings}/{name.replace(' ', '-')}-",
            f"-seed={self.seed + worker + 1}",
        ]
        # By way of a shell that waits: the most memory that its parent ever held counts as a program's own on Linux.
        command = ["sh", "-c", '"$@"; exit $?', "sh", fuzzer, *options, corpus]
        return subprocess.run(command, capture_output=True, text=True, errors="replace")


def _last(pattern: str, text: str) -> int:
    """Return the last number that a pattern finds."""
    found = re.findall(pattern, text)
    return int(found[-1]) if found else 0


def _finding(text: str) -> str:
    """Return what a fuzzer said of the input that ended it."""
    lines = [
        line for line in text.splitlines() if re.search(r"ERROR|runtime error|harness:|SUMMARY|Test unit written", line)
    ]
    return " | ".join(lines) or text[-2000:]


@click.command()
@click.option("--executions", type=click.IntRange(min=1), default=5_000_000, show_default=True, help="Of each target.")
@click.option("--seconds", type=click.IntRange(min=0), default=0, help="End each target after so long; 0 is never.")
@click.option("--only", metavar="TEXT", default="", help="Only targets whose name holds TEXT.")
@click.option("--workers", type=click.IntRange(min=1), default=os.cpu_count(), show_default=True, help="Processes.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--findings", type=click.Path(path_type=Path), default=Path("results/fuzz"), show_default=True)
def main(executions: int, seconds: int, only: str, workers: int, seed: int, findings: Path) -> None:
    """Fuzz the compiled decoders; print one JSON object for each, exit 1 on a finding and 2 without a compiler."""
    campaign, failed = Campaign(executions, seconds, workers, seed, findings), False
    for name in TARGETS:
        if only not in name:
            continue
        try:
            told = campaign.run(name)
        except NoCompilerError as error:
            click.echo(error, err=True)
            sys.exit(2)
        print(json.dumps(told), flush=True)
        failed |= bool(told["findings"])
    sys.exit(failed)


if __name__ == "__main__":
    main(prog_name="python -m tests.fuzz")
