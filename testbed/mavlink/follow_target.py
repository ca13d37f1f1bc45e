"""What aircraft tell each other as MAVLink: FOLLOW_TARGET, packed and read many at a time.

https://mavlink.io/en/messages/common.html#FOLLOW_TARGET. A flight packs thousands of them a
second, so this one message has its own arrays of bytes; a test holds them to the door's codec, bit
for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.frames import (
    body_rates,
    euler_from_quaternion,
    euler_rates,
    geodetic_from_ned,
    ned_from_geodetic,
    quaternion_xyzw,
)
from testbed.state import Array, Broadcast, Origin, Truths

Frames = NDArray[np.uint8]
Numbers = NDArray[np.int64]

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
LENGTH = FRAME.itemsize  # bytes: nothing is cut off, for the last of the payload is never zero
NUMBER = 144
SEED = 127  # of the checksum, by the message's definition
MAGIC, AUTOPILOT = 0xFD, 1
# Position, velocity, acceleration, attitude and rates.
CAPABILITIES = 0b1111

E7 = 1e7
TURN_E7 = 3_600_000_000
MS = 1000
# What clocks show at the start: one that is behind, an hour at most, still counts from zero up.
BEGIN_MS = 3_600_000
_ROUNDING_MS = 1e-6  # a tick is a whole ms but for the last digits


def _checksum_tables() -> tuple[int, NDArray[np.uint16]]:
    """CRC-16/MCRF4XX of a frame of zeros, and what each value of each byte adds to it.

    The checksum is linear: that of a frame is the exclusive or of what its bytes add.
    """
    zeros, polynomial = 0xFFFF, 0x8408  # to begin with; x^16 + x^12 + x^5 + 1, mirrored
    table: NDArray[np.uint16] = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ polynomial, table >> 1).astype(np.uint16)
    summed = LENGTH - 3  # all but the first byte and the checksum itself
    tables = np.empty((summed, 256), np.uint16)
    added = (table >> 8) ^ table[table & 0xFF]  # by a byte that the seed follows
    for place in reversed(range(summed)):
        tables[place] = added
        added = (added >> 8) ^ table[added & 0xFF]
    for byte in (*bytes(summed), SEED):
        zeros = (zeros >> 8) ^ int(table[(zeros ^ byte) & 0xFF])
    return zeros, tables


_OF_ZEROS, _TABLES = _checksum_tables()
_PLACES = np.arange(len(_TABLES))


def checksum(frames: Frames) -> NDArray[np.uint16]:
    """What the checksums of frames (K, LENGTH) should be, (K,)."""
    added = _TABLES[_PLACES, frames[:, 1:-2]]
    found: NDArray[np.uint16] = np.bitwise_xor.reduce(added, axis=1) ^ np.uint16(_OF_ZEROS)
    return found


class FollowTarget:
    """Broadcasts as frames, and frames as broadcasts."""

    def __init__(self, origin: Origin) -> None:
        """Positions are in NED at this origin in broadcasts, and on the earth in frames."""
        self._origin = origin

    def pack(self, message: Broadcast, rows: Numbers, numbers: Numbers) -> Frames:
        """Frames (S, LENGTH) of what S aircraft say.

        Args:
            message: (S); its stamps are what the senders' clocks show.
            rows: (S,) who they are; the system id is one more.
            numbers: (S,) of their messages, of which a frame has the last byte.
        """
        frames = np.zeros(len(rows), FRAME)
        frames["magic"], frames["length"] = MAGIC, PAYLOAD.itemsize
        frames["sequence"], frames["system"] = numbers % 256, rows + 1
        frames["component"], frames["number"][:, 0] = AUTOPILOT, NUMBER
        payload = frames["payload"]
        # what is not a number has no place on the earth, and is nobody's who sends
        with np.errstate(invalid="ignore", over="ignore"):
            clock = np.floor(message.stamp_s * MS + _ROUNDING_MS) + BEGIN_MS
            payload["timestamp"] = np.maximum(clock, 0.0)
            place = geodetic_from_ned(message.position_ned, self._origin)
            payload["lat"] = np.rint(place[:, 0] * E7)
            half = TURN_E7 // 2
            payload["lon"] = np.mod(np.rint(place[:, 1] * E7) + half, TURN_E7) - half
            payload["alt"] = place[:, 2]
            payload["vel"], payload["acc"] = message.velocity_ned, message.acceleration_ned
            attitude = quaternion_xyzw(message.euler)
            payload["attitude_q"][:, 0] = attitude[:, 3]
            payload["attitude_q"][:, 1:] = attitude[:, :3]
            payload["rates"] = body_rates(message.euler, message.euler_rates)
        payload["est_capabilities"] = CAPABILITIES
        raw = _bytes(frames)
        frames["checksum"] = checksum(raw)
        return raw

    def unpack(self, frames: Frames) -> tuple[Broadcast, Numbers, Truths]:
        """What K frames (K, LENGTH) say to one who takes nothing but these messages.

        Returns:
            What the bytes make, whatever that is, of K broadcasts; the row of the sender by its
            system id (K,); and whether the frame is good (K,): it is FOLLOW_TARGET, of MAVLink 2,
            not signed, and its checksum is right.
        """
        heard = np.ascontiguousarray(frames).view(FRAME)[:, 0]
        payload = heard["payload"]
        number = heard["number"]
        good = (
            (heard["magic"] == MAGIC)
            & (heard["length"] == PAYLOAD.itemsize)
            & (heard["incompat_flags"] == 0)
            & (number[:, 0] == NUMBER)
            & ~number[:, 1:].any(axis=1)
            & (heard["checksum"] == checksum(frames))
        )
        place = np.empty((len(heard), 3))
        place[:, 0], place[:, 1] = payload["lat"] / E7, payload["lon"] / E7
        place[:, 2] = _wide(payload["alt"])
        quaternion = np.roll(_wide(payload["attitude_q"]), -1, axis=1)
        # a damaged frame may hold anything
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            euler = euler_from_quaternion(quaternion)
            said = Broadcast(
                stamp_s=(payload["timestamp"].astype(np.float64) - BEGIN_MS) / MS,
                position_ned=ned_from_geodetic(place, self._origin),
                velocity_ned=_wide(payload["vel"]),
                acceleration_ned=_wide(payload["acc"]),
                euler=euler,
                euler_rates=euler_rates(euler, _wide(payload["rates"])),
            )
        return said, heard["system"].astype(np.int64) - 1, good


def _wide(numbers: NDArray[np.float32]) -> Array:
    # of 32 bits, a signalling not-a-number becomes a quiet one, which is an invalid operation
    with np.errstate(invalid="ignore"):
        return numbers.astype(np.float64)


def _bytes(frames: NDArray[np.void]) -> Frames:
    raw: Frames = frames.view(np.uint8).reshape(len(frames), LENGTH)
    return raw
