"""The compiled channel does what the readable one does, on random links for a hundred rounds.

TESTBED_PACKETS makes it 250 of them.
"""

import os

import numpy as np
import pytest

from testbed.network.channel import make_channel
from testbed.network.fates import fates
from testbed.network.links import Fate
from testbed.network.traffic import idle
from testbed.scenario.network import Network

twin = pytest.importorskip("testbed.network.fates_twin", exc_type=ImportError)

NAMES = ("leader", "uav1", "uav2", "uav3", "uav4")
N = len(NAMES)
ROUNDS = 250 if "TESTBED_PACKETS" in os.environ else 120
PERIOD = 0.1
# The two take logarithms and the like from other libraries: 1e-16, which the quantile of Pareto's
# law and an hour of flight magnify. The page's times are of the order of a second.
TOLERANCE = 1e-9


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("delays"), np.random.default_rng(9)
    paths = [folder / f"delays{k}.csv" for k in range(2)]
    for path in paths:
        samples = "\n".join(map(repr, rng.gamma(2.0, 0.03, 50).tolist()))
        path.write_text(f"delay_s\n{samples}\n", encoding="utf-8")
    return [str(path) for path in paths]


def random_link(rng, files):
    """A link with some of everything."""

    def probability():
        return float(rng.choice([0.0, 1.0, *rng.uniform(0.0, 0.5, 6)]))

    def event():
        return {"probability": probability(), "correlation": float(rng.choice([0.0, 0.5, 0.95]))}

    def one_of(*choices):
        return choices[rng.integers(len(choices))]

    kind = one_of("uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical")
    jitter = {"distribution": kind, "correlation": float(rng.choice([0.0, 0.3, 0.8]))}
    jitter |= {"file": one_of(*files)} if kind == "empirical" else {"spread_s": rng.uniform(0, 0.1)}
    jitter["in_order"] = bool(rng.random() < 0.3)
    low = rng.uniform(0.02, 0.2)
    every = one_of(low, [low, low + rng.uniform(0.0, 0.2)])
    knobs = {
        "delay_s": rng.uniform(0.1, 0.4),
        "jitter": jitter,
        "loss": one_of(
            event(),
            {
                "kind": "gilbert-elliott",
                **dict(zip(("p", "r", "loss_bad", "loss_good"), rng.random(4), strict=True)),
            },
            {
                "kind": "four-state",
                **dict(zip(("p13", "p31", "p32", "p23", "p14"), rng.random(5) / 2, strict=True)),
            },
        ),
        "duplicate": event(),
        "corrupt": event(),
        "reorder": {**event(), "gap": int(rng.integers(1, 5))},
        "rate": {
            "bit_per_s": rng.uniform(4000, 20000),
            "queue_packets": int(rng.integers(1, 8)),
        },
        "slots": {
            "every_s": every,
            "first_s": rng.uniform(0.0, 0.5),
            "packets": int(rng.integers(1, 3)),
            "queue_packets": int(rng.integers(1, 8)),
        },
        "arithmetic": one_of("exact", "netem"),
    }
    kept = [key for key in knobs if key in ("delay_s", "arithmetic") or rng.random() < 0.6]
    return {key: knobs[key] for key in kept}


def random_channel(rng, files, *, heeded=None, **common):
    links = {
        sender: {receiver: random_link(rng, files) for receiver in NAMES[1:] if receiver != sender}
        for sender in NAMES
    }
    if "tdma" in common:
        for receivers in links.values():
            for link in receivers.values():
                link.pop("slots", None)
    network = Network.model_validate({"links": links, **common})
    return make_channel(NAMES, network, int(rng.integers(1000)), heeded)


def rounds(rng, told):
    """Who sends what when, with scripts, traces and fading: arguments of `fates`."""
    numbers, clock = np.zeros(N, dtype=np.int64), rng.uniform(0.0, PERIOD, N)
    traced = rng.random((N - 1, N)) < (0.3 if told else 0.0)
    fading = rng.random((N - 1, N)) * rng.integers(0, 2, (N - 1, N))
    for _ in range(ROUNDS):
        rows = np.flatnonzero(rng.random(N) < 0.8)
        shape = (N - 1, len(rows))
        said = rng.choice([int(Fate.BLACKOUT), int(Fate.LISTED), int(Fate.MUTE)], shape)
        script = np.where(rng.random(shape) < 0.1, said, 0).astype(np.uint8)
        replayed = np.where(rng.random(shape) < 0.3, np.inf, rng.uniform(0.0, 0.5, shape))
        replayed = np.where(traced[:, rows], replayed, np.nan)
        yield rows, numbers[rows].copy(), clock[rows].copy(), script, replayed, fading[:, rows]
        numbers[rows] += 1
        clock += PERIOD * rng.uniform(0.5, 1.5, N)


