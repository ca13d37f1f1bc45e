"""What a view shows, as numbers: columns, links and their losses, plots, cameras, surfaces."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import views_flight

from testbed.errors import InputError
from testbed.formation.barrier import Barrier, h
from testbed.state import Event
from testbed.views import layout, plots, signs
from testbed.views.airframes import airframe
from testbed.views.batch import COLUMNS, Collector, beside, parts, whole
from testbed.views.meshes import cut
from testbed.views.panels import break_turns
from testbed.views.replay import shown
from testbed.views.rerun_door import Recording
from testbed.views.rerun_door.blueprint import axes
from testbed.views.scene import scene_of, together


def scene(aircraft, **changes):
    info = dataclasses.replace(views_flight.info(aircraft, 10.0), **changes)
    return scene_of(info)


def flight(aircraft, duration_s=10.0):
    run = views_flight.log(aircraft, duration_s)
    return whole(run, run.events)


def plot(still, name):
    return next(p for row in plots.tabs(still) for p in row if p.name == name)


def test_a_log_gives_the_columns_that_its_frames_gave_live():
    collector = Collector(1000)
    for frame in views_flight.frames(3, 10.0):
        collector.add(frame)
    live, replayed = collector.take(), flight(3)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(live, name), getattr(replayed, name))
    assert live.events == replayed.events


def test_parts_are_the_whole_and_the_events_come_last():
    batch = dataclasses.replace(flight(3), events=(Event(3.0, "info", "uav1", "engaged"),))
    cut = list(parts(batch, 60))
    assert [len(each) for each in cut] == [60, 60, 60, 60, 10]
    assert [len(each.events) for each in cut] == [0, 0, 0, 0, 1]
    np.testing.assert_array_equal(np.concatenate([p.position for p in cut]), batch.position)


def test_two_runs_beside_each_other_share_their_times_and_no_link():
    one, two = flight(2, 10.0), flight(4, 6.0)
    both = beside(one, two, ("A", "B"))
    assert both.time[-1] == two.time[-1] and len(both) == len(two)
    np.testing.assert_array_equal(both.position[:, 2:], two.position)
    np.testing.assert_array_equal(both.error[:, 0], one.error[: len(two), 0])
    assert np.isnan(both.age[:, 0, 2:]).all() and np.isnan(both.age[:, 1:, :2]).all()
    still = together(scene(2), scene(4), ("A", "B"))
    assert still.names == ("A.leader", "A.uav1", "B.leader", "B.uav1", "B.uav2", "B.uav3")
    assert still.followers == (1, 3, 4, 5) and len(still.speed_bounds) == 4
    assert len(still.paths) == 1  # both have the same
    assert len(set(still.colours)) == 6


def test_the_picture_of_two_runs_says_which_is_which():
    one, two = scene(2), scene(4)
    other = dataclasses.replace(two, scenario="other", title="other then")
    again = dataclasses.replace(one, title="made-up then")
    for second, said in (
        (other, ("A, blue: made-up", "B, orange: other")),
        (again, ("A, blue: made-up", "B, orange: made-up then")),
    ):
        still = together(one, second, ("A", "B"))
        assert still.runs == said
        behind = layout.pictures(still, layout.framing(still, flight(2)))[0]
        assert all(each in behind.name for each in said)
    assert scene(2).runs == ()


@pytest.mark.parametrize("barriers", [(), ((5, 0.05), (6, 2.0))], ids=["own law", "paper"])
def test_runs_of_different_laws_and_rates_are_laid_over_one_another(barriers):
    one, two = views_flight.log(2, 10.0), views_flight.log(3, 10.0)
    one.info = dataclasses.replace(one.info, barriers=((5, 0.05),), bounded_in_ned=(3.0, 0.0, 0.0))
    two.info = dataclasses.replace(two.info, barriers=barriers)
    slow = {  # every fifth frame: 5 Hz
        name: type(value)(*(each[::5] for each in value))
        if isinstance(value, tuple)
        else value[::5]
        for name, value in vars(two).items()
        if name not in ("info", "events")
    }
    still, batch = shown(one, SimpleNamespace(info=two.info, events=(), **slow))
    assert still.frame_rate_hz == pytest.approx(5.0) and len(batch) == 50
    assert [event.source for event in batch.events] == ["A", "B"]
    barrier, speed = plot(still, "barrier"), plot(still, "speed")
    assert barrier.series[0].labels == ("A.uav1", *(["B.uav1", "B.uav2"] if barriers else []))
    for series in (*barrier.series, *speed.series):
        assert series.values(batch).shape == (50, len(series.labels))
    assert "as its bounds are measured" in speed.title


def test_runs_without_a_common_time_are_refused():
    one, two = views_flight.log(2, 1.0), views_flight.log(2, 1.0)
    two.time_s = two.time_s + 100.0
    with pytest.raises(InputError, match="nothing to lay over"):
        shown(one, two)


def test_links_drawn_do_not_depend_on_the_size_of_batches():
    batch = radio(3, 60)
    batch.age[:30, 1, 2] = np.nan  # heeded from here on
    batch.sent[5:, 1, 2] = 1.0  # lost before anybody heeded it
    whole_lines = signs.Links(scene(3)).lines(batch)
    links = signs.Links(scene(3))
    cut = [links.lines(each) for each in parts(batch, 7)]
    np.testing.assert_array_equal(np.concatenate([c.counts for c in cut]), whole_lines.counts)
    np.testing.assert_array_equal(np.concatenate([c.colours for c in cut]), whole_lines.colours)


def radio(aircraft, frames):
    """A flight in which everyone hears everyone, and nothing is lost or old."""
    batch = flight(aircraft, frames / 25.0)
    age = np.full((frames, aircraft - 1, aircraft), 0.1)
    age[:, np.arange(aircraft - 1), np.arange(1, aircraft)] = np.nan  # nobody hears itself
    return dataclasses.replace(batch, age=age, sent=np.zeros_like(age))


def colours_of(lines, frame):
    start = int(lines.counts[:frame].sum())
    return lines.colours[start : start + int(lines.counts[frame])]


def test_a_lost_message_flashes_on_its_link_and_then_not():
    batch = radio(3, 50)
    batch.sent[20:, 1, 0] = 1.0  # one message from the leader to the second follower
    links = signs.Links(scene(3))
    cut = list(parts(batch, 25))  # the flash goes on in the next batch
    lines = [links.lines(each) for each in cut]
    assert all((each.counts == 4).all() for each in lines)
    flashes = [
        (colours_of(each, k) == signs.LOST).all(axis=1).sum() for each in lines for k in range(25)
    ]
    first, last = 20, 20 + int(signs.FLASH_S * 25)
    assert flashes == [int(first <= k <= last) for k in range(50)]
    red = (lines[0].colours == signs.LOST).all(axis=1)
    sender, receiver = lines[0].strips[red][0]
    place = signs.to_chase(scene(3), cut[0], cut[0].position)[20]
    np.testing.assert_allclose(sender, place[0])
    np.testing.assert_allclose(receiver, place[2])


def test_a_link_that_nobody_uses_is_drawn_only_while_a_used_one_fails():
    batch = radio(3, 50)
    batch.age[:] = np.nan
    batch.age[:25, 0, 0] = 0.1  # heard, and then no more
    batch.sent[25:, 0, 0] = np.arange(1, 26)
    batch.sent[25:, 0, 2] = np.arange(1, 26)  # never used: nobody's loss
    lines = signs.Links(scene(3)).lines(batch)
    np.testing.assert_array_equal(lines.counts, 1)
    assert (colours_of(lines, 10) == signs.FRESH).all()
    assert (colours_of(lines, 40) == signs.LOST).all()


def test_old_news_is_drawn_as_such():
    batch = radio(2, 25)
    batch.age[12:] = signs.STALE_S + 0.01
    lines = signs.Links(scene(2)).lines(batch)
    assert (colours_of(lines, 11) == signs.FRESH).all()
    assert (colours_of(lines, 12) == signs.STALE).all()


def test_of_too_many_links_only_those_that_fail_are_drawn():
    batch = radio(20, 25)
    batch.sent[10:, 4, 7] = 1.0
    lines = signs.Links(scene(20)).lines(batch)
    assert 19 * 19 > signs.MOST_LINKS
    assert lines.counts[9] == 0 and lines.counts[10] == 1


def test_the_chase_camera_s_frame_keeps_distances_and_sees_the_leader_ahead():
    batch = flight(4, 60.0)
    place = signs.to_chase(scene(4), batch, batch.position)
    np.testing.assert_allclose(
        np.linalg.norm(place[:, 1] - place[:, 3], axis=-1),
        np.linalg.norm(batch.position[:, 1] - batch.position[:, 3], axis=-1),
    )
    assert (place[400:, 0, 0] > place[400:, 1:, 0].max(axis=-1)).all()


def test_the_barrier_plotted_is_the_law_s():
    barriers = ((5, 0.05), (6, 2.0), (7, 0.0))
    still = scene(4, barriers=barriers)
    batch = flight(4)
    series = plot(still, "barrier").series[0]
    assert series.labels == ("uav1", "uav2"), "7 is no barrier"
    values = series.values(batch)
    speed = np.linalg.norm(batch.velocity[:, 1:], axis=-1)
    for i, (example, nu) in enumerate(barriers[:2]):
        expected, _ = h(Barrier(example, nu), speed[:, i], np.array(16.0), np.array(30.0))
        np.testing.assert_allclose(values[:, i], expected)
    assert values.std(axis=0)[0] > 0.0
    assert "barrier" not in [p.name for row in plots.tabs(scene(4)) for p in row]


def test_speeds_are_plotted_in_what_their_bounds_are_measured_in():
    batch, wind = flight(3), (3.0, -4.0, 0.0)
    ground = plot(scene(3), "speed")
    np.testing.assert_allclose(
        ground.series[0].values(batch), np.linalg.norm(batch.velocity, axis=-1)
    )
    assert [value for _, value in ground.limits] == [16.0, 30.0]
    through_air = plot(scene(3, bounded_in_ned=wind), "speed")
    assert "Airspeed" in through_air.title
    np.testing.assert_allclose(
        through_air.series[0].values(batch), np.linalg.norm(batch.velocity - wind, axis=-1)
    )


def test_the_oldest_news_is_of_another_and_of_those_used():
    batch = radio(3, 25)
    batch.age[:, 0] = [0.2, np.nan, 0.1]  # uav1: of the leader, of itself, of uav2
    batch.age[:, 1] = np.nan
    values = plot(scene(3), "age").series[0].values(batch)
    np.testing.assert_array_equal(values[0], [0.2, np.nan])


def test_angles_are_not_drawn_across_half_a_turn():
    angle = np.array([[170.0], [179.0], [-179.0], [-170.0]])
    np.testing.assert_allclose(break_turns(angle)[:, 0], [170.0, 179.0, np.nan, -170.0])


def lost_from(batch, aircraft, frame):
    lost = batch.lost.copy()
    lost[frame:, aircraft] = 1.0
    return dataclasses.replace(batch, lost=lost)


def test_plots_of_an_aircraft_end_where_it_is_lost():
    still, batch = scene(3, barriers=((5, 0.05),) * 2), lost_from(flight(3), 2, 100)
    for drawn in (p for row in plots.tabs(still) for p in row):
        for series in drawn.series:
            values = series.values(batch)
            mine = [label.startswith("uav2") for label in series.labels].index(True)
            assert np.isnan(values[100:, mine]).all(), drawn.name
            assert np.isfinite(values[1:100, mine]).any() or drawn.name == "age"
            assert not np.isnan(values[100:, 0]).all(), "the others go on"


def sent(still, batch):
    """What a recording sends, by entity: times and columns."""
    recording, columns = Recording(still, live=False), {}
    recording.open(None)
    recording._columns = lambda entity, *what: columns.setdefault(entity, []).append(what)
    for part in parts(batch, 60):
        recording.send(part)
    return columns


def test_the_slot_and_the_arrow_of_an_aircraft_end_where_it_is_lost():
    batch = lost_from(flight(3), 2, 100)
    columns = sent(scene(3), batch)
    slot = columns["world/slots/uav2"]
    times = np.concatenate([time for time, _ in slot])
    assert times.max() == batch.time[100] and len(times) == 101
    assert "Transform3D:scale" in " ".join(str(e.component_descriptor()) for e in slot[-1][1])
    assert sum(len(time) for time, _ in columns["world/slots/uav1"]) == len(batch)
    arrows = [next(iter(said)).as_arrow_array() for _, said in columns["world/chase/wind"]]
    assert [len(row) for each in arrows for row in each] == [3] * 100 + [2] * (len(batch) - 100)
    assert [len(time) for time, _ in columns["world/losses/uav2"]] == [1]


def test_an_axis_shows_its_least_its_bounds_and_whatever_is_beyond():
    still = scene(4)
    for drawn in (p for row in plots.tabs(still) for p in row):
        axis = axes(drawn, named=True, live=True, span=None).properties.get("ScalarAxis")
        assert (axis is not None) == (drawn.name == "course"), "others go with what is seen"
        assert set(drawn.still) >= {value for _, value in drawn.limits}
        assert drawn.whole or set(drawn.still) >= set(drawn.least)
    assert plot(still, "error").least == (0.0, 1.0)


def test_plots_of_a_picture_show_the_last_minute_before_it():
    assert layout.span_of(300.0, 0.0) == (240.0, 302.0)
    assert layout.span_of(20.0, 0.0) == (0.0, pytest.approx(20.0 * 31 / 30))
    assert layout.span_of(0.0, 0.0) == (0.0, pytest.approx(10.0 * 31 / 30))
    still = scene(2)
    shown = axes(plot(still, "error"), named=True, live=False, span=(240.0, 302.0))
    seen = shown.properties["TimeAxis"].view_range.as_arrow_array().to_pylist()
    assert "240000000000" in str(seen) and "302000000000" in str(seen)


def test_of_many_the_furthest_from_their_slots_are_named():
    still, batch = scene(20), lost_from(flight(20, 1.0), 5, 10)
    error = np.full_like(batch.error, 0.1)
    error[:, [4, 7, 9], 0] = [30.0, 2.0, 8.0]  # uav5, uav8 and uav10
    told = signs.worst(still, dataclasses.replace(batch, error=error))
    np.testing.assert_array_equal(told.counts, 3)
    assert told.texts[:3] == ["uav5 30.0 m", "uav10 8.0 m", "uav8 2.0 m"]
    assert told.texts[-3:-1] == ["uav10 8.0 m", "uav8 2.0 m"], "uav5 is lost"
    place = signs.to_chase(still, batch, batch.position)
    np.testing.assert_array_equal(told.places[:3], place[0, [5, 10, 8]])
    assert "world/chase/worst" in sent(still, batch)
    assert "world/chase/worst" not in sent(scene(4), flight(4, 1.0))


@pytest.mark.parametrize("aircraft", [1, 2, 4, 8, 9, 20, 50])
def test_every_plot_has_a_label_and_a_colour_for_each_of_its_lines(aircraft):
    still, batch = scene(aircraft, estimated=True), flight(aircraft, 2.0)
    names = set()
    for drawn in (p for row in plots.tabs(still) for p in row):
        names.add(drawn.name)
        for series in drawn.series:
            values = series.values(batch)
            assert values.shape == (len(batch), len(series.labels)) == (50, len(series.colours))
    wanted = {"speed", "course", "climb", "bank", "throttle", "wind", "updraught", "altitude"}
    assert names == wanted | ({"error", "estimate", "age"} if aircraft > 1 else set())


def seen_from(eye, places):
    """Angles off the camera's axis (k,), rad."""
    axis = np.subtract(eye.target, eye.position)
    toward = places - np.array(eye.position)
    cosine = toward @ axis / (np.linalg.norm(toward, axis=-1) * np.linalg.norm(axis))
    return np.arccos(np.clip(cosine, -1.0, 1.0))


