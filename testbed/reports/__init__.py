"""Reports of runs: one HTML file with figures and tables, made from a log.

A report reads logs only; it cannot slow down or change a run.
"""

from testbed.reports.figure_compare import compare_figure, run_labels
from testbed.reports.figures import run_figures
from testbed.reports.html import figure_file, save_figures, write_page
from testbed.reports.page import run_page
from testbed.reports.run_data import RunData, read_run

__all__ = [
    "RunData",
    "compare_figure",
    "figure_file",
    "read_run",
    "run_figures",
    "run_labels",
    "run_page",
    "save_figures",
    "write_page",
]
