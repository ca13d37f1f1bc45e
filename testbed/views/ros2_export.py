"""A run as a bag of ROS 2: poses, odometry, fixes, inertial measurements, markers.

Frames and axes are those of REP 103 and REP 105: `map` is east, north, up at the scenario's origin,
`<name>/base_link` forward, left, up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from testbed.core.frames import (
    GRAVITY,
    enu_from_ned,
    euler_enu_flu,
    flu_from_frd,
    quaternion_xyzw,
    rotation_ned_body,
)
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.identifiers import identifiers
from testbed.core.records import Array, Event, Indices, VehicleState
from testbed.logs import ros2_bag as ros
from testbed.logs.read import RunLog
from testbed.logs.recorder import FixCovariance
from testbed.views.airframes import draw_airframe, whole
from testbed.views.annotations import Links
from testbed.views.cameras import hold_finite, leader_track
from testbed.views.meshes import Mesh
from testbed.views.panels import Colour
from testbed.views.sample_columns import batch_of
from testbed.views.scene import BACKDROP, mix, paint_colours, scene_of, secondary_colour

MAP, FORMATION = "map", "formation"
FIX_HZ, LINKS_HZ = 5.0, 5.0
_NS = 10**9
_PATH = (0.65, 0.65, 0.67, 1.0)
_GHOST_ALPHA = 0.25
_LINK_M = 0.1  # width of a link


def write_bag(log: RunLog, folder: Path, advance: Callable[[int, int], None] | None = None) -> None:
    """Write a run as a bag of ROS 2.

    Args:
        log: of the run.
        folder: of the bag, which must not exist.
        advance: called with the samples done and their number.
    """
    with ros.Ros2Bag(folder) as bag:
        if log.tick.size:
            _Content(log, bag).write(advance or (lambda done, total: None))


class _Motion:
    """The motion of N aircraft as ROS has it."""

    def __init__(self, state: VehicleState) -> None:
        self.position = hold_finite(enu_from_ned(state.position_ned))
        self.quaternion = quaternion_xyzw(hold_finite(euler_enu_flu(state.euler)))
        body_ned = np.swapaxes(rotation_ned_body(hold_finite(state.euler)), -1, -2)
        self.velocity = _turned(body_ned, state.velocity_ned)
        self.rates = flu_from_frd(state.rates_body)
        # what an accelerometer measures: without gravity
        self.specific_force = _turned(body_ned, state.acceleration_ned - [0.0, 0.0, GRAVITY])


def _turned(body_ned: Array, vectors: Array) -> Array:
    """Resolve NED vectors (..., 3) forward, left and up."""
    return flu_from_frd(np.einsum("...ij,...j->...i", body_ned, vectors))


class _Content:
    def __init__(self, log: RunLog, bag: ros.Ros2Bag) -> None:
        self._log, self._bag, info = log, bag, log.info
        self._names = identifiers(info.names)
        self._time_ns = log.time_ns
        self._truth, self._estimate = _Motion(log.truth), _Motion(log.estimate)
        self._slots = hold_finite(enu_from_ned(log.formation.slot_ned))
        error = log.estimate.position_ned - log.truth.position_ned
        self._covariance = FixCovariance(len(self._names)).add(error)
        self._erring = bool(np.any(self._covariance))
        self._geodetic = geodetic_from_ned(log.estimate.position_ned, info.origin)
        self._scene, self._batch = scene_of(info), batch_of(log, ())
        self._track = leader_track(self._batch)
        self._heading = quaternion_xyzw(euler_enu_flu(self._track.euler))

    def write(self, advance: Callable[[int, int], None]) -> None:
        """Write all messages in order of time."""
        log, times = self._log, self._time_ns.tolist()
        fix_step, link_step = (
            max(1, round(log.info.sample_rate_hz / hz)) for hz in (FIX_HZ, LINKS_HZ)
        )
        links = self._links(np.arange(0, len(times), link_step))
        events = sorted(log.events, key=lambda event: event.time_s)
        for k, time_ns in enumerate(times):
            last = k == len(times) - 1
            while events and (last or events[0].time_s <= log.time_s[k]):
                self._write_event(events.pop(0))
            if k == 0:
                self._write_models(time_ns)
            for row in np.flatnonzero(log.lost[k] & ~log.lost[k - 1]).tolist() if k else ():
                self._write_markers("/models", time_ns, [self._marker("DELETE", k, row, "slots")])
            self._write_frames(k, time_ns)
            for row in range(len(self._names)):
                self._write_aircraft(k, row, time_ns, with_fix=k % fix_step == 0)
            if k % link_step == 0 and self._scene.followers:
                self._write_markers("/links", time_ns, [next(links)])
            advance(k + 1, len(times))

    def _write_frames(self, k: int, time_ns: int) -> None:
        heading, names = self._heading[k], self._names
        frames = [
            (f"{name}/base_link", self._truth.position[k, i], self._truth.quaternion[k, i])
            for i, name in enumerate(names)
        ]
        frames += [(f"{name}/slot", self._slots[k, i], heading) for i, name in enumerate(names[1:])]
        frames.append((FORMATION, self._truth.position[k, 0], heading))
        transforms = [
            ros.transform(time_ns, MAP, child, position.tolist(), rotation.tolist())
            for child, position, rotation in frames
        ]
        self._bag.write("/tf", time_ns, ros.message("tf2_msgs/TFMessage", transforms=transforms))

    def _write_aircraft(self, k: int, row: int, time_ns: int, *, with_fix: bool) -> None:
        name, exact = self._names[row], np.zeros((3, 3))
        base = f"{name}/base_link"
        odometry = self._odometry(self._truth, k, row, time_ns, exact)
        self._bag.write(f"/{name}/odom", time_ns, odometry)
        if self._erring:
            covariance = self._covariance[k, row]
            odometry = self._odometry(self._estimate, k, row, time_ns, covariance)
            self._bag.write(f"/{name}/estimate", time_ns, odometry)
        truth = self._truth
        imu = ros.message(
            "sensor_msgs/Imu",
            header=ros.header(time_ns, base),
            orientation=ros.quaternion(truth.quaternion[k, row].tolist()),
            orientation_covariance=np.zeros(9),
            angular_velocity=ros.vector(truth.rates[k, row].tolist()),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=ros.vector(truth.specific_force[k, row].tolist()),
            linear_acceleration_covariance=np.zeros(9),
        )
        self._bag.write(f"/{name}/imu", time_ns, imu)
        if row:
            slot = ros.message(
                "geometry_msgs/PoseStamped",
                header=ros.header(time_ns, MAP),
                pose=ros.pose(self._slots[k, row - 1].tolist(), self._heading[k].tolist()),
            )
            self._bag.write(f"/{name}/slot", time_ns, slot)
        if with_fix:
            latitude, longitude, altitude = self._geodetic[k, row].tolist()
            covariance = self._covariance[k, row]
            fix = ros.message(
                "sensor_msgs/NavSatFix",
                header=ros.header(time_ns, base),
                status=ros.message("sensor_msgs/NavSatStatus", status=0, service=1),
                latitude=latitude,
                longitude=longitude,
                altitude=altitude,
                position_covariance=covariance.ravel(),
                position_covariance_type=int(covariance.any()),  # approximated, or unknown
            )
            self._bag.write(f"/{name}/fix", time_ns, fix)

    def _odometry(
        self, motion: _Motion, k: int, row: int, time_ns: int, covariance: Array
    ) -> ros.Message:
        six = np.zeros((6, 6))
        six[:3, :3] = covariance
        pose = ros.pose(motion.position[k, row].tolist(), motion.quaternion[k, row].tolist())
        twist = ros.message(
            "geometry_msgs/Twist",
            linear=ros.vector(motion.velocity[k, row].tolist()),
            angular=ros.vector(motion.rates[k, row].tolist()),
        )
        return ros.message(
            "nav_msgs/Odometry",
            header=ros.header(time_ns, MAP),
            child_frame_id=f"{self._names[row]}/base_link",
            pose=ros.message("geometry_msgs/PoseWithCovariance", pose=pose, covariance=six.ravel()),
            twist=ros.message(
                "geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )

    def _write_event(self, event: Event) -> None:
        time_ns = self._log.info.start_unix_ns + round(event.time_s * _NS)
        level = {"info": 20, "warning": 30, "error": 40}.get(event.level, 20)
        line = ros.message(
            "rcl_interfaces/Log",
            stamp=ros.stamp(time_ns),
            level=level,
            name=event.source,
            msg=event.text,
            file="",
            function="",
            line=0,
        )
        self._bag.write("/rosout", time_ns, line)

    def _write_models(self, time_ns: int) -> None:
        """Draw the aircraft, a transparent one in each slot, and the leader's path."""
        scene, markers = self._scene, []
        kinds = zip(scene.airframes, scene.wingspan, scene.colours, strict=True)
        for row, (airframe, span, paint) in enumerate(kinds):
            mesh = whole(draw_airframe(airframe, span))
            solid = _painted(mesh, paint, secondary_colour(paint), 1.0)
            markers.append(self._marker("TRIANGLE_LIST", 0, row, "base_link", *solid))
            if row in scene.followers:
                faded = mix(paint, BACKDROP, 0.5)
                ghost = _painted(mesh, faded, faded, _GHOST_ALPHA)
                markers.append(self._marker("TRIANGLE_LIST", 0, row, "slots", *ghost))
        for number, path in enumerate(scene.paths):
            if len(path) > 1:
                along = enu_from_ned(path)
                colours = np.tile(_PATH, (len(along), 1))
                line = ros.marker(
                    *("LINE_STRIP", time_ns, MAP, "path", number), at=along, colours=colours
                )
                markers.append(line)
        self._write_markers("/models", time_ns, markers)

    def _marker(self, kind: str, k: int, row: int, group: str, *drawn: Array) -> ros.Message:
        frame = f"{self._names[row]}/{'slot' if group == 'slots' else group}"
        at, colours = drawn or (None, None)
        time_ns = int(self._time_ns[k])
        return ros.marker(kind, time_ns, frame, group, row, at=at, colours=colours)

    def _links(self, rows: Indices) -> Iterator[ros.Message]:
        shown = self._batch.rows(rows)
        position = self._track.rows(rows).to_frame(shown.position)
        lines = Links(self._scene).lines(shown, position)
        ends = np.cumsum(lines.counts)
        for k, first, end in zip(rows.tolist(), ends - lines.counts, ends, strict=True):
            at = flu_from_frd(lines.strips[first:end]).reshape(-1, 3)
            shades = np.repeat(lines.colours[first:end], 2, axis=0) / 255.0
            colours = np.concatenate([shades, np.ones((len(shades), 1))], axis=1)
            time_ns = int(self._time_ns[k])
            yield ros.marker(
                *("LINE_LIST", time_ns, FORMATION, "links", 0),
                at=at,
                colours=colours,
                width=_LINK_M,
            )

    def _write_markers(self, topic: str, time_ns: int, markers: list[ros.Message]) -> None:
        array = ros.message("visualization_msgs/MarkerArray", markers=markers)
        self._bag.write(topic, time_ns, array, latched=topic == "/models")


def _painted(mesh: Mesh, paint: Colour, trim: Colour, alpha: float) -> tuple[Array, Array]:
    """List the corners of triangles (k, 3), forward, left, up, and their colours (k, 4)."""
    colours = np.full((3, 4), alpha)
    colours[:, :3] = paint_colours(paint, trim) / 255.0
    corners = mesh.triangles.ravel()
    return flu_from_frd(mesh.vertices[corners]), colours[mesh.paint[corners]]