@pytest.mark.parametrize("aircraft", [1, 2, 4, 20, 50])
def test_the_cameras_see_the_whole_formation_and_the_whole_path(aircraft):
    still, batch = scene(aircraft), flight(aircraft, 1.0)
    frame = layout.framing(still, batch)
    slots = np.concatenate([batch.position[:1, 0], batch.slot[0]])
    placed = slots - slots.mean(axis=0)  # it flies north: the frame of the camera
    for eye in (frame.chase, frame.above):
        assert seen_from(eye, placed).max() < np.radians(45.0)
    assert seen_from(frame.overview, still.paths[0]).max() < np.radians(30.0)
    drawn = frame.size * max(still.wingspan)
    assert drawn >= 0.1 * np.linalg.norm(frame.chase.position)


@pytest.mark.parametrize("known", [0, 2, 4])
def test_cameras_stand_somewhere_whatever_of_the_first_frame_is_a_number(known):
    still, batch = scene(4), flight(4, 1.0)
    batch.position[:, known:] = np.nan
    batch.slot[:, max(known - 1, 0) :] = np.nan
    frame = layout.framing(still, batch)
    told = [frame.size, frame.grid, frame.wind]
    for eye in (frame.chase, frame.above, frame.overview):
        told += [*eye.position, *eye.target]
    assert np.isfinite(told).all()
    assert np.isfinite(signs.centre(still, batch)).all()


