"""The content of a view as numbers: columns, links, plots, cameras, control surfaces."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import views_flight
from cases import in_full
from reference.formation_barrier import h

from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.formation.barrier import SpeedBarrier
from testbed.views import annotations, layout, plots
from testbed.views.airframes import draw_airframe
from testbed.views.cameras import ABOVE, BEHIND, FormationCameras, flying_aircraft
from testbed.views.meshes import cut_control_surface
from testbed.views.panels import break_at_wrap
from testbed.views.quantities import PLOTTED
from testbed.views.recorded_runs import scene_and_batch
from testbed.views.rerun_backend import RerunRecording
from testbed.views.rerun_backend.blueprint import plot_view
from testbed.views.sample_columns import COLUMNS, Collector, batch_of, overlay, split
from testbed.views.scene import overlay_scenes, scene_of


def scene(aircraft, **changes):
    info = dataclasses.replace(views_flight.info(aircraft, 10.0), **changes)
    return scene_of(info)


def flight(aircraft, duration_s=10.0):
    run = views_flight.log(aircraft, duration_s)
    return batch_of(run, run.events)


def plot(scene, name):
    return next(p for row in plots.tabs(scene) for p in row if p.name == name)


def test_batch_of_log_equals_collected_samples():
    collector = Collector(1000)
    for sample in views_flight.samples(3, 10.0):
        collector.add(sample)
    live, replayed = collector.take(), flight(3)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(live, name), getattr(replayed, name))
    assert live.events == replayed.events


def test_split_keeps_samples_and_puts_events_last():
    batch = dataclasses.replace(flight(3), events=(Event(3.0, "info", "uav1", "joined"),))
    pieces = list(split(batch, 60))
    assert [len(each) for each in pieces] == [60, 60, 60, 60, 10]
    assert [len(each.events) for each in pieces] == [0, 0, 0, 0, 1]
    np.testing.assert_array_equal(np.concatenate([p.position for p in pieces]), batch.position)


def test_overlay_has_common_times_and_no_shared_link():
    one, two = flight(2, 10.0), flight(4, 6.0)
    both = overlay(one, two, ("A", "B"))
    assert both.time[-1] == two.time[-1] and len(both) == len(two)
    np.testing.assert_array_equal(both.position[:, 2:], two.position)
    np.testing.assert_array_equal(both.error[:, 0], one.error[: len(two), 0])
    assert np.isnan(both.age[:, 0, 2:]).all() and np.isnan(both.age[:, 1:, :2]).all()
    still = overlay_scenes(scene(2), scene(4), ("A", "B"))
    assert still.names == ("A.leader", "A.uav1", "B.leader", "B.uav1", "B.uav2", "B.uav3")
    assert still.followers == (1, 3, 4, 5) and len(still.speed_bounds) == 4
    assert len(still.paths) == 1  # both have the same
    assert len(set(still.colours)) == 6


def test_overlay_view_names_both_runs():
    one, two = scene(2), scene(4)
    other = dataclasses.replace(two, scenario="other", title="other then")
    again = dataclasses.replace(one, title="made-up then")
    for second, names in (
        (other, ("A, blue: made-up", "B, orange: other")),
        (again, ("A, blue: made-up", "B, orange: made-up then")),
    ):
        still = overlay_scenes(one, second, ("A", "B"))
        assert still.runs == names
        behind = layout.views_3d(still, layout.fit_formation(still, flight(2)))[0]
        assert all(each in behind.name for each in names)
    assert scene(2).runs == ()


@pytest.mark.parametrize("barriers", [(), ((5, 0.05), (6, 2.0))], ids=["own law", "paper"])
def test_overlay_of_different_laws_and_rates(barriers):
    one, two = views_flight.log(2, 10.0), views_flight.log(3, 10.0)
    one.info = dataclasses.replace(one.info, barriers=((5, 0.05),), bounded_in_ned=(3.0, 0.0, 0.0))
    two.info = dataclasses.replace(two.info, barriers=barriers)
    slow = {  # every fifth sample: 5 Hz
        name: type(value)(*(each[::5] for each in value))
        if isinstance(value, tuple)
        else value[::5]
        for name, value in vars(two).items()
        if name not in ("info", "events", "metrics")
    }
    other = SimpleNamespace(info=two.info, events=(), metrics=None, **slow)
    still, batch = scene_and_batch(one, other)
    assert still.sample_rate_hz == pytest.approx(5.0) and len(batch) == 50
    assert [event.source for event in batch.events] == ["A", "B"]
    barrier, speed = plot(still, "barrier"), plot(still, "speed")
    assert barrier.series[0].labels == ("A.uav1", *(["B.uav1", "B.uav2"] if barriers else []))
    for series in (*barrier.series, *speed.series):
        assert series.values(batch).shape == (50, len(series.labels))
    assert "as its bounds are measured" in speed.title


def test_overlay_without_common_times_raises():
    one, two = views_flight.log(2, 1.0), views_flight.log(2, 1.0)
    two.time_s = two.time_s + 100.0
    with pytest.raises(InputError, match="nothing to overlay"):
        scene_and_batch(one, two)


def test_link_lines_independent_of_batch_size():
    batch = connected(3, 60)
    batch.age[:30, 1, 2] = np.nan  # used from here on
    batch.sent[5:, 1, 2] = 1.0  # lost before the link was used
    whole = lines_of(annotations.Links(scene(3)), batch)
    links = annotations.Links(scene(3))
    pieces = [lines_of(links, each) for each in split(batch, 7)]
    np.testing.assert_array_equal(np.concatenate([p.counts for p in pieces]), whole.counts)
    np.testing.assert_array_equal(np.concatenate([p.colours for p in pieces]), whole.colours)


def connected(aircraft, samples):
    """Make a flight in which all links are used, and no message is lost or old."""
    batch = flight(aircraft, samples / 25.0)
    age = np.full((samples, aircraft - 1, aircraft), 0.1)
    age[:, np.arange(aircraft - 1), np.arange(1, aircraft)] = np.nan  # no link to itself
    return dataclasses.replace(batch, age=age, sent=np.zeros_like(age))


def above(still, batch):
    """Compute the track of the camera above."""
    return FormationCameras(still, (BEHIND, ABOVE), 1.0).track(batch)[1]


def lines_of(links, batch):
    track = above(scene(batch.position.shape[1]), batch)
    return links.lines(batch, track.to_frame(batch.position))


def colours_of(lines, sample):
    start = int(lines.counts[:sample].sum())
    return lines.colours[start : start + int(lines.counts[sample])]


def test_lost_message_flashes_on_its_link():
    batch = connected(3, 50)
    batch.sent[20:, 1, 0] = 1.0  # one message from the leader to the second follower
    links = annotations.Links(scene(3))
    pieces = list(split(batch, 25))  # the flash continues in the second batch
    lines = [lines_of(links, each) for each in pieces]
    assert all((each.counts == 4).all() for each in lines)
    flashes = [
        (colours_of(each, k) == annotations.LOST).all(axis=1).sum()
        for each in lines
        for k in range(25)
    ]
    first, last = 20, 20 + int(annotations.FLASH_S * 25)
    assert flashes == [int(first <= k <= last) for k in range(50)]
    red = (lines[0].colours == annotations.LOST).all(axis=1)
    sender, receiver = lines[0].strips[red][0]
    position = above(scene(3), pieces[0]).to_frame(pieces[0].position)[20]
    np.testing.assert_allclose(sender, position[0])
    np.testing.assert_allclose(receiver, position[2])


def test_link_drawn_only_if_ever_used():
    batch = connected(3, 50)
    batch.age[:] = np.nan
    batch.age[:25, 0, 0] = 0.1  # used, and then no more
    batch.sent[25:, 0, 0] = np.arange(1, 26)
    batch.sent[25:, 0, 2] = np.arange(1, 26)  # never used: its losses do not count
    lines = lines_of(annotations.Links(scene(3)), batch)
    np.testing.assert_array_equal(lines.counts, 1)
    assert (colours_of(lines, 10) == annotations.NORMAL).all()
    assert (colours_of(lines, 40) == annotations.LOST).all()


def test_link_with_old_data_is_drawn_stale():
    batch = connected(2, 25)
    batch.age[12:] = annotations.STALE_S + 0.01
    lines = lines_of(annotations.Links(scene(2)), batch)
    assert (colours_of(lines, 11) == annotations.NORMAL).all()
    assert (colours_of(lines, 12) == annotations.STALE).all()


def test_of_many_links_only_failing_ones_drawn():
    batch = connected(20, 25)
    batch.sent[10:, 4, 7] = 1.0
    lines = lines_of(annotations.Links(scene(20)), batch)
    assert 19 * 19 > annotations.MAX_LINKS
    assert lines.counts[9] == 0 and lines.counts[10] == 1


def test_chase_frame_keeps_distances_leader_ahead():
    batch = flight(4, 60.0)
    position = above(scene(4), batch).to_frame(batch.position)
    np.testing.assert_allclose(
        np.linalg.norm(position[:, 1] - position[:, 3], axis=-1),
        np.linalg.norm(batch.position[:, 1] - batch.position[:, 3], axis=-1),
    )
    assert (position[400:, 0, 0] > position[400:, 1:, 0].max(axis=-1)).all()


def test_barrier_plot_equals_law():
    barriers = ((5, 0.05), (6, 2.0), (7, 0.0))
    still = scene(4, barriers=barriers)
    batch = flight(4)
    series = plot(still, "barrier").series[0]
    assert series.labels == ("uav1", "uav2"), "7 is no barrier"
    values = series.values(batch)
    speed = np.linalg.norm(batch.velocity[:, 1:], axis=-1)
    for i, (example, nu) in enumerate(barriers[:2]):
        expected, _ = h(SpeedBarrier(example, nu), speed[:, i], np.array(16.0), np.array(30.0))
        np.testing.assert_allclose(values[:, i], expected)
    assert values.std(axis=0)[0] > 0.0
    assert "barrier" not in [p.name for row in plots.tabs(scene(4)) for p in row]


def test_speed_plot_relative_to_air_of_bounds():
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


def test_quantities_of_batch_equal_those_of_log():
    log = views_flight.log(4, 10.0)
    batch = batch_of(log, ())
    names = [drawn.name for row in plots.tabs(scene(4, estimated=True)) for drawn in row]
    assert len(names) > 8
    for name in names:
        quantity = PLOTTED[name]
        np.testing.assert_array_equal(quantity.values(batch), quantity.values(log), name)


def test_age_plot_is_oldest_data_used():
    batch = connected(3, 25)
    batch.age[:, 0] = [0.2, np.nan, 0.1]  # uav1: of the leader, of itself, of uav2
    batch.age[:, 1] = np.nan
    values = plot(scene(3), "age").series[0].values(batch)
    np.testing.assert_array_equal(values[0], [0.2, np.nan])


def test_break_at_wrap_inserts_nan():
    angle = np.array([[170.0], [179.0], [-179.0], [-170.0]])
    np.testing.assert_allclose(break_at_wrap(angle)[:, 0], [170.0, 179.0, np.nan, -170.0])


def lost_from(batch, aircraft, sample):
    lost = batch.lost.copy()
    lost[sample:, aircraft] = 1.0
    return dataclasses.replace(batch, lost=lost)


def test_plots_end_where_aircraft_is_lost():
    still, batch = scene(3, barriers=((5, 0.05),) * 2), lost_from(flight(3), 2, 100)
    for drawn in (p for row in plots.tabs(still) for p in row):
        for series in drawn.series:
            values = series.values(batch)
            mine = [label.startswith("uav2") for label in series.labels].index(True)
            assert np.isnan(values[100:, mine]).all(), drawn.name
            assert np.isfinite(values[1:100, mine]).any() or drawn.name == "age"
            assert not np.isnan(values[100:, 0]).all(), "the others go on"


def sent(scene, batch):
    """Record what is sent to Rerun: times and columns by entity."""
    recording, columns = RerunRecording(scene, live=False), {}
    recording.open(None)
    recording._columns = lambda entity, *call: columns.setdefault(entity, []).append(call)
    for piece in split(batch, 60):
        recording.send(piece)
    return columns


def test_slot_and_wind_end_where_aircraft_is_lost():
    batch = lost_from(flight(3), 2, 100)
    columns = sent(scene(3), batch)
    slot = columns["world/slots/uav2"]
    times = np.concatenate([time for time, _ in slot])
    assert times.max() == batch.time[100] and len(times) == 101
    assert "Transform3D:scale" in " ".join(str(e.component_descriptor()) for e in slot[-1][1])
    assert sum(len(time) for time, _ in columns["world/slots/uav1"]) == len(batch)
    arrows = [next(iter(column)).as_arrow_array() for _, column in columns["world/chase/wind"]]
    assert [len(row) for each in arrows for row in each] == [3] * 100 + [2] * (len(batch) - 100)
    assert [len(time) for time, _ in columns["world/losses/uav2"]] == [1]


def test_axis_contains_minimum_range_and_limits():
    still = scene(4)
    for drawn in (p for row in plots.tabs(still) for p in row):
        axis = plot_view(drawn, named=True, live=True, span=None).properties.get("ScalarAxis")
        assert (axis is not None) == (drawn.name == "course"), "other ranges fit the data"
        assert set(drawn.constants) >= {value for _, value in drawn.limits}
        assert drawn.fixed_range or set(drawn.constants) >= set(drawn.min_range)
    assert plot(still, "error").min_range == (0.0, 1.0)


def test_plot_span_is_last_minute():
    assert layout.plot_span(300.0, 0.0) == (240.0, 302.0)
    assert layout.plot_span(20.0, 0.0) == (0.0, pytest.approx(20.0 * 31 / 30))
    assert layout.plot_span(0.0, 0.0) == (0.0, pytest.approx(10.0 * 31 / 30))
    still = scene(2)
    shown = plot_view(plot(still, "error"), named=True, live=False, span=(240.0, 302.0))
    seen = shown.properties["TimeAxis"].view_range.as_arrow_array().to_pylist()
    assert "240000000000" in str(seen) and "302000000000" in str(seen)


CANVAS = annotations.Canvas(900.0, 400.0)


def names_of(still, batch, k, camera=0):
    """Place the names of one sample."""
    track = FormationCameras(still, (BEHIND, ABOVE), 1.0).track(batch)[camera]
    one, at = batch.rows(slice(k, k + 1)), track.rows(slice(k, k + 1))
    return annotations.name_aircraft(still, one, at, CANVAS, 1.0)


def test_largest_errors_named_first_in_large_formation():
    still, batch = scene(20), lost_from(flight(20, 1.0), 5, 10)
    error = np.full_like(batch.error, 0.1)
    error[:, [4, 7, 9], 0] = [30.0, 2.0, 8.0]  # uav5, uav8 and uav10
    batch = dataclasses.replace(batch, error=error)
    first, last = (names_of(still, batch, k)[0].texts for k in (0, -1 + len(batch)))
    assert first == ["leader", "uav5 30.0 m", "uav10 8.0 m", "uav8 2.0 m"]
    assert last[:3] == ["leader", "uav10 8.0 m", "uav8 2.0 m"], "uav5 is lost"
    assert not any(text.startswith("uav5") for text in last)


@pytest.mark.parametrize("camera", [0, 1], ids=["behind", "above"])
@pytest.mark.parametrize("aircraft", [4, 20, 100])
def test_names_do_not_cover_each_other(aircraft, camera):
    still, batch = scene(aircraft), flight(aircraft, 1.0)
    names, arrows = names_of(still, batch, 0, camera)
    assert not len(arrows.rows), "everyone is in sight"
    assert len(names.texts) == 4
    size = CANVAS.text_size(names.texts)
    low, high = names.middle - 0.5 * size, names.middle + 0.5 * size
    assert (low >= 0.0).all() and (high <= [CANVAS.width, CANVAS.height]).all()
    apart = (low[:, None] >= high[None]) | (high[:, None] <= low[None])
    covered = ~apart.any(axis=-1)
    assert covered.sum() == len(names.texts), "only with itself"


def test_followed_camera_points_at_the_others():
    still = dataclasses.replace(scene(4), follow=2)
    batch = flight(4, 2.0)
    batch.position[:, 3] += [0.0, 300.0, 0.0]  # uav3 is far to the east; the course is north
    names, arrows = names_of(still, batch, -1 + len(batch))
    assert "uav2" in names.texts and arrows.texts[-1].startswith("uav3 ")
    distance = np.linalg.norm(batch.position[-1, 3] - batch.position[-1, 2])
    assert arrows.texts[-1] == f"uav3 {distance:.0f} m"
    assert arrows.direction[-1, 0] > 0.8, "to the right"
    assert (arrows.tip > 0.0).all() and (arrows.tip < [CANVAS.width, CANVAS.height]).all()


@pytest.mark.parametrize("aircraft", [4, 20, 100])
def test_drawn_size_below_distance_of_slots(aircraft):
    still, batch = scene(aircraft), flight(aircraft, 1.0)
    points = np.concatenate([batch.position[0, :1], batch.slot[0]])
    between = np.linalg.norm(points[:, None] - points, axis=-1) + 1e9 * np.eye(aircraft)
    size = layout.fit_formation(still, batch).size
    assert 1.0 <= size <= max(1.0, 1.2 * between.min() / max(still.wingspan) + 0.25)
    followed = dataclasses.replace(still, follow=1)
    assert layout.fit_formation(followed, batch).size == 1.0


def test_name_is_on_the_outer_side_if_equal():
    anchors = np.array([[300.0, 200.0], [600.0, 200.0]])
    sizes, gaps = np.full((2, 2), 20.0), np.full((2, 2), 5.0)
    left, right = annotations.place(anchors, sizes, gaps, np.empty((0, 4)), anchors, (900.0, 400.0))
    assert left[0] < 300.0 and right[0] > 600.0 and left[1] == right[1] == 200.0


def test_line_joins_far_name_with_aircraft():
    still, batch = scene(12), flight(12, 1.0)
    batch.position[:, 1:] = batch.position[:, :1] + 0.01 * np.arange(1.0, 12.0)[:, None]
    names, _ = names_of(still, batch, 0)
    assert len(names.ties)
    length = np.linalg.norm(names.ties[:, 1] - names.ties[:, 0], axis=-1)
    assert (length > annotations.TIE_PX).all() and set(names.tied) <= set(names.rows)


def test_scale_bar_is_true_at_the_middle():
    track = above(scene(4), flight(4, 1.0)).rows(slice(0, 1))
    bar = annotations.scale_bar(track, CANVAS)
    east = track.centre[:, None] + np.array([[[0.0, 0.0, 0.0], [0.0, bar.length, 0.0]]])
    ends = CANVAS.to_pixels(track.project(east)[0])[0]
    assert ends[1, 0] - ends[0, 0] == pytest.approx(bar.pixels, rel=1e-3)
    assert 0.05 * CANVAS.width < bar.pixels <= annotations.BAR_SHARE * CANVAS.width


def test_colours_differ_up_to_twelve_aircraft():
    palette = np.array(scene(12).colours, float)
    apart = np.linalg.norm(palette[:, None] - palette[None], axis=-1) + 1e9 * np.eye(12)
    assert apart.min() > 40.0


def test_colours_of_many_aircraft_are_one_scale():
    leader, *followers = np.array(scene(30).colours, float)
    steps = np.diff(followers, axis=0)
    assert leader.min() > 200.0 and np.ptp(steps, axis=0).max() <= 2.0, "equal steps"
    assert np.linalg.norm(followers[-1] - followers[0]) > 200.0


def test_plots_of_many_aircraft_have_a_median():
    still, batch = scene(20), lost_from(flight(20, 2.0), 5, 10)
    error = plot(still, "error")
    every, median = error.series
    assert error.title.endswith("white: median") and median.width > every.width
    values = every.values(batch)
    assert np.isnan(values[-1, 4]), "lost"
    np.testing.assert_allclose(median.values(batch)[:, 0], np.nanmedian(values, axis=1))
    assert [len(plot(still, name).series) for name in ("course", "age")] == [1, 2]
    assert [len(plot(scene(12), name).series) for name in ("error", "bank")] == [1, 1]


@pytest.mark.parametrize("aircraft", [1, 2, 4, 8, 9, 20, 50])
def test_plots_have_label_and_colour_for_each_line(aircraft):
    still, batch = scene(aircraft, estimated=True), flight(aircraft, 2.0)
    names = set()
    for drawn in (p for row in plots.tabs(still) for p in row):
        names.add(drawn.name)
        for series in drawn.series:
            values = series.values(batch)
            assert values.shape == (len(batch), len(series.labels)) == (50, len(series.colours))
    wanted = {"speed", "course", "flight_path_angle", "bank", "throttle", "altitude"}
    wanted |= {"wind", "updraught"}
    assert names == wanted | ({"error", "estimate_error", "age"} if aircraft > 1 else set())


def out_of_sight(still, batch, *, pieces=100):
    """Count aircraft in flight that one of the cameras does not show, over all samples."""
    cameras, missing = FormationCameras(still, (BEHIND, ABOVE), 1.0), 0
    for piece in split(batch, pieces):
        for track in cameras.track(piece):
            screen, depth = track.project(piece.position)
            shown = (np.abs(screen) <= [track.lens.aspect, 1.0]).all(axis=-1) & (depth > 0.0)
            missing += int((flying_aircraft(piece) & ~shown).sum())
    return missing


@pytest.mark.parametrize("aircraft", [1, 2, 4, 20, pytest.param(100, marks=in_full)])
def test_cameras_show_every_flying_aircraft(aircraft):
    still, batch = scene(aircraft), flight(aircraft, 20.0)
    assert out_of_sight(still, batch) == 0
    if aircraft > 3:
        batch.position[:, 2, 0] -= 15.0 * batch.time  # falls back by 300 m
        batch.position[:, 2, 2] += 3.0 * batch.time
        batch.position[250:, 3] = batch.position[250, 3]  # is lost, and lies on the ground
        assert out_of_sight(still, lost_from(batch, 3, 250)) == 0
        assert out_of_sight(still, lost_from(batch, 0, 250)) == 0, "the leader is lost"


def test_camera_track_independent_of_batches():
    still, batch = scene(4), flight(4, 20.0)
    batch.position[:250, 2, 1] += 100.0  # comes near at once: the camera follows slowly
    whole = FormationCameras(still, (BEHIND, ABOVE), 1.0).track(batch)[0]
    cameras = FormationCameras(still, (BEHIND, ABOVE), 1.0)
    pieces = [cameras.track(each)[0] for each in split(batch, 60)]
    for name in ("centre", "heading", "distance"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-9)
    assert whole.distance[-1] < 0.5 * whole.distance[249]
    assert np.abs(np.diff(whole.distance)).max() < 0.01 * whole.distance.max()


def test_unproject_inverts_project():
    batch = flight(4, 1.0)
    for track in FormationCameras(scene(4), (BEHIND, ABOVE), 1.0).track(batch):
        np.testing.assert_allclose(
            track.unproject(*track.project(batch.position)),
            track.to_frame(batch.position),
            atol=1e-9,
        )


def test_overview_camera_sees_path():
    still = scene(4)
    camera = layout.fit_formation(still, flight(4, 1.0)).overview
    axis = np.subtract(camera.target, camera.position)
    toward = still.paths[0] - np.array(camera.position)
    cosine = toward @ axis / (np.linalg.norm(toward, axis=-1) * np.linalg.norm(axis))
    assert np.arccos(cosine).max() < np.radians(30.0)


@pytest.mark.parametrize("known", [0, 2, 4])
def test_cameras_finite_with_nan_in_samples(known):
    still, batch = scene(4), flight(4, 1.0)
    batch.position[:, known:] = np.nan
    batch.slot[:, max(known - 1, 0) :] = np.nan
    framing = layout.fit_formation(still, batch)
    numbers = [framing.size, framing.wind, *framing.overview.position]
    assert np.isfinite(numbers).all()
    for track in FormationCameras(still, (BEHIND, ABOVE), 1.0).track(batch):
        assert np.isfinite(track.centre).all() and np.isfinite(track.distance).all()


@pytest.mark.parametrize(("aircraft", "rows"), [(1, 25), (4, 100), (20, 500), (50, 625)])
def test_stride_grows_with_formation(aircraft, rows):
    step = layout.stride(scene(aircraft), layout.POSE_ROWS_PER_S)
    assert aircraft * 25 / step == rows


def moved(surface, deflection):
    """Compute how far down and right the trailing edge moves at a deflection (3,), m."""
    x, y, z, w = surface.quaternion(np.array([deflection], dtype=float))[0]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    edge = surface.mesh.vertices[surface.mesh.vertices[:, 0].argmin()]
    return (rotation @ edge - edge)[2], (rotation @ edge - edge)[1]


def test_control_surfaces_move_as_commanded():
    rascal = {each.name: each for each in draw_airframe("rascal110", 2.794).control_surfaces}
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
    x8 = {each.name: each for each in draw_airframe("skywalker_x8", 2.1).control_surfaces}
    assert moved(x8["right_elevon"], roll)[0] < -0.01 < 0.01 < moved(x8["left_elevon"], roll)[0]
    assert moved(x8["right_elevon"], pitch)[0] < -0.01 > moved(x8["left_elevon"], pitch)[0]
    assert moved(x8["right_elevon"], pitch + roll) == moved(x8["right_elevon"], roll)  # saturates


def test_cut_control_surface_is_rear_of_surface():
    sections = np.array([[0.1, 0.0, -0.1, 0.4], [0.0, 1.0, -0.2, 0.2]])
    fixed, moving = cut_control_surface(sections, 0.5, 0.9, 0.25)
    for y in (0.5, 0.7, 0.9):
        edge, chord = 0.1 - 0.1 * y, 0.4 - 0.2 * y
        own = [np.interp(y, moving[:, 1], moving[:, k]) for k in range(4)]
        np.testing.assert_allclose(own, [edge - 0.75 * chord, y, -0.1 - 0.1 * y, 0.25 * chord])
    inside = fixed[(fixed[:, 1] > 0.499) & (fixed[:, 1] < 0.901)]
    np.testing.assert_allclose(inside[1:-1, 3], 0.75 * (0.4 - 0.2 * inside[1:-1, 1]))
    np.testing.assert_allclose(fixed[[0, -1]], sections)


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8"])
def test_hinges_lie_on_fixed_part(name):
    drawing = draw_airframe(name, 2.1)
    for surface in drawing.control_surfaces:
        gaps = np.linalg.norm(drawing.body.vertices - surface.hinge, axis=-1)
        assert gaps.min() < 1e-6  # the hinge's inner end is a corner of the hole
        np.testing.assert_allclose(surface.quaternion(np.zeros((1, 3)))[0], [0.0, 0.0, 0.0, 1.0])
