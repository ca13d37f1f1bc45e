"""A synthetic run of random numbers, in which no two fields can be confused."""

import mcap.reader
import numpy as np
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from testbed.core.records import (
    ActuatorCommand,
    AirData,
    Event,
    FbwaCommand,
    FormationState,
    LinkCounters,
    NedOrigin,
    RunInfo,
    Sample,
    VehicleState,
)
from testbed.logs.recorder import McapRecorder

RECORDS = ("truth", "estimate", "air", "command", "surfaces", "formation")
BASE_RATE_HZ, SAMPLE_RATE_HZ = 200, 25


def run_info(followers=3, **changes):
    names = ("leader", *(f"uav{i}" for i in range(1, followers + 1)))
    values = {
        "scenario_name": "synthetic",
        "make_yaml": lambda: "scenario: {name: synthetic}  # é\n",
        "names": names,
        "aircraft": ("rascal110",) * len(names),
        "wingspan_m": (2.8,) * len(names),
        "origin": NedOrigin(38.0, -84.5, 290.0),
        "base_rate_hz": BASE_RATE_HZ,
        "sample_rate_hz": SAMPLE_RATE_HZ,
        "duration_s": 60.0,
        "seed": 7,
        "speed_bounds_mps": ((16.0, 30.0),) * followers,
        "kappa_mps": (3.6,) * followers,
        "roll_limit_rad": (0.8,) * followers,
        "leader_path_ned": np.array([[0.0, 0.0, -100.0], [1.0 / 3.0, 2.0, -100.0]]),
        "windows": {"first": (1.0, 2.0), "second": (2.0, 4.0)},
        "versions": {"testbed": "0.0", "jsbsim": "1.3.3"},
        "integrators": {"rate_rotational": "Euler"},
    }
    return RunInfo(**{**values, **changes})


def run_samples(
    count, followers=3, *, noisy_from=None, lossy_from=None, lost_from=None, seed=1, events=()
):
    """Generate the samples of a run.

    Args:
        count: of the samples.
        followers: of the leader.
        noisy_from: the first sample in which estimates differ from the truth; None: none.
        lossy_from: the first sample in which messages are lost; None: none.
        lost_from: the first sample in which the last aircraft is lost; None: none.
        seed: of the numbers.
        events: pairs of a sample's number and an event.
    """
    rng = np.random.default_rng(seed)
    n, aircraft = followers, followers + 1
    sent, lost = np.zeros((2, n, aircraft), dtype=np.uint32)

    def motion():
        vectors = (rng.standard_normal((aircraft, 3)) * 100.0 for _ in range(5))
        return VehicleState(*vectors, rng.standard_normal(aircraft), rng.standard_normal(aircraft))

    def scalars(number, size):
        return [rng.standard_normal(size) for _ in range(number)]

    for k in range(count):
        truth = motion()
        ages = np.where(rng.random((n, aircraft)) < 0.5, np.nan, rng.random((n, aircraft)))
        tick = k * BASE_RATE_HZ // SAMPLE_RATE_HZ
        sent = sent + rng.integers(1, 3, (n, aircraft)).astype(np.uint32)
        if lossy_from is not None and k >= lossy_from:
            lost = lost + rng.integers(0, 2, (n, aircraft)).astype(np.uint32)
        exact = noisy_from is None or k < noisy_from
        error = rng.standard_normal((n, 3))
        lost_aircraft = np.zeros(aircraft, dtype=bool)
        lost_aircraft[-1] = lost_from is not None and k >= lost_from
        yield Sample(
            tick=tick,
            time_s=tick / BASE_RATE_HZ,
            truth=truth,
            estimate=truth if exact else motion(),
            air=AirData(
                *scalars(3, aircraft), *rng.standard_normal((2, aircraft, 3)), *scalars(3, aircraft)
            ),
            command=FbwaCommand(*scalars(3, aircraft)),
            surfaces=ActuatorCommand(*scalars(4, aircraft)),
            formation=FormationState(
                rng.standard_normal((n, 3)),
                error,
                *scalars(7, n),
                limiter_flags=rng.integers(0, 8, n).astype(np.uint8),
                saturations=rng.integers(0, 8, n).astype(np.uint8),
                age_s=ages,
                slot_index=rng.integers(1, 300, n).astype(np.uint32),
                estimated_error_ned=error if exact else rng.standard_normal((n, 3)),
            ),
            links=LinkCounters(sent, sent - lost),
            lost=lost_aircraft,
            events=tuple(event for at, event in events if at == k),
        )


def event(k, text="something", level="warning"):
    return k, Event(k / SAMPLE_RATE_HZ, level, "uav1", text)


def assert_same_sample(one, other):
    assert (one.tick, one.time_s, one.events) == (other.tick, other.time_s, other.events)
    np.testing.assert_array_equal(one.lost, other.lost)
    assert other.lost.dtype == bool
    for name in RECORDS:
        ours, theirs = getattr(one, name), getattr(other, name)
        for field in type(ours).__annotations__:
            own, read = getattr(ours, field), getattr(theirs, field)
            if own.dtype != read.dtype or own.tobytes() != read.tobytes():  # numpy's takes longer
                np.testing.assert_array_equal(own, read, field)


def record(path, seen, info=None, *, summary=None, events=()):
    log = McapRecorder(path)
    log.begin(info or run_info())
    for sample in seen:
        log.observe(sample)
    log.end({"outcome": "completed", "wall_s": 1.5} if summary is None else summary, events)
    return path


def decoded(path):
    """Decode a log with its own schemas: topic, time in ns and protobuf message of each."""
    classes = {}
    with open(path, "rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if schema.id not in classes:
                pool = descriptor_pool.DescriptorPool()
                for proto in FileDescriptorSet.FromString(schema.data).file:
                    pool.AddSerializedFile(proto.SerializeToString())
                kind = pool.FindMessageTypeByName(schema.name)
                classes[schema.id] = message_factory.GetMessageClass(kind)
            yield channel.topic, message.log_time, classes[schema.id].FromString(message.data)