@pytest.mark.parametrize(("aircraft", "rows"), [(1, 25), (4, 100), (20, 500), (50, 625)])
def test_larger_formations_are_drawn_less_often(aircraft, rows):
    step = layout.stride(scene(aircraft), layout.POSE_ROWS_PER_S)
    assert aircraft * 25 / step == rows


def moved(flap, deflection):
    """How far down and right the trailing edge goes at a deflection (3,), m."""
    x, y, z, w = flap.turn(np.array([deflection], dtype=float))[0]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    edge = flap.mesh.vertices[flap.mesh.vertices[:, 0].argmin()]
    return (turn @ edge - edge)[2], (turn @ edge - edge)[1]


def test_control_surfaces_move_the_way_that_the_commands_say():
    rascal = {flap.name: flap for flap in airframe("rascal110", 2.794).flaps}
    roll, pitch, yaw = np.eye(3)
    assert (
        moved(rascal["right_aileron"], roll)[0]
        < -0.01
        < 0.01
        < moved(rascal["left_aileron"], roll)[0]
    )
    for side in ("right", "left"):
        assert moved(rascal[f"{side}_elevator"], pitch)[0] < -0.01  # up: the nose comes up
        assert moved(rascal[f"{side}_aileron"], yaw) == (0.0, 0.0)
    assert moved(rascal["rudder"], yaw)[1] > 0.01  # to the right: so does the nose
    x8 = {flap.name: flap for flap in airframe("skywalker_x8", 2.1).flaps}
    assert moved(x8["right_elevon"], roll)[0] < -0.01 < 0.01 < moved(x8["left_elevon"], roll)[0]
    assert moved(x8["right_elevon"], pitch)[0] < -0.01 > moved(x8["left_elevon"], pitch)[0]
    assert moved(x8["right_elevon"], pitch + roll) == moved(x8["right_elevon"], roll)  # saturates


