"""A flown run as one page for people: read from its log, drawn, and put into one file.

It looks at logs, never at a flight: nothing here can slow a run down or change it.
"""

from testbed.report.flight import Flight, read_flight
from testbed.report.page import write_figures, write_page

__all__ = ["Flight", "read_flight", "write_figures", "write_page"]
