"""A plugin of pytest that writes which files of the testbed the tests of this process execute."""

import json
import os
import sys
import threading
from pathlib import Path

from places import ROOT

executed = set()


def pytest_collection_finish(session):
    for each in (sys, threading):
        each.setprofile(lambda frame, *_: executed.add(frame.f_code.co_filename))


def pytest_sessionfinish(session):
    sys.setprofile(None)
    ours = f"{ROOT / 'testbed'}{os.sep}"
    Path(os.environ["EXECUTED"]).write_text(
        json.dumps(sorted(f for f in executed if f.startswith(ours)))
    )
