"""Transmitters, slots, overtaking, second copies and checksums against theory and by hand."""

from collections import deque

import numpy as np
import pytest
from network_samples import (
    LEAST,
    PACKETS,
    assert_chance,
    assert_counts,
    assert_lengths,
    assert_mean,
    assert_normal,
    assert_share,
    make,
    send,
)
from reference.channel_simulation import transmit, transmit_at
from scipy import stats

from testbed.network.links import PacketOutcome

BITS = 800  # of the 100 bytes of a message


def per_second(packets):
    """Return the rate, bit/s, of a transmitter that sends so many messages in a second."""
    return BITS * packets


def send_at(times, **keys):
    """Return arrivals and outcomes (K,) of messages on one link at these times."""
    run = transmit_at(make(**keys), np.repeat(np.asarray(times)[:, None], 2, axis=1))
    return run.received_s[:, 0, 0], run.outcome[:, 0, 0]


# rate


def test_free_transmitter_adds_time_on_air():
    """100 bytes and 28 of headers at 10240 bit/s take 0.1 s, whatever was before."""
    rate = {"bit_per_s": 10240, "overhead_bytes": 28}
    flow = send(1000, period_s=0.125, delay_s=0.25, rate=rate)
    assert flow.delay_s == pytest.approx(0.35, abs=1e-9)
    flow = send(1000, period_s=0.1, delay_s=0.25, rate=rate)  # just in time
    assert flow.delay_s == pytest.approx(0.35, abs=1e-9)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_rate_0_is_no_limit(arithmetic):
    flow = send(1000, delay_s=0.25, rate={"bit_per_s": 0}, arithmetic=arithmetic)
    assert np.array_equal(flow.delay_s, np.full(1000, 0.25))


def test_queue_of_three_by_hand():
    """Messages every 50 ms, 100 ms each: the queue fills to three, then every other is dropped.

    Leaving at 0.1, 0.2, 0.3, ...: at 0.25 s those that leave at 0.3, 0.4 and 0.5 s are inside.
    """
    rate = {"bit_per_s": per_second(10), "queue_packets": 3}
    flow = send(12, period_s=0.05, rate=rate)
    n = np.nan
    by_hand = [0.1, 0.2, 0.3, 0.4, 0.5, n, 0.6, n, 0.7, n, 0.8, n]
    assert flow.received_s == pytest.approx(by_hand, abs=1e-9, nan_ok=True)
    assert np.array_equal(flow.outcome == PacketOutcome.QUEUE, np.isnan(by_hand))
    assert np.isin(flow.outcome, (PacketOutcome.DELIVERED, PacketOutcome.QUEUE)).all()


def test_netem_two_copies_enter_the_last_place():
    """The place is looked for once, for both; then it takes two to leave before one enters."""
    rate = {"bit_per_s": per_second(10), "queue_packets": 1}
    flow = send(6, period_s=0.09, duplicate=1, rate=rate, arithmetic="netem")
    assert flow.copies.tolist() == [2, 0, 0, 2, 0, 0]
    assert flow.received_s[[0, 3]] == pytest.approx([0.1, 0.37])
    assert flow.second_s[[0, 3]] == pytest.approx([0.2, 0.47])
    assert (flow.outcome[[1, 2, 4, 5]] == PacketOutcome.QUEUE).all()


