"""The radio with messages as MAVLink: what changes, what does not.

What damage does to a frame is in tests/mavlink/equations/test_follow_target.py.
"""

import numpy as np
import pytest
from cases import ALL
from places import TESTS

import testbed
from testbed.core.records import Broadcast, NedOrigin
from testbed.mavlink.follow_target import FollowTarget
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.links import PacketOutcome, resolve_links
from testbed.network.radio import Radio
from testbed.plan.radio import build_radio
from testbed.scenario import dump, loads
from testbed.scenario.network import Network, StampClock

MINIMAL = (TESTS / "data" / "scenarios" / "minimal.yaml").read_text()
NAMES = ("leader", "uav1", "uav2", "uav3")
N, FOLLOWERS = len(NAMES), len(NAMES) - 1
PERIOD, ORIGIN = 0.04, NedOrigin()
KEYS = {
    "delay_s": 0.1,
    "jitter": {"spread_s": 0.08, "correlation": 0.3},
    "loss": 0.1,
    "duplicate": {"probability": 0.3, "correlation": 0.2},
    "corrupt": {"probability": 0.3, "correlation": 0.4},
}


def scenario(network, *overrides):
    return loads(f"{MINIMAL}network: {{{network}}}\n", overrides, source="scenario.yaml")


def broadcast(rng, now):
    vectors = [rng.normal(0.0, each, (N, 3)) for each in (500.0, 20.0, 3.0, 0.4, 0.3)]
    return Broadcast(np.full(N, now), *vectors)


def radio(codec, clocks=None, **keys):
    network = Network.model_validate(keys)
    return Radio(make_channel(resolve_links(NAMES, network), 1), None, codec, clocks)


class AcceptAll(FollowTarget):
    """A receiver that accepts every checksum: a damaged frame always passes."""

    def unpack(self, frames):
        read, rows, valid = super().unpack(frames)
        return read, rows, np.ones_like(valid)


def test_frames_arrive_like_exact_messages():
    """One wrong bit is always detected, so that outcomes are the same with frames and without."""
    rng = np.random.default_rng(1)
    coder = FollowTarget(ORIGIN)
    exact, encoded = radio(None, **KEYS), radio(coder, **KEYS)
    latest = {}
    for k in range(300):
        message, sent = broadcast(rng, k * PERIOD), np.full(N, k * PERIOD)
        rows = np.arange(N)
        latest[k] = coder.unpack(coder.pack(message, rows, np.full(N, k)))[0]
        packets, frames = exact.send(sent, message, None), encoded.send(sent, message, None)
        for name in ("arrival_s", "outcome"):
            assert np.array_equal(packets[name], frames[name])
        theirs, ours = exact.deliver(k * PERIOD), encoded.deliver(k * PERIOD)
        assert np.array_equal(ours.received_s, theirs.received_s, equal_nan=True)
        # k·0.04 s as binary has it, and whole ms divided by 1000
        np.testing.assert_allclose(ours.stamp_s, theirs.stamp_s, rtol=1e-15)
        for i, m in np.argwhere(~np.isnan(ours.stamp_s)):
            read = latest[round(ours.stamp_s[i, m] / PERIOD)]
            for vector, expected in zip(ours[2:], read[1:], strict=True):
                assert np.array_equal(vector[i, m], expected[m])
    summary = encoded.summary()
    damaged = summary.pop("damaged")
    assert summary == exact.summary()
    assert damaged["undetected"] == damaged["discarded"] == 0
    assert damaged["refused"] > summary["all"]["lost"]["corrupted"] > 300


