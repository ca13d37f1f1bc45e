"""STATUSTEXT chunks join to the text, and the server's own warnings fit one message."""

import math
import random

import pytest
from mavlink_control import TO, RecordingControl, VehicleClient, texts

from testbed.mavlink.outgoing import MAX_CHUNKS, TEXT_BYTES, Severity, StatusTexts


def chunks(text):
    """Return the chunks of a text, without the padding nulls."""
    return [each.fields["text"] for each in StatusTexts().make_text(Severity.INFO, text)]


def test_short_text_is_one_message_without_id():
    (message,) = StatusTexts().make_text(Severity.INFO, "x" * TEXT_BYTES)
    assert "id" not in message.fields


def test_joined_chunks_are_the_text():
    draw = random.Random(3)
    for _ in range(200):
        text = " ".join("w" * draw.randint(1, 24) for _ in range(draw.randint(6, 16)))
        parts = chunks(text)
        assert b"".join(parts).decode() == text
        if len(text) > TEXT_BYTES:
            # the null that pads the last chunk ends a text
            assert [len(part) for part in parts[:-1]] == [TEXT_BYTES] * (len(parts) - 1)
            assert len(parts[-1]) < TEXT_BYTES


@pytest.mark.parametrize("text", ["z" * 5000, "word " * 1000])
def test_long_text_is_cut_and_terminated(text):
    parts = chunks(text)
    assert len(parts) == MAX_CHUNKS
    assert len(parts[-1]) < TEXT_BYTES


ATTITUDE = {**TO, "time_boot_ms": 0, "type_mask": 7, "q": (1.0, 0.0, 0.0, 0.0), "thrust": 0.5}
ATTITUDE |= {f"body_{axis}_rate": 0.0 for axis in ("roll", "pitch", "yaw")}


def change(client, name, value):
    return client.send("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)


WARNED = (
    *((400, 2.0), (176, 0.0), (176, 1.0, 2.0), (176, 1.0, 11.0), (178, 1.0, 20.0), (300, 9.0)),
    *((224, math.nan), (246, 1.0), (20,), (21,), (22,)),
    *({"type_mask": 32}, {"type_mask": 128}, {"thrust": math.nan}, {"q": (2.0, 0.0, 0.0, 0.0)}),
    *(("NO_SUCH", 1.0), ("RC1_TRIM", 5.0), ("RC1_TRIM", 2100.0), ("RC1_TRIM", math.nan)),
    *(("SYSID_THISMAV", 9.0), ("SERVO1_FUNCTION", 9.0)),
)


@pytest.mark.parametrize("asked", WARNED, ids=str)
def test_warnings_fit_one_message(asked):
    client = VehicleClient(RecordingControl())
    if isinstance(asked, dict):
        replies = client.send("SET_ATTITUDE_TARGET", **ATTITUDE | asked)
    elif isinstance(asked[0], str):
        replies = change(client, *asked)
    else:
        replies = client.command(*asked)
    (text,) = texts(replies)
    assert 0 < len(text) <= TEXT_BYTES
