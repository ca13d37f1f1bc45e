"""Noise, broken frames and invalid commands on the link of a run do not change the flight.

Every message is rejected or has no effect, so that the flight must be the same to the bit.
TESTBED_FRAMES sets the number of frames.
"""

import json
import math
import os
import random

from external_run import start_run
from mavlink_client import MavlinkClient

FRAMES = int(os.environ.get("TESTBED_FRAMES", "2000"))
SECONDS = 12.0 if FRAMES > 2000 else 6.0
AT_ONCE = int(FRAMES / (12.5 * SECONDS))  # per received datagram: it lasts half the flight
SEED = 20261122
WALL_CLOCK_KEYS = {"wall_s", "real_time_factor", "mavlink", "pace"}
COMMANDS = (16, 20, 21, 22, 178, 192, 246, 300, 400, 511, 512, 31000)


def invalid_message(rng):
    """Make a message whose request must be rejected."""
    nan, inf = math.nan, math.inf
    target = {
        "target_system": rng.choice([0, 1, 2, 3, 4, 9, 255]),
        "target_component": rng.choice([0, 1, 7]),
    }
    numbers = {f"param{k}": rng.choice([nan, inf, -1.0, 1e30]) for k in range(1, 8)}
    name = rng.choice(["RLL_RATE_P", "NO_SUCH", "\x7f" * 16])
    value = rng.choice([nan, inf, -inf])
    stamp = rng.randrange(1 << 32)
    q = (rng.choice([nan, 0.0, 1.0]), 0.0, 0.0, 0.0)
    rates = {f"body_{axis}_rate": nan for axis in ("roll", "pitch", "yaw")}
    return rng.choice(
        [
            ("COMMAND_LONG", {"command": rng.choice(COMMANDS), "confirmation": 0, **numbers}),
            ("PARAM_SET", {"param_id": name, "param_value": value, "param_type": 9}),
            ("MISSION_COUNT", {"count": rng.choice([701, 65535])}),
            ("MISSION_REQUEST_INT", {"seq": 65535}),
            (
                "SET_ATTITUDE_TARGET",
                {"time_boot_ms": stamp, "type_mask": 7, "q": q, **rates, "thrust": 1.0},
            ),
        ]
    ), target


def broken(frame, rng):
    """Cut or change a frame, or replace it by noise."""
    way = rng.randrange(3)
    if way == 0:
        return rng.randbytes(rng.randrange(1, 300))
    if way == 1:
        return frame[: rng.randrange(1, len(frame))]
    changed = bytearray(frame)
    for _ in range(rng.randrange(1, 12)):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def test_storm_on_link_changes_no_bit(tmp_path):
    rng, sent, right = random.Random(SEED), 0, 0
    length = f"--duration={SECONDS}"
    with start_run(tmp_path / "calm", length) as flight:
        calm = flight.end()
        calm_frames = flight.frames()
    with (
        MavlinkClient() as client,
        start_run(tmp_path / "storm", length, f"--mavlink={client.address}", "--pace=3") as flight,
    ):
        for _ in client.messages_until_end(flight):
            for _ in range(AT_ONCE if sent < FRAMES else 0):
                (name, fields), target = invalid_message(rng)
                frame = client.codec.pack(name, **fields, **target)
                intact = rng.random() < 0.5
                client.send_bytes(frame if intact else broken(frame, rng))
                sent, right = sent + 1, right + intact
        storm = flight.end()
        frames = flight.frames()

    assert sent >= FRAMES
    # messages after the end are not received; "broken" frames may be unchanged
    assert 0.5 * right < storm["mavlink"]["frames_received"] < 1.02 * right
    assert storm["mavlink"]["skipped_bytes"] > 20 * (sent - right)
    assert storm.pop("commanded") == {}
    same = [{k: v for k, v in each.items() if k not in WALL_CLOCK_KEYS} for each in (calm, storm)]
    assert json.dumps(same[0], sort_keys=True) == json.dumps(same[1], sort_keys=True)
    for left, right in zip(calm_frames, frames, strict=True):
        for a, b in zip((*left.truth, *left.command), (*right.truth, *right.command), strict=True):
            assert a.tobytes() == b.tobytes()
