"""The radio with messages as MAVLink: what changes, what does not, and how a wrong page is refused.

What damage does to a frame is in tests/equations/test_follow_target.py.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import testbed
from testbed.mavlink.follow_target import FollowTarget
from testbed.network import radio as radio_module
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.fates import fates
from testbed.network.links import Fate
from testbed.network.radio import Conditions, Radio
from testbed.network.traffic import idle
from testbed.scenario import ScenarioError, dump, loads
from testbed.scenario.network import Network, StampClock
from testbed.sim.radios import make_radio
from testbed.state import Broadcast, Origin

MINIMAL = (Path(__file__).parents[1] / "data" / "scenarios" / "minimal.yaml").read_text()
NAMES = ("leader", "uav1", "uav2", "uav3")
N, FOLLOWERS = len(NAMES), len(NAMES) - 1
PERIOD, ORIGIN = 0.04, Origin()
KNOBS = {
    "delay_s": 0.1,
    "jitter": {"spread_s": 0.08, "correlation": 0.3},
    "loss": 0.1,
    "duplicate": {"probability": 0.3, "correlation": 0.2},
    "corrupt": {"probability": 0.3, "correlation": 0.4},
}


def page(network, *overrides):
    return loads(f"{MINIMAL}network: {{{network}}}\n", overrides, source="page.yaml")


def complaint(network, *overrides):
    with pytest.raises(ScenarioError) as caught:
        page(network, *overrides)
    return str(caught.value)


def say(rng, now):
    vectors = [rng.normal(0.0, each, (N, 3)) for each in (500.0, 20.0, 3.0, 0.4, 0.3)]
    return Broadcast(np.full(N, now), *vectors)


def radio(coder, conditions=None, **knobs):
    network = Network.model_validate(knobs)
    return Radio(make_channel(NAMES, network, 1), conditions, coder)


class Credulous(FollowTarget):
    """One who believes every checksum: as if a damaged frame always passed."""

    def unpack(self, frames):
        said, rows, good = super().unpack(frames)
        return said, rows, np.ones_like(good)


def test_whole_frames_arrive_as_they_read_with_the_fates_and_times_of_exact_messages():
    """One wrong bit is always found, so that dice decide the same with frames and without."""
    rng = np.random.default_rng(1)
    coder = FollowTarget(ORIGIN)
    exact, coded = radio(None, **KNOBS), radio(coder, **KNOBS)
    latest = {}
    for k in range(300):
        message, sent = say(rng, k * PERIOD), np.full(N, k * PERIOD)
        rows = np.arange(N)
        latest[k] = coder.unpack(coder.pack(message, rows, np.full(N, k)))[0]
        for one, other in zip(
            exact.send(sent, message, None), coded.send(sent, message, None), strict=True
        ):
            assert np.array_equal(one, other)
        theirs, ours = exact.deliver(k * PERIOD), coded.deliver(k * PERIOD)
        assert np.array_equal(ours.received_s, theirs.received_s, equal_nan=True)
        # k·0.04 s as binary has it, and whole ms divided by 1000
        np.testing.assert_allclose(ours.stamp_s, theirs.stamp_s, rtol=1e-15)
        for i, m in np.argwhere(~np.isnan(ours.stamp_s)):
            heard = latest[round(ours.stamp_s[i, m] / PERIOD)]
            for vector, told in zip(ours[2:], heard[1:], strict=True):
                assert np.array_equal(vector[i, m], told[m])
    summary = coded.summary()
    damaged = summary.pop("damaged")
    assert summary == exact.summary()
    assert damaged["believed"] == damaged["discarded"] == 0
    assert damaged["refused"] > summary["all"]["lost"]["corrupted"] > 300


def test_only_those_who_send_are_packed_with_numbers_of_their_own():
    frames = []

    class Listening(FollowTarget):
        def unpack(self, heard):
            frames.append(heard.copy())
            return super().unpack(heard)

    link = radio(Listening(ORIGIN))
    rng = np.random.default_rng(2)
    first, second = say(rng, 0.0), say(rng, PERIOD)
    link.send(np.zeros(N), first, None)
    link.send(np.full(N, PERIOD), second, None, np.array([False, True, False, True]))
    assert [heard[:, 4].tolist() for heard in frames] == [[0] * N, [1, 1]]  # sequence
    assert frames[1][:, 5].tolist() == [2, 4]  # system
    inbox = link.deliver(PERIOD)
    assert inbox.stamp_s[0].tolist() == [0.0, PERIOD, 0.0, PERIOD]
    for m, told in enumerate((first, second, first, second)):
        assert inbox.velocity_ned[2, m] == pytest.approx(told.velocity_ned[m], abs=1e-5)


def test_clocks_are_read_to_the_millisecond_below():
    clocks = {"leader": StampClock(offset_s=-3600), "uav2": StampClock(drift_ppm=12.3)}
    conditions = Conditions(clocks=make_clocks(NAMES, clocks))
    link = radio(FollowTarget(ORIGIN), conditions)
    message = say(np.random.default_rng(3), 100.0)
    link.send(np.full(N, 100.0), message, None)
    inbox = link.deliver(100.0)
    # by hand: uav2's clock shows 100.00123 s, of which the frame has 100.001
    assert inbox.stamp_s[0] == pytest.approx([-3500.0, 100.0, 100.001, 100.0], abs=1e-9)
    expected = np.array([-3500.0, 100.0, 100.001, 100.0]) - 0.00123
    assert inbox.stamp_s[1] == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(link.measured_s, np.full((FOLLOWERS, N), 100.0))


def test_the_frame_is_what_takes_time_on_the_air():
    rate = {"bit_per_s": 57600, "overhead_bytes": 16}
    link = radio(FollowTarget(ORIGIN), encoding="follow-target", rate=rate)
    arrivals, _ = link.send(np.zeros(N), say(np.random.default_rng(4), 0.0), None)
    assert arrivals[0, 0, 0] == pytest.approx((105 + 16) * 8 / 57600, abs=1e-15)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_compiled_and_numpy_channels_spoil_the_same_copies_at_the_same_times(arithmetic):
    twin = pytest.importorskip("testbed.network.fates_twin", exc_type=ImportError)
    knobs = {**KNOBS, "arithmetic": arithmetic, "reorder": 0.1, "drop": [3, 5, 8]}
    knobs["rate"] = {"bit_per_s": 40000, "queue_packets": 3}
    channel = make_channel(NAMES, Network.model_validate(knobs), 5)
    ours, theirs = idle(channel), idle(channel)
    rng, both, nobody = np.random.default_rng(5), 0, np.zeros((FOLLOWERS, N))
    for k in range(400):
        rows = np.flatnonzero(rng.random(N) < 0.8)
        shape = FOLLOWERS, len(rows)
        script = rng.choice(
            np.array([0, Fate.LISTED, Fate.MUTE], np.uint8), shape, p=(0.9, 0.05, 0.05)
        )
        sending = (rows, np.full(len(rows), k), np.full(len(rows), k * PERIOD), script)
        rest = np.full(shape, np.nan), nobody[:, rows] + 0.1
        arrivals, fate = fates(channel, ours, *sending, *rest)
        twin.fates(channel, theirs, *sending, *rest)
        np.testing.assert_allclose(ours.spoiled_s, theirs.spoiled_s, rtol=1e-12)  # rounding
        spoiled = np.isfinite(ours.spoiled_s[:, rows])
        assert not (spoiled & np.isfinite(arrivals)).any()
        hit = spoiled.any(axis=2)
        assert np.isin(fate[hit], (Fate.CORRUPTED, Fate.DELIVERED)).all()
        assert hit[fate == Fate.CORRUPTED].all()
        both += int((hit & (fate == Fate.DELIVERED)).sum())
    assert both > 50  # one copy spoiled, the other whole


# what passes


def test_a_damaged_frame_that_passes_is_heard_as_it_reads_when_it_arrives():
    """Held to frames damaged here, copy by copy; everything else is as with whole ones."""
    rng = np.random.default_rng(6)
    knobs = {**KNOBS, "corrupt": {"probability": 0.5, "bits": 3}, "encoding": "follow-target"}
    exact, coded = radio(None, **knobs), radio(Credulous(ORIGIN), **knobs)
    strange = 0
    for k in range(200):
        message, sent = say(rng, k * PERIOD), np.full(N, k * PERIOD)
        before, _ = exact.send(sent, message, None)
        after, fate = coded.send(sent, message, None)
        whole = np.isfinite(before)
        assert np.array_equal(before[whole], after[whole])
        assert (fate[np.isfinite(after).any(axis=2)] == Fate.DELIVERED).all()
        inbox = coded.deliver(k * PERIOD)
        heard = ~np.isnan(inbox.stamp_s)
        assert np.isfinite(inbox.position_ned[heard]).all()
        strange += int((heard & (np.abs(inbox.stamp_s - coded.measured_s) > 0.5e-3)).sum())
    damaged = coded.summary()["damaged"]
    assert damaged["refused"] == 0
    # of three wrong bits of 840 one may be among the eight of the sender, or make an exponent full
    assert 0 < damaged["discarded"] < 0.1 * damaged["believed"]
    assert strange > 0
    exact.deliver(np.inf)
    coded.deliver(np.inf)
    ours, theirs = (each.summary()["all"] for each in (coded, exact))
    assert ours["delivered"] > theirs["delivered"]
    assert ours["lost"]["corrupted"] < theirs["lost"]["corrupted"]
    assert ours["lost"]["lost"] == theirs["lost"]["lost"]


def test_the_content_of_each_believed_copy_is_its_own():
    """Every copy of a round is damaged in places of its own and put on its own link."""

    class Marked(FollowTarget):
        """Believes only what is damaged in the velocity, and tells which bits those were."""

        def unpack(self, frames):
            said, rows, good = super().unpack(frames)
            if not good.all():
                self.damaged, self.rows = frames.copy(), rows
                self.said = said
            return said, rows, np.ones_like(good)

    coder = Marked(ORIGIN)
    link = radio(coder, encoding="follow-target", corrupt={"probability": 1, "bits": 40})
    message = say(np.random.default_rng(7), 0.0)
    link.send(np.zeros(N), message, None)
    inbox = link.deliver(0.0)
    others = [(i, m) for i in range(FOLLOWERS) for m in range(N) if m != i + 1]
    assert len(coder.damaged) == len(others)
    assert len({frame.tobytes() for frame in coder.damaged}) == len(others)
    heard = 0
    for k, (i, m) in enumerate(others):
        content = np.array([each[k] for each in coder.said[1:]])
        if coder.rows[k] == m and np.isfinite(content).all():
            heard += 1
            assert inbox.stamp_s[i, m] == coder.said.stamp_s[k]
            told = np.array([each[i, m] for each in inbox[2:]])
            assert np.array_equal(told, content)
        else:
            assert np.isnan(inbox.stamp_s[i, m])
    assert heard == link.summary()["damaged"]["believed"] > 0
    assert link.summary()["damaged"]["discarded"] == len(others) - heard > 0


def test_the_same_frames_are_damaged_in_the_same_places_with_numpy_and_compiled(monkeypatch):
    pytest.importorskip("numba")
    from testbed.network import fates as numpy_fates
    from testbed.network import post as numpy_post

    knobs = {**KNOBS, "corrupt": {"probability": 0.5, "bits": 5}, "encoding": "follow-target"}

    def exchange():
        link, rng = radio(Credulous(ORIGIN), **knobs), np.random.default_rng(8)
        found = []
        for k in range(100):
            link.send(np.full(N, k * PERIOD), say(rng, k * PERIOD), None, rng.random(N) < 0.8)
            found.append(np.concatenate([each.ravel() for each in link.deliver(k * PERIOD)]))
        return np.array(found), link.summary()["damaged"]

    compiled, counts = exchange()
    monkeypatch.setattr(radio_module, "BEFALL", numpy_fates.befall)
    monkeypatch.setattr(radio_module, "POST_ROUND", numpy_post.post_round)
    plainly = partial(partial, numpy_post.take_due)
    monkeypatch.setattr(radio_module, "READY_TAKE_DUE", plainly)
    plain, others = exchange()
    np.testing.assert_allclose(compiled, plain, rtol=1e-12)  # rounding of delays
    assert counts == others
    assert counts["believed"] > 100


# the page


def test_a_page_says_which_encoding_and_how_many_bits():
    coded = page("encoding: follow-target, corrupt: {probability: 0.1, bits: 4}")
    assert loads(dump(coded)) == coded
    assert coded.network.corrupt.bits == 4
    assert page("corrupt: 0.1").network.corrupt.bits == 1
    radio_, _ = make_radio(coded)
    assert "damaged" in radio_.summary()
    assert "damaged" not in make_radio(page("corrupt: 0.1"))[0].summary()


@pytest.mark.parametrize(
    ("network", "says"),
    [
        (
            "encoding: follow-target, message_bytes: 60",
            "network.message_bytes: is the encoding's: a frame of follow-target has 105 bytes "
            "(leave this out, or write encoding: exact)",
        ),
        (
            "corrupt: {probability: 0.1, bits: 2}",
            "network.corrupt.bits: has a meaning where messages are frames with a checksum "
            "(write network.encoding: follow-target, or leave this out)",
        ),
        (
            "links: {leader: {uav1: {corrupt: {probability: 0.1, bits: 2}}}}",
            "network.links.leader.uav1.corrupt.bits: has a meaning where",
        ),
        ("encoding: follow-target, corrupt: {probability: 0.1, bits: 841}", "at most 840"),
        ("encoding: mavlink", "network.encoding: "),
    ],
)
def test_what_does_not_go_together_is_refused(network, says):
    assert says in " ".join(complaint(network).split())


def test_more_aircraft_than_system_ids_are_refused():
    names = [f"uav{k}" for k in range(1, 256)]
    fleet = ", ".join(
        f"{{name: {each}, aircraft: rascal110, start_m: [0, 0, 0]}}" for each in names
    )
    offsets = ", ".join(f"{each}: [-5, 0, 0]" for each in names)
    many = complaint(
        "encoding: follow-target", f"fleet=[{fleet}]", f"formation.offsets_m={{{offsets}}}"
    )
    assert "is for 255 aircraft" in " ".join(many.split())


# a flight


@pytest.fixture(scope="module")
def flown():
    def fly(*overrides):
        changes = (
            "scenario.duration_s=12",
            "scenario.published=null",
            "scenario.portions={all: [2, 12]}",
            *overrides,
        )
        run = testbed.run("simulation-3", changes, write=False)
        assert run.outcome == "flown"
        return run.metrics

    return fly


def test_centimetres_and_milliseconds_cost_a_formation_millimetres_and_flights_repeat(flown):
    coded = [flown("network.encoding=follow-target") for _ in range(2)]
    assert coded[0]["portions"] == coded[1]["portions"]
    exact, with_frames = (m["portions"]["all"]["rms_m"] for m in (flown(), coded[0]))
    off = [abs(with_frames[name] - exact[name]) for name in exact]
    assert 0.0 < max(off) < 5e-3  # half of what the last digit of a position is


def test_a_radio_that_believes_everything_does_not_stop_a_flight(flown, monkeypatch):
    """What passes may hold any number; the worst is that the flight ends as lost."""
    from testbed.sim import radios

    monkeypatch.setattr(radios, "FollowTarget", Credulous)
    changes = (
        "scenario.duration_s=6",
        "scenario.published=null",
        "scenario.portions={all: [2, 6]}",
        "network.encoding=follow-target",
        "network.corrupt={probability: 0.5, bits: 60}",
        "controller.extrapolate_from=timestamp",
        "limits.when_lost=fly-on",
    )
    run = testbed.run("simulation-3", changes, write=False)
    assert run.outcome in ("flown", "lost")
    assert run.metrics["network"]["damaged"]["believed"] > 100
