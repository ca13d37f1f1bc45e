"""Show a flight: live in a Rerun viewer, in an .rrd file, as a picture, or replayed.

Rerun is imported when a view is opened. No viewer, missing, slow or killed, changes a run.
"""

from testbed.views.recorded_runs import replay, screenshot, software_picture
from testbed.views.view import FAST_HZ, InMemory, LiveViewer, RerunView, RrdFile, ViewTarget

__all__ = [
    "FAST_HZ",
    "InMemory",
    "LiveViewer",
    "RerunView",
    "RrdFile",
    "ViewTarget",
    "replay",
    "screenshot",
    "software_picture",
]
