"""Broadcasts between aircraft as FOLLOW_TARGET frames, packed and unpacked in arrays.

https://mavlink.io/en/messages/common.html#FOLLOW_TARGET. A flight packs thousands of them per
second; a test compares the frames with those of the codec, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import body_rates, euler_from_quaternion, euler_rates, quaternion_xyzw
from testbed.core.geodetic import geodetic_from_ned, longitude_e7, ned_from_geodetic
from testbed.core.records import Array, BoolArray, Broadcast, NedOrigin
from testbed.mavlink.frame_checksum import FrameChecksum
from testbed.mavlink.law_payload import LawPayload

Frames = NDArray[np.uint8]
IntArray = NDArray[np.int64]

PAYLOAD = np.dtype(
    [
        ("timestamp", "<u8"),  # ms
        ("custom_state", "<u8"),
        ("lat", "<i4"),  # 1e-7 deg
        ("lon", "<i4"),
        ("alt", "<f4"),  # m above sea level
        ("vel", "<f4", (3,)),
        ("acc", "<f4", (3,)),
        ("attitude_q", "<f4", (4,)),  # w, x, y, z
        ("rates", "<f4", (3,)),  # of the body
        ("position_cov", "<f4", (3,)),
        ("est_capabilities", "u1"),
    ]
)
FRAME = np.dtype(
    [
        ("magic", "u1"),
        ("length", "u1"),
        ("incompat_flags", "u1"),
        ("compat_flags", "u1"),
        ("sequence", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("number", "u1", (3,)),
        ("payload", PAYLOAD),
        ("checksum", "<u2"),
    ]
)
LENGTH = FRAME.itemsize  # bytes; nothing is truncated, as the last byte of the payload is not zero
NUMBER = 144
SEED = 127  # CRC_EXTRA of the message
MAGIC, AUTOPILOT = 0xFD, 1
CAPABILITIES = 0b1111  # position, velocity, acceleration, attitude and rates

E7 = 1e7
MS = 1000
# Timestamp at time 0, so that it is not negative for clocks that are slow by up to an hour.
BEGIN_MS = 3_600_000
_ROUNDING_MS = 1e-6  # so that rounding errors do not truncate a tick to the ms before


_CHECKSUM = FrameChecksum(LENGTH, SEED)


def checksum(frames: Frames) -> NDArray[np.uint16]:
    """Compute the checksums (K,) of frames (K, LENGTH)."""
    return _CHECKSUM.of(frames)


class FollowTarget:
    """Convert broadcasts to frames, and frames to broadcasts.

    Attributes:
        payload_bytes: length of a frame with numbers of a law's own.
    """

    def __init__(self, origin: NedOrigin, payload: int = 0) -> None:
        """See the class.

        Args:
            origin: of the NED positions in broadcasts; frames have geodetic positions.
            payload: numbers of a law's own with each broadcast, in a second frame.
        """
        self._origin, self._payload = origin, LawPayload(payload)
        self.payload_bytes = self._payload.length

    def pack_payload(self, values: Array, rows: IntArray, numbers: IntArray) -> Frames:
        """Pack numbers of a law's own; see `LawPayload.pack`."""
        return self._payload.pack(values, rows, numbers)

    def unpack_payload(self, frames: Frames) -> Array:
        """Unpack numbers of a law's own; see `LawPayload.unpack`."""
        return self._payload.unpack(frames)

    def pack(self, message: Broadcast, rows: IntArray, numbers: IntArray) -> Frames:
        """Pack the broadcasts of S aircraft to frames (S, LENGTH).

        Args:
            message: (S); its stamps are times of the senders' clocks.
            rows: (S,) of the senders; the system id is one more.
            numbers: (S,) of their messages; frames have them modulo 256.
        """
        frames = np.zeros(len(rows), FRAME)
        frames["magic"], frames["length"] = MAGIC, PAYLOAD.itemsize
        frames["sequence"], frames["system"] = numbers % 256, rows + 1
        frames["component"], frames["number"][:, 0] = AUTOPILOT, NUMBER
        self.write(message, frames["payload"])
        raw = _bytes(frames)
        frames["checksum"] = checksum(raw)
        return raw

    def write(self, message: Broadcast, payload: NDArray[np.void]) -> None:
        """Write the broadcasts of S aircraft into payloads (S,) of PAYLOAD."""
        # NaN, which is of aircraft that do not send, has no geodetic position
        with np.errstate(invalid="ignore", over="ignore"):
            clock = np.floor(message.stamp_s * MS + _ROUNDING_MS) + BEGIN_MS
            payload["timestamp"] = np.maximum(clock, 0.0)
            place = geodetic_from_ned(message.position_ned, self._origin)
            payload["lat"] = np.rint(place[:, 0] * E7)
            payload["lon"] = longitude_e7(place[:, 1])
            payload["alt"] = place[:, 2]
            payload["vel"], payload["acc"] = message.velocity_ned, message.acceleration_ned
            attitude = quaternion_xyzw(message.euler)
            payload["attitude_q"][:, 0] = attitude[:, 3]
            payload["attitude_q"][:, 1:] = attitude[:, :3]
            payload["rates"] = body_rates(message.euler, message.euler_rates)
        payload["est_capabilities"] = CAPABILITIES

    def unpack(self, frames: Frames) -> tuple[Broadcast, IntArray, BoolArray]:
        """Unpack K frames (K, LENGTH).

        Returns:
            The K broadcasts, of bad frames with any values; the rows of the senders by system id
            (K,); and whether each frame is good (K,): an unsigned FOLLOW_TARGET of MAVLink 2 with
            the right checksum.
        """
        received = np.ascontiguousarray(frames).view(FRAME)[:, 0]
        payload = received["payload"]
        number = received["number"]
        good = (
            (received["magic"] == MAGIC)
            & (received["length"] == PAYLOAD.itemsize)
            & (received["incompat_flags"] == 0)
            & (number[:, 0] == NUMBER)
            & ~number[:, 1:].any(axis=1)
            & (received["checksum"] == checksum(frames))
        )
        return self.read(payload), received["system"].astype(np.int64) - 1, good

    def read(self, payload: NDArray[np.void]) -> Broadcast:
        """Read payloads (K,) of PAYLOAD, which may hold anything."""
        place = np.empty((len(payload), 3))
        place[:, 0], place[:, 1] = payload["lat"] / E7, payload["lon"] / E7
        place[:, 2] = _wide(payload["alt"])
        quaternion = np.roll(_wide(payload["attitude_q"]), -1, axis=1)
        # a damaged frame may hold anything
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            euler = euler_from_quaternion(quaternion)
            return Broadcast(
                stamp_s=(payload["timestamp"].astype(np.float64) - BEGIN_MS) / MS,
                position_ned=ned_from_geodetic(place, self._origin),
                velocity_ned=_wide(payload["vel"]),
                acceleration_ned=_wide(payload["acc"]),
                euler=euler,
                euler_rates=euler_rates(euler, _wide(payload["rates"])),
            )


def _wide(numbers: NDArray[np.float32]) -> Array:
    # converting a signalling NaN to a quiet one is an invalid operation
    with np.errstate(invalid="ignore"):
        return numbers.astype(np.float64)


def _bytes(frames: NDArray[np.void]) -> Frames:
    raw: Frames = frames.view(np.uint8).reshape(len(frames), LENGTH)
    return raw