def test_netem_queue_by_hand():
    """Its messages are inside until their delay is over, and the transmitter is after it.

    0.1 s of delay and 0.1 s each leave at 0.2, 0.3 and 0.4 s; at 0.15 s three are inside.
    """
    rate = {"bit_per_s": per_second(10), "queue_packets": 3}
    flow = send(10, period_s=0.05, delay_s=0.1, rate=rate, arithmetic="netem")
    n = np.nan
    by_hand = [0.2, 0.3, 0.4, n, 0.5, n, 0.6, n, 0.7, n]
    assert flow.received_s == pytest.approx(by_hand, abs=1e-9, nan_ok=True)
    assert np.array_equal(flow.outcome == PacketOutcome.QUEUE, np.isnan(by_hand))


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize(("load", "places"), [(1.25, 1), (2.0, 7), (3.7, 50)])
def test_overload_is_dropped_and_waits_are_bounded(load, places, arithmetic):
    rate = {"bit_per_s": per_second(10), "queue_packets": places}
    flow = send(PACKETS // 4, period_s=0.1 / load, rate=rate, arithmetic=arithmetic)
    dropped = flow.outcome == PacketOutcome.QUEUE
    if places > 1:  # it never runs dry, so it serves as many as it can
        assert dropped.mean() == pytest.approx(1.0 - 1.0 / load, abs=2.0 * places / len(dropped))
        assert np.diff(flow.received_s[~dropped]) == pytest.approx(0.1, abs=1e-6)
    else:  # with no place to wait the first after the end of a message is served
        assert dropped.mean() == pytest.approx(1.0 - 1.0 / np.ceil(load), abs=1e-3)
    waits = flow.delay_s[~dropped]
    assert waits.max() <= places * 0.1 + 1e-6
    assert waits.max() > (places - 1.0 / load) * 0.1 - 1e-6


def in_a_deque(times, service, places):
    """The second route: when each leaves (nan: dropped), by a queue of departure times."""
    inside, out = deque(), np.full(len(times), np.nan)
    for k, now in enumerate(times):
        while inside and inside[0] <= now:
            inside.popleft()
        if len(inside) < places:
            inside.append(max(now, inside[-1] if inside else now) + service)
            out[k] = inside[-1]
    return out


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize("load", [0.7, 1.3])
def test_random_arrivals_match_a_deque(load, arithmetic):
    times = np.cumsum(np.random.default_rng(4).exponential(0.1 / load, 10_000))
    rate = {"bit_per_s": per_second(10), "queue_packets": 4}
    arrivals, outcome = send_at(times, rate=rate, arithmetic=arithmetic)
    expected = in_a_deque(times, 0.1, 4)
    assert np.array_equal(outcome == PacketOutcome.QUEUE, np.isnan(expected))
    assert 0.01 < (outcome == PacketOutcome.QUEUE).mean() < 0.5
    served = outcome == PacketOutcome.DELIVERED
    assert arrivals[served] == pytest.approx(expected[served], abs=1e-9)


def test_mean_wait_is_that_of_pollaczek_khinchine():
    """M/D/1: the mean wait is load x service / (2 (1 - load))."""
    load, service = 0.6, 0.1
    times = np.cumsum(np.random.default_rng(6).exponential(service / load, PACKETS))
    arrivals, outcome = send_at(times, rate={"bit_per_s": per_second(10), "queue_packets": 1000})
    assert (outcome == PacketOutcome.DELIVERED).all()
    assert_mean(arrivals - times - service, load * service / (2.0 * (1.0 - load)))


# slots


def test_slots_by_hand():
    """Slots at 0.05, 0.15, 0.25 ... s, one message each, and one may wait."""
    slots = {"every_s": 0.1, "first_s": 0.05}
    flow = send(8, period_s=0.04, delay_s=1.0, slots=slots)
    # at 0, .04, .08, .12, .16, .2, .24, .28: the first takes .05; .04 finds it waiting
    n = np.nan
    by_hand = [1.05, n, 1.15, n, 1.25, n, n, 1.35]
    assert flow.received_s == pytest.approx(by_hand, abs=1e-9, nan_ok=True)
    assert np.array_equal(flow.outcome == PacketOutcome.QUEUE, np.isnan(by_hand))


def test_slot_takes_its_packets_and_others_wait():
    slots = {"every_s": 0.1, "packets": 2, "queue_packets": 6}
    flow = send(6, period_s=0.01, phase_s=0.01, slots=slots)
    assert flow.received_s == pytest.approx([0.1, 0.1, 0.2, 0.2, 0.3, 0.3], abs=1e-9)


@pytest.mark.parametrize("every", [0.1, 0.05, 1e-3, 1e-4])
def test_message_in_time_for_a_slot_takes_it(every):
    """Times that are one in decimals and not in binary; hours into a flight, too."""
    for phase in (0.0, 0.7, 7200.3):
        slots = {"every_s": every, "first_s": 0.3, "queue_packets": 2}
        flow = send(2000, period_s=every, phase_s=phase + 0.3, slots=slots)
        assert (flow.outcome == PacketOutcome.DELIVERED).all()
        assert abs(flow.delay_s).max() < 2e-9


def test_random_slots_have_uniform_intervals():
    """Saturated, so that every slot is used: Kolmogorov and Smirnov on the gaps."""
    low, high = 0.05, 0.25
    slots = {"every_s": [low, high], "queue_packets": 20}
    flow = send(period_s=0.1, slots=slots)
    times = flow.received_s[flow.outcome == PacketOutcome.DELIVERED]
    gaps = np.diff(times)
    assert len(gaps) > PACKETS / 2
    assert_chance(stats.kstest(gaps, stats.uniform(low, high - low).cdf).pvalue)
    middle = gaps - 0.5 * (low + high)
    assert_mean(middle[1:] * middle[:-1], 0.0)


def test_random_slots_do_not_depend_on_use():
    """A message after a long pause takes the slot that a busy link has there."""
    slots = {"every_s": [0.05, 0.25], "queue_packets": 20}
    busy = send(4000, period_s=0.1, slots=slots).received_s
    busy = busy[~np.isnan(busy)]
    times = np.sort(np.random.default_rng(5).uniform(5.0, 350.0, 50))
    seldom, _ = send_at(times, slots=slots)
    assert seldom == pytest.approx(busy[np.searchsorted(busy, times)], abs=1e-9)


def turns(packets, period_s, phase_s=0.0, **tdma):
    names = ("leader", "uav1", "uav2")
    return transmit(
        make(names, delay_s=1.0, tdma={"frame_s": 0.3, **tdma}),
        packets=packets,
        period_s=period_s,
        phase_s=phase_s,
    )


@pytest.mark.parametrize("order", [None, ["uav2", "leader", "uav1"]])
def test_tdma_aircraft_sends_in_its_own_slot(order):
    phases = np.array([0.01234567, 0.07712345, 0.19154321])  # never at a slot's very time
    sent = turns(2000, np.array([0.3, 0.47, 0.811]), phases, **({"order": order} if order else {}))
    rows = [["leader", "uav1", "uav2"].index(name) for name in order or ("leader", "uav1", "uav2")]
    for m in range(3):
        to = 0 if m != 1 else 1  # an aircraft's message to itself does not wait
        left = sent.received_s[:, to, m] - 1.0
        assert (sent.outcome[:, to, m] == PacketOutcome.DELIVERED).all()
        own = 0.1 * rows.index(m)
        into_frame = (left - own + 0.15) % 0.3 - 0.15
        assert abs(into_frame).max() < 1e-8
        wait = left - sent.sent_s[:, m]
        assert wait == pytest.approx((own - sent.sent_s[:, m]) % 0.3, abs=1e-8)


def test_tdma_aircraft_has_one_slot_per_frame():
    sent = turns(900, 0.1, 0.02)
    for m in range(3):
        to = 0 if m != 1 else 1
        left = sent.received_s[:, to, m]
        left = left[~np.isnan(left)]
        # the frame serves one of three; until the last leaves none may wait
        assert np.diff(left) == pytest.approx(0.3, abs=1e-8)
        assert (sent.outcome[:, to, m] == PacketOutcome.QUEUE).mean() == pytest.approx(
            2 / 3, abs=0.01
        )


# overtaking


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize(("q", "gap"), [(0.25, 1), (0.25, 5), (1.0, 3), (0.6, 2)])
def test_reordering_keeps_the_gap(q, gap, arithmetic):
    """A renewal process: gap - 1 packets may not, and then each does with probability q."""
    keys = {"reorder": {"probability": q, "gap": gap}, "arithmetic": arithmetic}
    flow = send(period_s=0.125, delay_s=1.0, **keys)
    overtook = flow.delay_s == 0.0
    assert np.array_equal(flow.delay_s[~overtook], np.ones((~overtook).sum()))
    apart = np.diff(np.flatnonzero(overtook))
    assert apart.min() >= gap
    if q == 1.0:
        assert (apart == gap).all()
        return
    assert_lengths(apart - gap + 1, lambda k: q * (1.0 - q) ** (k - 1))
    mean, variance = gap - 1.0 + 1.0 / q, (1.0 - q) / q**2
    deviation = overtook.sum() - PACKETS / mean
    assert_normal(deviation / np.sqrt(PACKETS * variance / mean**3))


def test_overtaking_packet_passes_those_on_their_way():
    """With a delay of three and a half periods it passes three: those not yet there."""
    flow = send(2000, period_s=1.0, delay_s=3.5, reorder={"probability": 0.2, "gap": 9})
    for k in np.flatnonzero(flow.delay_s == 0.0):
        if k < 3:
            continue
        behind = np.flatnonzero(flow.received_s[:k] > flow.received_s[k])
        assert np.array_equal(behind, np.arange(k - 3, k))


def test_reordering_has_the_scenario_correlation():
    """Of neighbours by the chain, without a gap."""
    q, rho = 0.3, 0.5
    flow = send(delay_s=2.5, reorder={"probability": q, "correlation": rho})
    overtook = flow.delay_s == 0.0
    before, after = overtook[:-1], overtook[1:]
    assert_share(after[before], q + rho * (1.0 - q))
    assert_share(after[~before], q * (1.0 - rho))


# second copies and checksums


def test_exact_copies_and_outcomes():
    """A packet is lost, or it is doubled or not, and each copy is corrupted independently."""
    p, d, c = 0.3, 0.25, 0.2
    flow = send(loss=p, duplicate=d, corrupt=c)
    good, corrupt = 1.0 - c, c
    expected = {
        (PacketOutcome.LOST, 0): p,
        (PacketOutcome.CORRUPTED, 0): (1.0 - p) * ((1.0 - d) * corrupt + d * corrupt**2),
        (PacketOutcome.DELIVERED, 1): (1.0 - p) * ((1.0 - d) * good + 2.0 * d * good * corrupt),
        (PacketOutcome.DELIVERED, 2): (1.0 - p) * d * good**2,
    }
    assert_outcomes(flow, expected)


def test_netem_copies_and_outcomes():
    """Of two copies a loss takes one; the second is then asked again, and never doubled."""
    p, d, c = 0.3, 0.25, 0.2
    flow = send(loss=p, duplicate=d, corrupt=c, arithmetic="netem")
    ones, twos = (1.0 - d) * (1.0 - p) + d * p + d * (1.0 - p) * p, d * (1.0 - p) ** 2
    expected = {
        (PacketOutcome.LOST, 0): (1.0 - d) * p,
        (PacketOutcome.CORRUPTED, 0): ones * c + twos * c**2,
        (PacketOutcome.DELIVERED, 1): ones * (1.0 - c) + 2.0 * twos * c * (1.0 - c),
        (PacketOutcome.DELIVERED, 2): twos * (1.0 - c) ** 2,
    }
    assert_outcomes(flow, expected)


def assert_outcomes(flow, expected):
    assert sum(expected.values()) == pytest.approx(1.0)
    counts = [
        np.sum((flow.outcome == outcome) & (flow.copies == copies)) for outcome, copies in expected
    ]
    assert sum(counts) == PACKETS
    assert min(expected.values()) * PACKETS > LEAST
    assert_counts(counts, list(expected.values()))
    assert np.array_equal(~np.isnan(flow.received_s), flow.copies >= 1)
    assert np.array_equal(~np.isnan(flow.second_s), flow.copies == 2)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_two_copies_have_independent_delays(arithmetic):
    """The first of two is the lesser of two independent delays."""
    half = 2.0**29 / 1e9  # s, so that netem's remainders of 2^32 are even
    low, high = 1.0 - half, 1.0 + half
    jitter = {"distribution": "uniform", "spread_s": half}
    flow = send(PACKETS // 2, delay_s=1.0, jitter=jitter, duplicate=1.0, arithmetic=arithmetic)
    assert (flow.copies == 2).all()
    part = (flow.delay_s - low) / (high - low)
    assert_chance(stats.kstest(part, lambda x: 1.0 - (1.0 - x) ** 2).pvalue)
    part = (flow.second_s - flow.sent_s - low) / (high - low)
    assert_chance(stats.kstest(part, lambda x: x**2).pvalue)


@pytest.mark.parametrize("event", ["duplicate", "corrupt"])
def test_events_have_the_scenario_correlation(event):
    p, rho = 0.2, 0.6
    flow = send(**{event: {"probability": p, "correlation": rho}})
    had = flow.copies == (2 if event == "duplicate" else 0)
    assert_share(had[1:][had[:-1]], p + rho * (1.0 - p))
    assert_share(had[1:][~had[:-1]], p * (1.0 - rho))
    assert_normal((had.mean() - p) / np.sqrt(p * (1.0 - p) * (1 + rho) / (1 - rho) / PACKETS))


def test_certain_events_always_occur():
    for arithmetic in ("exact", "netem"):
        assert (send(500, duplicate=1.0, arithmetic=arithmetic).copies == 2).all()
        assert (
            send(500, corrupt=1.0, arithmetic=arithmetic).outcome == PacketOutcome.CORRUPTED
        ).all()
        assert (send(500, delay_s=1.0, reorder=1.0, arithmetic=arithmetic).delay_s == 0.0).all()


def test_fading_loses_all_copies_of_a_packet():
    """And none that was lost before."""
    p, f = 0.2, 0.35
    sent = transmit(
        make(loss=p, duplicate=0.5),
        packets=PACKETS,
        period_s=1.0,
        fading=np.array([[0.0, 0.0]]) + f,
    )
    outcome = sent.outcome[:, 0, 0]
    expected = [(1.0 - p) * (1.0 - f), p, (1.0 - p) * f]
    assert_counts(np.bincount(outcome, minlength=3), expected)
    assert (sent.copies[:, 0, 0][outcome == PacketOutcome.FADED] == 0).all()
    assert_share(sent.copies[:, 0, 0][outcome == PacketOutcome.DELIVERED] == 2, 0.5)


def test_events_of_a_packet_are_independent():
    """Loss, fading, second copy; of each copy corruption, overtaking and delay.

    No event shares a random number with another: the joint distribution is the product.
    """
    loss, fading, twice, corrupt, over = 0.3, 0.2, 0.4, 0.25, 0.45
    keys = {
        # steps of this chain are independent: its losses use both random numbers of a loss
        "loss": {"kind": "gilbert-elliott", "p": 0.5, "r": 0.5, "loss_bad": 2.0 * loss},
        "delay_s": 1.0,
        "jitter": {"distribution": "uniform", "spread_s": 0.5},
    }
    channel = make(duplicate=twice, corrupt=corrupt, reorder=over, **keys)
    run = transmit(channel, packets=PACKETS, period_s=3.0, fading=np.full((1, 2), fading))
    outcome, copies = run.outcome[:, 0, 0], run.copies[:, 0, 0]
    delay = np.stack([run.received_s[:, 0, 0], run.second_s[:, 0, 0]]) - run.sent_s[:, 0]
    good, both = 1.0 - corrupt, twice * (1.0 - corrupt) ** 2
    one = (1.0 - twice) * good + 2.0 * twice * good * corrupt
    delivered = (1.0 - loss) * (1.0 - fading) * np.array([one, both])
    # what each delivered copy did: the first to arrive overtook, unless no copy did
    overtook = (delay == 0.0).sum(axis=0)
    cells = {
        (PacketOutcome.LOST, 0, 0): loss,
        (PacketOutcome.FADED, 0, 0): (1.0 - loss) * fading,
        (PacketOutcome.CORRUPTED, 0, 0): (1.0 - loss) * (1.0 - fading) * (1.0 - one - both),
        (PacketOutcome.DELIVERED, 1, 0): delivered[0] * (1.0 - over),
        (PacketOutcome.DELIVERED, 1, 1): delivered[0] * over,
        (PacketOutcome.DELIVERED, 2, 0): delivered[1] * (1.0 - over) ** 2,
        (PacketOutcome.DELIVERED, 2, 1): delivered[1] * 2.0 * over * (1.0 - over),
        (PacketOutcome.DELIVERED, 2, 2): delivered[1] * over**2,
    }
    seen = [
        np.sum((outcome == why) & (copies == count) & (overtook == k)) for why, count, k in cells
    ]
    assert sum(seen) == PACKETS
    assert_counts(seen, list(cells.values()))
    late = delay[0][(copies == 1) & (overtook == 0)]
    assert_chance(stats.kstest(late, stats.uniform(0.5, 1.0).cdf).pvalue)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_trace_alone_decides_losses(arithmetic):
    """Duplicates and queues after a packet that the trace loses; no loss but the trace's."""
    rate = {"bit_per_s": per_second(100), "queue_packets": 3}
    channel = make(duplicate=1.0, loss=0.5, rate=rate, arithmetic=arithmetic)
    lost = np.arange(200) % 5 == 2
    delay = np.where(lost, np.inf, 0.04)
    run = transmit(channel, packets=200, period_s=0.1, trace_delay_s=delay)
    expected = np.where(lost, PacketOutcome.LOST, PacketOutcome.DELIVERED)
    assert np.array_equal(run.outcome[:, 0, 0], expected)
    assert np.array_equal(run.copies[:, 0, 0], np.where(lost, 0, 2))
