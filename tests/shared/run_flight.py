"""Short flights, their fingerprints and what their laws received, for tests of whole runs."""

import hashlib
import textwrap

import numpy as np

from testbed.atmosphere import turbulence_field
from testbed.flight.loop import fly
from testbed.plan.world import build
from testbed.scenario import library, load_scenario, set_duration

SECONDS = 20.0
NOISY = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")
MINUTE = ("scenario.duration_s=60", "scenario.windows=null", "scenario.published=null")


class Collector:
    """Keeps every frame it sees."""

    def __init__(self):
        self.frames = []

    def begin(self, info):
        self.info = info

    def observe(self, sample):
        self.frames.append(sample)

    def end(self, summary, events):
        self.summary, self.events = summary, events


def short(*changes, seconds=SECONDS):
    return set_duration(load_scenario("simulation-3", ["log.mcap=false", *changes]), seconds)


def fly_samples(*changes, seconds=SECONDS):
    collector = Collector()
    world = build(short(*changes, seconds=seconds))
    assert fly(world, [collector], lambda now, due: False) == "completed"
    return collector.frames


RECORDER = """
    class Recorder:
        received = []  # of the class: an attribute of its own may not change

        def __init__(self, config):
            self.hbh23 = config.hbh23

        def start(self, own):
            return self.hbh23.start(own)

        def step(self, now, own, inbox, memory):
            copies = [type(each)(*(array.copy() for array in each)) for each in (own, inbox)]
            self.received.append((now, *copies))
            return self.hbh23.step(now, own, inbox, memory)
"""


def recorder(folder):
    """Write an own law that is [HBH23]'s and records its inputs; return the change it takes."""
    path = folder / "recorder.py"
    path.write_text(textwrap.dedent(RECORDER))
    return f"controller.law={path}:Recorder"


def fly_with_recorder(scenario):
    """Fly a scenario whose law is a `recorder`.

    Returns:
        The samples, and for each control step its time, own estimates and inbox.
    """
    world, collector = build(scenario), Collector()
    (group,) = world.formation.control.groups
    received = group.law.received
    received.clear()  # inputs of the check of the law before the flight
    assert fly(world, [collector], lambda now, due: False) == "completed"
    return collector.frames, received


def first_minute(folder):
    """Write the begin of a recorded flight, which is read sooner; return the changes it takes."""
    whole = library() / "scenarios/data/arduplane-auto-leader-rascal.csv"
    path = folder / "leader.csv"
    path.write_text("\n".join(whole.read_text().split("\n")[:775]))
    return (f"leader.path.file={path}", *MINUTE)


def small_grids(monkeypatch):
    """Let fields of coherent turbulence have fewer points, which are drawn sooner."""
    monkeypatch.setattr(turbulence_field, "COUNTS", (32, 24))


def arrays(frame):
    for record in ("truth", "estimate", "air", "command", "surfaces", "formation"):
        values = getattr(frame, record)
        for name in type(values).__annotations__:
            yield f"{record}.{name}", np.asarray(getattr(values, name))


def fingerprint(frames):
    """A digest of every bit of every frame."""
    digest = hashlib.sha256()
    for frame in frames:
        digest.update(f"{frame.tick} {frame.time_s!r} {frame.events}".encode())
        for name, array in arrays(frame):
            digest.update(f"{name} {array.dtype} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