def test_only_senders_are_packed():
    frames = []

    class Recording(FollowTarget):
        def unpack(self, received):
            frames.append(received.copy())
            return super().unpack(received)

    link = radio(Recording(ORIGIN))
    rng = np.random.default_rng(2)
    first, second = broadcast(rng, 0.0), broadcast(rng, PERIOD)
    link.send(np.zeros(N), first, None)
    link.send(np.full(N, PERIOD), second, None, np.array([False, True, False, True]))
    assert [each[:, 4].tolist() for each in frames] == [[0] * N, [1, 1]]  # sequence
    assert frames[1][:, 5].tolist() == [2, 4]  # system
    inbox = link.deliver(PERIOD)
    assert inbox.stamp_s[0].tolist() == [0.0, PERIOD, 0.0, PERIOD]
    for m, message in enumerate((first, second, first, second)):
        assert inbox.velocity_ned[2, m] == pytest.approx(message.velocity_ned[m], abs=1e-5)


def test_stamps_are_read_to_the_millisecond_below():
    clocks = {"leader": StampClock(offset_s=-3600), "uav2": StampClock(drift_ppm=12.3)}
    link = radio(FollowTarget(ORIGIN), make_clocks(NAMES, clocks))
    message = broadcast(np.random.default_rng(3), 100.0)
    link.send(np.full(N, 100.0), message, None)
    inbox = link.deliver(100.0)
    # by hand: uav2's clock shows 100.00123 s, of which the frame has 100.001
    assert inbox.stamp_s[0] == pytest.approx([-3500.0, 100.0, 100.001, 100.0], abs=1e-9)
    expected = np.array([-3500.0, 100.0, 100.001, 100.0]) - 0.00123
    assert inbox.stamp_s[1] == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(link.links["measured_s"], np.full((FOLLOWERS, N), 100.0))


def test_time_on_air_is_that_of_the_frame():
    rate = {"bit_per_s": 57600, "overhead_bytes": 16}
    link = radio(FollowTarget(ORIGIN), encoding="follow-target", rate=rate)
    packets = link.send(np.zeros(N), broadcast(np.random.default_rng(4), 0.0), None)
    assert packets["arrival_s"][0, 0, 0] == pytest.approx((105 + 16) * 8 / 57600, abs=1e-15)


# undetected errors


def test_undetected_errors_are_delivered():
    """All other copies arrive as with exact messages."""
    rng = np.random.default_rng(6)
    keys = {**KEYS, "corrupt": {"probability": 0.5, "bits": 3}, "encoding": "follow-target"}
    exact, encoded = radio(None, **keys), radio(AcceptAll(ORIGIN), **keys)
    wrong_stamps = 0
    for k in range(200):
        message, sent = broadcast(rng, k * PERIOD), np.full(N, k * PERIOD)
        before = exact.send(sent, message, None)["arrival_s"]
        packets = encoded.send(sent, message, None)
        after, whole = packets["arrival_s"], np.isfinite(before)
        assert np.array_equal(before[whole], after[whole])
        received = np.isfinite(after).any(axis=2)
        assert (packets["outcome"][received] == PacketOutcome.DELIVERED).all()
        inbox = encoded.deliver(k * PERIOD)
        known = ~np.isnan(inbox.stamp_s)
        assert np.isfinite(inbox.position_ned[known]).all()
        wrong_stamps += int(
            (known & (np.abs(inbox.stamp_s - encoded.links["measured_s"]) > 0.5e-3)).sum()
        )
    damaged = encoded.summary()["damaged"]
    assert damaged["refused"] == 0
    # of three wrong bits of 840 one may be among the eight of the sender, or make an exponent full
    assert 0 < damaged["discarded"] < 0.1 * damaged["undetected"]
    assert wrong_stamps > 0
    exact.deliver(np.inf)
    encoded.deliver(np.inf)
    ours, theirs = (each.summary()["all"] for each in (encoded, exact))
    assert ours["delivered"] > theirs["delivered"]
    assert ours["lost"]["corrupted"] < theirs["lost"]["corrupted"]
    assert ours["lost"]["lost"] == theirs["lost"]["lost"]


