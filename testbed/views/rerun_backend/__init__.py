"""Send views to Rerun and control its viewer; the only package that imports Rerun."""

import os

from testbed.core.errors import needs_extra

# Rerun's client writes its log to standard error; its errors are exceptions as well.
os.environ.setdefault("RUST_LOG", "off")
# A user's settings would empty recordings (RERUN=off), or change their rows and timelines.
for _name in [each for each in os.environ if each == "RERUN" or each.startswith("RERUN_")]:
    del os.environ[_name]

with needs_extra("view", "views"):
    from testbed.views.rerun_backend.recording import RerunRecording
    from testbed.views.rerun_backend.remote import RemoteViewer

__all__ = ["RerunRecording", "RemoteViewer"]