def test_a_control_surface_is_the_rear_of_what_it_is_cut_from():
    sections = np.array([[0.1, 0.0, -0.1, 0.4], [0.0, 1.0, -0.2, 0.2]])
    fixed, moving = cut(sections, 0.5, 0.9, 0.25)
    for y in (0.5, 0.7, 0.9):
        edge, chord = 0.1 - 0.1 * y, 0.4 - 0.2 * y
        own = [np.interp(y, moving[:, 1], moving[:, k]) for k in range(4)]
        np.testing.assert_allclose(own, [edge - 0.75 * chord, y, -0.1 - 0.1 * y, 0.25 * chord])
    inside = fixed[(fixed[:, 1] > 0.499) & (fixed[:, 1] < 0.901)]
    np.testing.assert_allclose(inside[1:-1, 3], 0.75 * (0.4 - 0.2 * inside[1:-1, 1]))
    np.testing.assert_allclose(fixed[[0, -1]], sections)


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8"])
def test_hinges_are_the_rear_edge_of_what_stays(name):
    drawing = airframe(name, 2.1)
    for flap in drawing.flaps:
        gaps = np.linalg.norm(drawing.body.vertices - flap.hinge, axis=-1)
        assert gaps.min() < 1e-6  # the hinge's inner end is a corner of the hole
        np.testing.assert_allclose(flap.turn(np.zeros((1, 3)))[0], [0.0, 0.0, 0.0, 1.0])
