"""The only place that knows Rerun: what is sent to it, how its viewer is laid out and led."""

from testbed.views.rerun_door.recording import Recording
from testbed.views.rerun_door.remote import Remote

__all__ = ["Recording", "Remote"]
