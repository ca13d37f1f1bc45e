"""Short flights and their fingerprints, for the tests of whole runs."""

import hashlib

import numpy as np

from testbed.scenario import load, shorten
from testbed.sim.loop import fly
from testbed.sim.world import build

SECONDS = 20.0
NOISY = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")
# A follower whose slot lies below the ground.
DIVE = """
scenario: {schema: 1, name: dive, duration_s: 30}
leader:
  aircraft: rascal110
  start: {altitude_m: 20}
  path:
    kind: mission
    airspeed_mps: 22
    legs: [{kind: waypoints, points_m: [[2000, 0, 20], [4000, 0, 20]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-10, 5, 0]}
formation:
  offsets_m: {uav1: [-10, 5, 40]}
  leader_gains: {uav1: 1}
"""


class Collector:
    """Keeps every frame it sees."""

    def __init__(self):
        self.frames = []

    def begin(self, info):
        self.info = info

    def observe(self, frame):
        self.frames.append(frame)

    def end(self, summary, events):
        self.summary, self.events = summary, events


def short(*changes, seconds=SECONDS):
    return shorten(load("simulation-3", ["log.mcap=false", *changes]), seconds)


def flown(*changes, seconds=SECONDS):
    collector = Collector()
    assert (
        fly(build(short(*changes, seconds=seconds)), [collector], lambda now, due: False) == "flown"
    )
    return collector.frames


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
