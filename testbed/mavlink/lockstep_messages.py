"""Messages between a run in lockstep and the companions that it has started, beside FOLLOW_TARGET.

The radio of the run decides which message arrives when, and double precision decides the digits of
what follows from that. So before each FOLLOW_TARGET the run sends its time of receipt, as the sum
of three single-precision numbers in DEBUG_FLOAT_ARRAY. A SYSTEM_TIME with the time of a sample
follows the last message up to this time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.mavlink.codec import Codec

RECEIPT = "DEBUG_FLOAT_ARRAY"
_PARTS, _LENGTH = 3, 58  # numbers that are used, and those of the message


def pack_receipt(codec: Codec, time_s: float) -> bytes:
    """Return the frame with a time of receipt, s."""
    data, rest = [0.0] * _LENGTH, time_s
    for k in range(_PARTS):
        data[k] = float(np.float32(rest))
        rest -= data[k]
    return codec.pack(RECEIPT, time_usec=0, name="received_s", array_id=0, data=data)


def receipt_time(data: Any) -> float:  # noqa: ANN401 - of a message
    """Return the time, s, in the numbers of such a frame, to the bit."""
    parts: Sequence[float] = data[:_PARTS]
    total = 0.0
    for each in parts:
        total += float(each)
    return total


def pack_mark(codec: Codec, time_ms: int, unix_us: int) -> bytes:
    """Return the frame that ends the messages of a sample.

    Args:
        codec: of the sender.
        time_ms: of the sample, ms since boot.
        unix_us: the same in µs since 1970.
    """
    return codec.pack("SYSTEM_TIME", time_unix_usec=unix_us, time_boot_ms=time_ms)
