"""Looking at a flight: live in a Rerun viewer, in an .rrd file, as a picture, or replayed.

Nothing here imports Rerun until a view is opened, and no viewer, present or absent, quick or
dead, changes a run.
"""

from testbed.views.replay import replay
from testbed.views.shot import shoot
from testbed.views.sinks import InMemory, LiveViewer, RrdFile, Sink
from testbed.views.view import FAST_HZ, RerunView

__all__ = ["FAST_HZ", "InMemory", "LiveViewer", "RerunView", "RrdFile", "Sink", "replay", "shoot"]
