"""Looking at a flight: live in a Rerun viewer, in an .rrd file, or replayed from a log.

Nothing here imports Rerun until a view is opened, and no viewer, present or absent, quick or
dead, changes a run.
"""

from testbed.views.sinks import InMemory, LiveViewer, RrdFile
from testbed.views.view import RerunView, replay

__all__ = ["InMemory", "LiveViewer", "RerunView", "RrdFile", "replay"]
