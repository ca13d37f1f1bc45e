"""Send views to Rerun and control its viewer; the only package that imports Rerun."""

import os

from testbed.core.errors import needs_extra

# Rerun's client writes its log to standard error; its errors are exceptions as well.
os.environ.setdefault("RUST_LOG", "off")

with needs_extra("view", "views"):
    from testbed.views.rerun_backend.recording import RerunRecording
    from testbed.views.rerun_backend.remote import RemoteViewer

__all__ = ["RerunRecording", "RemoteViewer"]
