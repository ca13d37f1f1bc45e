"""What tests of every folder share: the modules in `shared`, and which tests run."""

import signal

import pytest
from selection import Selection

# A shell that runs `make test` in the background has it ignore SIGINT, which programs inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# An assertion in these modules prints what differs, as one in a test does.
pytest.register_assert_rewrite("snapshot", "commands", "report_pages", "result_tables")


def pytest_configure(config):
    config.pluginmanager.register(Selection(config), "selection")
