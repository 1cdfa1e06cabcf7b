"""The report of an experiment: tables and pictures beside the paper's, and the page that ties them together."""

from clrelight.report.markup import summary_rows
from clrelight.report.tables import Table, all_rows, table_i, table_iii
from clrelight.report.writer import write_report

__all__ = ["Table", "all_rows", "summary_rows", "table_i", "table_iii", "write_report"]