def test_undetected_errors_are_those_of_each_copy():
    """Every copy of a broadcast has its own wrong bits and arrives on its own link."""

    class KeepDamaged(FollowTarget):
        """Accept all frames, and keep the damaged ones."""

        def unpack(self, frames):
            read, rows, valid = super().unpack(frames)
            if not valid.all():
                self.damaged, self.rows, self.read = frames.copy(), rows, read
            return read, rows, np.ones_like(valid)

    coder = KeepDamaged(ORIGIN)
    link = radio(coder, encoding="follow-target", corrupt={"probability": 1, "bits": 40})
    message = broadcast(np.random.default_rng(7), 0.0)
    link.send(np.zeros(N), message, None)
    inbox = link.deliver(0.0)
    others = [(i, m) for i in range(FOLLOWERS) for m in range(N) if m != i + 1]
    assert len(coder.damaged) == len(others)
    assert len({frame.tobytes() for frame in coder.damaged}) == len(others)
    received = 0
    for k, (i, m) in enumerate(others):
        content = np.array([each[k] for each in coder.read[1:]])
        if coder.rows[k] == m and np.isfinite(content).all():
            received += 1
            assert inbox.stamp_s[i, m] == coder.read.stamp_s[k]
            delivered = np.array([each[i, m] for each in inbox[2:]])
            assert np.array_equal(delivered, content)
        else:
            assert np.isnan(inbox.stamp_s[i, m])
    assert received == link.summary()["damaged"]["undetected"] > 0
    assert link.summary()["damaged"]["discarded"] == len(others) - received > 0


# the scenario


def test_scenario_has_encoding_and_wrong_bits():
    encoded = scenario("encoding: follow-target, corrupt: {probability: 0.1, bits: 4}")
    assert loads(dump(encoded)) == encoded
    assert encoded.network.corrupt.bits == 4
    assert scenario("corrupt: 0.1").network.corrupt.bits == 1
    assert "damaged" in radio_of(encoded).summary()
    assert "damaged" not in radio_of(scenario("corrupt: 0.1")).summary()


def radio_of(page):
    weights = np.ones((len(page.fleet), len(page.aircraft), 3))
    return build_radio(page.aircraft_names, page.network, weights, NedOrigin(), 1)[0]


# a flight

END_S = 12 if ALL else 6


@pytest.fixture(scope="module")
def run_metrics():
    def fly(*overrides):
        changes = (
            f"scenario.duration_s={END_S}",
            "scenario.published=null",
            f"scenario.windows={{all: [2, {END_S}]}}",
            *overrides,
        )
        run = testbed.run("simulation-3", changes, write=False)
        assert run.outcome == "completed"
        return run.metrics

    return fly


def test_encoding_changes_a_flight_by_millimetres(run_metrics):
    encoded = [run_metrics("network.encoding=follow-target") for _ in range(2)]
    assert encoded[0]["windows"] == encoded[1]["windows"]
    exact, with_frames = (m["windows"]["all"]["rms_m"] for m in (run_metrics(), encoded[0]))
    off = [abs(with_frames[name] - exact[name]) for name in exact]
    assert 0.0 < max(off) < 5e-3  # half of what the last digit of a position is


def test_undetected_errors_do_not_stop_a_flight(run_metrics, monkeypatch):
    """They may hold any number; at worst the flight ends as lost."""
    from testbed.plan import radio as radios

    monkeypatch.setattr(radios, "FollowTarget", AcceptAll)
    changes = (
        f"scenario.duration_s={6 if ALL else 3}",
        "scenario.published=null",
        "scenario.windows={all: [2, 3]}",
        "network.encoding=follow-target",
        "network.corrupt={probability: 0.5, bits: 60}",
        "controller.extrapolate_from=timestamp",
        "limits.on_loss=continue",
    )
    run = testbed.run("simulation-3", changes, write=False)
    assert run.outcome in ("completed", "lost")
    assert run.metrics["network"]["damaged"]["undetected"] > 100
