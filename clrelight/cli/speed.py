"""``clrelight bench --speed``: seconds and bytes beside NumPy, and how they grow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.output import print_facts, print_json, print_notes
from clrelight.cli.progress import progress_bar
from clrelight.cli.tables import print_table

if TYPE_CHECKING:
    from clrelight.speed.plan import Growth

DEFAULT_OUT = "speed.json"


def bench_speed(
    growth: Growth, out: str, *, report: str | None, memory: int, device: str | None, as_json: bool
) -> None:
    """Measure a growth, keep what was found, and print it."""
    from clrelight.report.folder import check_report
    from clrelight.speed.growth_tables import EXPENDABLE, HEADERS, STAGE_HEADERS, point_cells, stage_cells
    from clrelight.speed.record import check_record, write_record
    from clrelight.speed.report import write_speed_report
    from clrelight.speed.run import measure_growth

    check_record(out)
    claim_output(out)
    check_report(report)
    with progress_bar("bench --speed") as bar:
        record = measure_growth(growth, Path(out).resolve().parent, memory=memory, device=device, progress=bar)
    write_record(out, record)
    files: dict[str, Any] = {"file": out}
    if report is not None:
        files["report"] = str(write_speed_report(record, report)[0])
    if as_json:
        print_json({**files, **record})
        return
    print_notes([*record["notes"], *(point["note"] for point in record["points"] if "note" in point)])
    print_facts(record["environment"])
    click.echo()
    print_table(STAGE_HEADERS, [stage_cells(row) for row in record["stages"]], expendable=("peer's", "peer ms"))
    click.echo()
    print_table(HEADERS, [point_cells(point) for point in record["points"]], expendable=EXPENDABLE)
    click.echo()
    print_facts(files)
