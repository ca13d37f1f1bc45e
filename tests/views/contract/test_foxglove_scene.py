"""The scene for Foxglove: its messages obey Foxglove's schemas and draw the flight as it was."""

import mcap.reader
import numpy as np
import pytest
import views_flight
from commands import call_command
from foxglove import messages as sdk
from google.protobuf.unknown_fields import UnknownFieldSet
from record_flight import assert_same_sample, decoded, record

import testbed
from testbed.core.records import Event, LinkCounters
from testbed.core.start_time import start_unix_ns
from testbed.logs.read import samples
from testbed.views.annotations import LOST, NORMAL, STALE

AIRCRAFT, SECONDS, HZ = 4, 8, 25
OLD_FROM, DROPPED_AT, LOST_AT = 100, 125, 150  # samples: old data of uav1, a message to uav2, uav3
START_NS = start_unix_ns("2026-05-01T09:30:00Z")


def flight():
    """An artificial flight with old data, a lost message, wind, errors and the loss of uav3."""
    for k, sample in enumerate(views_flight.samples(AIRCRAFT, SECONDS)):
        age, delivered = np.zeros((AIRCRAFT - 1, AIRCRAFT)), np.full((3, 4), k, np.uint32)
        age[0, 0] = 0.6 if k >= OLD_FROM else 0.0
        delivered[1, 0] -= k >= DROPPED_AT
        wind = np.tile([3.0, 4.0, 0.0], (AIRCRAFT, 1))
        lost = np.arange(AIRCRAFT) == (3 if k >= LOST_AT else -1)
        estimate = sample.truth._replace(position_ned=sample.truth.position_ned + 0.5)
        yield sample._replace(
            estimate=estimate,
            air=sample.air._replace(wind_ned=wind),
            formation=sample.formation._replace(age_s=age),
            links=LinkCounters(np.full((3, 4), k, np.uint32), delivered),
            lost=lost,
            events=(Event(sample.time_s, "error", "uav3", "lost"),) if k == LOST_AT else (),
        )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    path = record(folder / "run.mcap", flight(), views_flight.info(AIRCRAFT, SECONDS))
    call_command(
        *("export", path, "--format", "foxglove", "--start-time", "2026-05-01T09:30:00Z"),
        cwd=folder,
        code=0,
        columns=120,
    )
    return folder / "run.foxglove.mcap"


@pytest.fixture(scope="module")
def found(exported):
    """Messages with their samples, by topic."""
    topics = {}
    for topic, stamp, message in decoded(exported):
        sample = round((stamp - START_NS) * HZ / 1e9)
        topics.setdefault(topic, []).append((sample, message))
    return topics


def vector(value):
    return np.array([value.x, value.y, value.z])


def rotation(q):
    x, y, z, w = q.x, q.y, q.z, q.w
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def in_world(found, sample, frame, points):
    """Transform points (k, 3) of a frame to east, north, up, as a viewer does."""
    moving = [dict(found[topic])[sample] for topic in ("/tf", "/scene/frames")]
    moving.append(found["/tf_static"][0][1])
    frames = {each.child_frame_id: each for message in moving for each in message.transforms}
    while frame != "enu":
        step = frames[frame]
        points = points @ rotation(step.rotation).T + vector(step.translation)
        frame = step.parent_frame_id
    return points


def enu(ned):
    return np.asarray(ned)[..., [1, 0, 2]] * [1.0, 1.0, -1.0]


def test_messages_obey_schemas_of_foxglove_sdk(exported, found):
    with exported.open("rb") as file:
        summary = mcap.reader.make_reader(file).get_summary()
    schemas = {each.name: each.data for each in summary.schemas.values()}
    for name in ("FrameTransforms", "LocationFix", "Log", "SceneUpdate"):
        assert schemas[f"foxglove.{name}"] == getattr(sdk, name).get_schema().data
    scene = {topic for topic in found if topic.startswith("/scene/")}
    parts = "frames aircraft slots path trails links wind estimates losses"
    assert scene == {f"/scene/{part}" for part in parts.split()}
    for topic in scene:
        for sample, message in found[topic]:
            assert not len(UnknownFieldSet(message))
            for entity in getattr(message, "entities", ()):
                stamp = entity.timestamp.seconds * 10**9 + entity.timestamp.nanos
                assert stamp == START_NS + sample * 40_000_000
                for surface in entity.triangles:
                    assert max(surface.indices) == len(surface.points) - 1
                    assert len(surface.indices) % 3 == 0
                for line in entity.lines:
                    assert len(line.colors) in (0, len(line.points))


def test_models_have_nose_forward_and_true_size(found):
    log_state = {sample: message for sample, message in found["/leader/state"]}
    [(_, message)] = found["/scene/aircraft"]
    assert [each.id for each in message.entities] == ["leader", "uav1", "uav2", "uav3"]
    model = message.entities[0]
    assert model.frame_locked
    points = np.array([vector(p) for surface in model.triangles for p in surface.points])
    assert np.ptp(points[:, 1]) == pytest.approx(views_flight.info(4, 1).wingspan_m[0], rel=0.01)
    for sample in (0, 100):
        state = log_state[sample]
        axes = in_world(found, sample, model.frame_id, np.vstack([np.zeros(3), np.eye(3)]))
        origin, (nose, right, belly) = axes[0], axes[1:] - axes[0]
        position = [getattr(state, f"position_{axis}_m") for axis in ("north", "east", "down")]
        np.testing.assert_allclose(origin, enu(position), atol=1e-9)
        velocity = enu([getattr(state, f"velocity_{a}_mps") for a in ("north", "east", "down")])
        assert nose @ velocity > 0.98 * np.linalg.norm(velocity)
        assert belly[2] < -0.7
        np.testing.assert_allclose(np.cross(nose, right), belly, atol=1e-9)
    tail, nose = points[:, 0].min(), points[:, 0].max()
    fin = points[points[:, 0] < tail + 0.3 * (nose - tail)]
    assert fin[:, 2].min() < -0.3  # the fin is behind, and points up


