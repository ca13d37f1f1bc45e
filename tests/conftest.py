"""Has pytest find what tests of every folder share: the modules beside this file."""

import signal

import pytest

# A shell that runs `make test` in the background has it ignore SIGINT, which programs inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# An assertion in these modules prints what differs, as one in a test does.
pytest.register_assert_rewrite("snapshot", "commands", "report_pages", "result_tables")
