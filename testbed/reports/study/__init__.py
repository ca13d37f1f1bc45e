"""Reports of studies: one HTML file with figures and tables, made from the table of a study.

The package gets numbers and texts; `testbed.cli.study_report` reads the files.
"""

from testbed.reports.study.figures import study_figures
from testbed.reports.study.latex import latex_table
from testbed.reports.study.page import study_page
from testbed.reports.study.study_data import StudyData, StudyFlights
from testbed.reports.study.tables import study_tables, table_file, write_tables

__all__ = [
    "StudyData",
    "StudyFlights",
    "latex_table",
    "study_figures",
    "study_page",
    "study_tables",
    "table_file",
    "write_tables",
]