def test_slots_are_drawn_where_they_are_until_loss(found):
    first, after = found["/scene/slots"]
    assert [each.id for each in first[1].entities] == ["uav1/slot", "uav2/slot", "uav3/slot"]
    assert after[0] == LOST_AT
    assert [each.type for each in after[1].deletions] == [1]  # all
    assert [each.id for each in after[1].entities] == ["uav1/slot", "uav2/slot"]
    formation = dict(found["/uav2/formation"])[60]
    slot = [getattr(formation, f"slot_{axis}_m") for axis in ("north", "east", "down")]
    drawn = in_world(found, 60, "uav2/slot", np.zeros((1, 3)))[0]
    np.testing.assert_allclose(drawn, enu(slot), atol=1e-9)
    [(sample, marks)] = found["/scene/losses"]
    assert (sample, marks.entities[0].texts[0].text) == (LOST_AT, "uav3 lost")


def link_colours(found, sample):
    """Colours of the links by their ends' nearest aircraft, rounded to whole numbers."""
    [entity] = dict(found["/scene/links"])[sample].entities
    frames = ("leader", "uav1", "uav2", "uav3")
    aircraft = [in_world(found, sample, each, np.zeros((1, 3)))[0] for each in frames]
    colours = {}
    for line in entity.lines:
        ends = in_world(found, sample, entity.frame_id, np.array([vector(p) for p in line.points]))
        distance = np.linalg.norm(ends[:, None] - np.array(aircraft), axis=-1)
        assert distance.min(axis=1).max() < 1e-6
        nearest = distance.argmin(axis=1).reshape(-1, 2).tolist()
        for pair, colour in zip(nearest, line.colors[::2], strict=True):
            shade = tuple(round(255 * c) for c in (colour.r, colour.g, colour.b))
            colours[frames[pair[0]], frames[pair[1]]] = shade
    return colours


def test_links_join_aircraft_coloured_by_age_and_loss(found):
    assert set(link_colours(found, OLD_FROM - 5).values()) == {NORMAL}
    after = link_colours(found, OLD_FROM + 5)
    assert after["leader", "uav1"] == STALE
    assert after["leader", "uav2"] == NORMAL
    assert link_colours(found, DROPPED_AT + 5)["leader", "uav2"] == LOST
    assert link_colours(found, DROPPED_AT + 10)["leader", "uav2"] == NORMAL


def test_trails_follow_the_aircraft(found):
    log = {sample: message for sample, message in found["/uav1/state"]}
    sample, message = found["/scene/trails"][-1]
    [entity] = message.entities
    assert len(entity.lines) == AIRCRAFT
    along = np.array([vector(point) for point in entity.lines[1].points])
    for point, at in zip(along, [*range(0, sample, HZ), sample], strict=True):
        state = log[at]
        position = [getattr(state, f"position_{axis}_m") for axis in ("north", "east", "down")]
        np.testing.assert_array_equal(point, position)
    assert len(found["/scene/trails"]) == 5 * SECONDS


def test_wind_and_estimates_are_drawn_at_aircraft(found):
    [entity] = dict(found["/scene/wind"])[50].entities
    arrow = entity.arrows[1]
    tail = vector(arrow.pose.position)[None]
    tip = tail + rotation(arrow.pose.orientation)[:, 0]
    tail, tip = in_world(found, 50, entity.frame_id, np.vstack([tail, tip]))
    np.testing.assert_allclose(tail, in_world(found, 50, "uav1", np.zeros((1, 3)))[0], atol=1e-6)
    np.testing.assert_allclose(tip - tail, enu([0.6, 0.8, 0.0]), atol=1e-9)
    [entity] = dict(found["/scene/estimates"])[50].entities
    dot = in_world(found, 50, entity.frame_id, vector(entity.spheres[0].pose.position)[None])[0]
    leader = in_world(found, 50, "leader", np.zeros((1, 3)))[0]
    np.testing.assert_allclose(dot - leader, [0.5, 0.5, -0.5], atol=1e-6)


def test_export_has_the_samples_of_the_log(exported):
    log = testbed.load_run(exported).log
    assert log.info.start_unix_ns == START_NS
    assert log.metrics == {"outcome": "completed", "wall_s": None}
    seen = list(samples(log))
    assert len(seen) == SECONDS * HZ
    for one, other in zip(flight(), seen, strict=True):
        assert_same_sample(one, other)


def test_start_time_of_a_table_is_refused(exported):
    done = call_command(
        *("export", exported, "--format", "csv", "--start-time", "now"),
        cwd=exported.parent,
        code=2,
        columns=120,
    )
    assert "no times of day" in done.stderr
