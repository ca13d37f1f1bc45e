"""Bags of ROS 2, written without ROS: https://docs.ros.org/en/rolling/p/rosbag2_storage_mcap.

The only module that imports rosbags.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import needs_extra
from testbed.core.records import Array

with needs_extra("ros2", "bags of ROS 2"):
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

Message: TypeAlias = Any  # a class that the library makes from a message definition
_NS = 10**9
# Readers of ROS 2 Humble and of later releases understand it.
_BAG_VERSION: Literal[8] = 8
_FOREVER = QosTime(0, 0)
# Kept for subscribers that come later, as for /tf_static.
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    avoid_ros_namespace_conventions=False,
)
_TYPES = get_typestore(Stores.ROS2_HUMBLE)


class Ros2Bag:
    """Write a bag with MCAP storage, compressed.

    Args:
        folder: of the bag, which must not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._writer = Writer(folder, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._topics: dict[str, Any] = {}

    def __enter__(self) -> Self:
        """Create the folder."""
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """Write the index and metadata.yaml; after an error, neither."""
        if error is None:
            self._writer.close()
        else:
            self._writer.abort()

    def write(self, topic: str, time_ns: int, content: Message, *, latched: bool = False) -> None:
        """Append a message; all of a topic have one type."""
        kind = content.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(
                topic, kind, typestore=_TYPES, offered_qos_profiles=[_LATCHED] if latched else []
            )
        self._writer.write(self._topics[topic], time_ns, _TYPES.serialize_cdr(content, kind))


def message(kind: str, **fields: Any) -> Message:  # noqa: ANN401 - values of any message
    """Make a message: `message("geometry_msgs/Point", x=1.0, y=2.0, z=3.0)`."""
    package, name = kind.split("/")
    return _TYPES.types[f"{package}/msg/{name}"](**fields)


def stamp(time_ns: int) -> Message:
    """Make a time."""
    return message("builtin_interfaces/Time", sec=time_ns // _NS, nanosec=time_ns % _NS)


def header(time_ns: int, frame: str) -> Message:
    """Make a header."""
    return message("std_msgs/Header", stamp=stamp(time_ns), frame_id=frame)


def vector(values: Sequence[float]) -> Message:
    """Make a Vector3."""
    return message("geometry_msgs/Vector3", **dict(zip("xyz", values, strict=True)))


def points(positions: Array) -> list[Message]:
    """Make points of positions (k, 3)."""
    kind = _TYPES.types["geometry_msgs/msg/Point"]
    return [kind(*each) for each in positions.tolist()]


def quaternion(xyzw: Sequence[float]) -> Message:
    """Make a rotation."""
    return message("geometry_msgs/Quaternion", **dict(zip("xyzw", xyzw, strict=True)))


def pose(position: Sequence[float], xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Message:
    """Make a pose."""
    [where] = points(np.asarray([position], dtype=np.float64))
    return message("geometry_msgs/Pose", position=where, orientation=quaternion(xyzw))


def transform(
    time_ns: int, parent: str, child: str, position: Sequence[float], xyzw: Sequence[float]
) -> Message:
    """Make a TransformStamped: the pose of a child frame in its parent."""
    return message(
        "geometry_msgs/TransformStamped",
        header=header(time_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/Transform", translation=vector(position), rotation=quaternion(xyzw)
        ),
    )


def marker(
    kind: str,
    time_ns: int,
    frame: str,
    group: str,
    number: int,
    *,
    at: Array | None = None,
    colours: NDArray[np.float64] | None = None,
    width: float = 1.0,
) -> Message:
    """Make a marker that moves with its frame.

    Args:
        kind: `LINE_LIST`, `LINE_STRIP` or `TRIANGLE_LIST`; `DELETE` removes the marker.
        time_ns: of the marker.
        frame: of its points.
        group: its namespace.
        number: its id there.
        at: (k, 3) m, points.
        colours: (k, 4) red, green, blue and opacity, 0..1, of the points.
        width: m, of lines.
    """
    kinds: Any = _TYPES.types["visualization_msgs/msg/Marker"]
    deleted = kind == "DELETE"
    size = width if kind.startswith("LINE") else 1.0
    shades = (
        {} if colours is None else {each: _colour(each) for each in {*map(tuple, colours.tolist())}}
    )
    return message(
        "visualization_msgs/Marker",
        header=header(time_ns, frame),
        ns=group,
        id=number,
        type=0 if deleted else getattr(kinds, kind),
        action=kinds.DELETE if deleted else kinds.ADD,
        pose=pose((0.0, 0.0, 0.0)),
        scale=vector((size, size, size)),
        color=_colour((1.0, 1.0, 1.0, 1.0)),
        lifetime=message("builtin_interfaces/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[] if at is None else points(at),
        colors=[] if colours is None else [shades[each] for each in map(tuple, colours.tolist())],
        texture_resource="",
        texture=message(
            "sensor_msgs/CompressedImage",
            header=header(0, ""),
            format="",
            data=np.zeros(0, np.uint8),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=message("visualization_msgs/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )


def _colour(rgba: Sequence[float]) -> Message:
    return message("std_msgs/ColorRGBA", **dict(zip("rgba", rgba, strict=True)))
