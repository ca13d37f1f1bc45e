"""A flown study as one page for people: from the rows of its file, drawn and put into one file.

It is given numbers and texts; who reads files and study pages is outside.
"""

from testbed.report.study.page import write_figures, write_page, write_tables
from testbed.report.study.rows import Rows, Study

__all__ = ["Rows", "Study", "write_figures", "write_page", "write_tables"]
