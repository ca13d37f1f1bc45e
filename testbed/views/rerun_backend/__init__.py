"""Send views to Rerun and control its viewer; the only package that imports Rerun."""

from testbed.core.errors import needs_extra

with needs_extra("view", "views"):
    from testbed.views.rerun_backend.recording import RerunRecording
    from testbed.views.rerun_backend.remote import RemoteViewer

__all__ = ["RerunRecording", "RemoteViewer"]
