"""Time at which a log begins: text of ISO 8601, and nanoseconds since 1970."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

EXAMPLE = "2026-05-01T09:30:00Z"
_NS_PER_US = 1000
_EPOCH = datetime.fromtimestamp(0, UTC)
_LAST = datetime(2037, 12, 31, tzinfo=UTC)  # ROS 2 counts seconds since 1970 in 32 bits
MAX_START_NS = (_LAST - _EPOCH) // timedelta(microseconds=1) * _NS_PER_US


def start_unix_ns(text: str) -> int:
    """Read a time of ISO 8601 as ns since 1970.

    Raises:
        ValueError: it is not such a time, has no time zone, or is not within 1970 to 2037.
    """
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"is not a time of ISO 8601 (write for example {EXAMPLE})") from None
    if time.tzinfo is None:
        raise ValueError(f"has no time zone (write for example {EXAMPLE})")
    if not _EPOCH <= time <= _LAST:
        raise ValueError("is not within 1970 to 2037")
    return (time - _EPOCH) // timedelta(microseconds=1) * _NS_PER_US


def iso_time(unix_s: float) -> str:
    """Return a time since 1970 (UTC), s, as text of ISO 8601, to the millisecond."""
    text = datetime.fromtimestamp(round(unix_s, 3), UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


def now() -> str:
    """Return the present time in UTC as text of ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