def compare(channel, rng, told=True):
    """Fly both; returns how often each fate came about."""
    each = {fates: idle(channel), twin.fates: idle(channel)}
    became = {of: [] for of in each}  # arrivals, fates and states after each round
    for sending in rounds(rng, told):
        for of, traffic in each.items():
            became[of].append((*of(channel, traffic, *sending), traffic.state.copy()))
    (arrivals, fate, state), (their_arrivals, their_fate, their_state) = (
        (np.concatenate(came, 1), np.concatenate(what, 1), np.array(states))
        for came, what, states in (zip(*found, strict=True) for found in became.values())
    )
    assert their_fate.dtype == fate.dtype
    np.testing.assert_array_equal(their_fate, fate)
    np.testing.assert_allclose(their_arrivals, arrivals, rtol=0.0, atol=TOLERANCE)
    for name in state.dtype.names:
        mine, its = state[name], their_state[name]
        if mine.dtype.kind == "f":
            np.testing.assert_allclose(its, mine, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name)
        else:
            np.testing.assert_array_equal(its, mine, err_msg=name)
    ours, theirs = each.values()
    np.testing.assert_allclose(theirs.ring, ours.ring, rtol=0.0, atol=TOLERANCE)
    return np.bincount(fate.ravel(), minlength=len(Fate))


@pytest.mark.parametrize("case", range(6))
def test_random_links(case, files):
    rng = np.random.default_rng([50, case])
    seen = compare(random_channel(rng, files), rng)
    for fate in (Fate.DELIVERED, Fate.LOST, Fate.FADED, Fate.CORRUPTED, Fate.QUEUE, Fate.MUTE):
        assert seen[fate] > 20, fate


@pytest.mark.parametrize("case", range(2))
def test_links_that_nobody_listens_to(case, files):
    rng = np.random.default_rng([55, case])
    heeded = rng.random((N - 1, N)) < 0.6
    seen = compare(random_channel(rng, files, heeded=heeded), rng)
    assert min(seen[Fate.UNHEARD], seen[Fate.DELIVERED]) > 100


@pytest.mark.parametrize("case", range(2))
def test_turns_in_a_frame(case, files):
    rng = np.random.default_rng([60, case])
    tdma = {"frame_s": 0.15, "packets": case + 1, "queue_packets": 3}
    seen = compare(random_channel(rng, files, tdma=tdma), rng, told=False)
    assert seen[Fate.DELIVERED] > 500
    assert seen[Fate.QUEUE] > 20


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
@pytest.mark.parametrize(
    "distribution", ["uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical"]
)
def test_every_distribution(distribution, arithmetic, files):
    spread = {"file": files[0]} if distribution == "empirical" else {"spread_s": 0.02}
    jitter = {"distribution": distribution, "correlation": 0.5, **spread}
    network = Network.model_validate(
        {"delay_s": 0.1, "jitter": jitter, "arithmetic": arithmetic, "duplicate": 0.2}
    )
    rng = np.random.default_rng(70)
    assert compare(make_channel(NAMES, network, 3), rng, told=False)[Fate.DELIVERED] > 500


def test_a_trace_outlives_what_it_lost():
    """A loss of the trace keeps nothing that comes after it from arriving, in any arithmetic."""
    for arithmetic in ("exact", "netem"):
        network = Network.model_validate(
            {
                "duplicate": 1.0,
                "rate": {"bit_per_s": 80_000, "queue_packets": 3},
                "arithmetic": arithmetic,
            }
        )
        channel = make_channel(("leader", "uav1"), network, 1)
        for of in (fates, twin.fates):
            traffic = idle(channel)
            for k in range(20):
                lost = k % 5 == 2
                told = np.array([[np.inf if lost else 0.04]])
                arrivals, fate = of(
                    channel,
                    traffic,
                    np.array([0]),
                    np.array([k]),
                    np.array([0.1 * k]),
                    np.zeros((1, 1), np.uint8),
                    told,
                    np.zeros((1, 1)),
                )
                assert fate[0, 0] == (Fate.LOST if lost else Fate.DELIVERED)
                assert np.isfinite(arrivals[0, 0]).sum() == (0 if lost else 2)
