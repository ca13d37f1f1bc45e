"""Loss on a link: shares, correlations and bursts are those of the chain behind them."""

import numpy as np
import pytest
from network_samples import (
    PACKETS,
    assert_chance,
    assert_counts,
    assert_lengths,
    assert_mean,
    assert_normal,
    assert_share,
    make,
    runs,
    send,
)
from reference.channel_simulation import transmit
from scipy.stats import chi2_contingency

from testbed.network.links import PacketOutcome

FORGOTTEN = 1e-3  # a correlation that no sample of this size can tell from none


class Chain:
    """A Markov chain that loses packets: the second route, in matrices.

    Args:
        lost: probability (m, m) of going from one state to another and losing the packet.
        kept: of going there and not losing it.
    """

    def __init__(self, lost, kept):
        self.lost, self.kept = np.array(lost, dtype=float), np.array(kept, dtype=float)
        self.step = self.lost + self.kept
        values, vectors = np.linalg.eig(self.step.T)
        self.at = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
        self.at /= self.at.sum()  # the stationary distribution, a left eigenvector
        self.ones = np.ones(len(self.at))

    @property
    def share(self):
        return self.at @ self.lost @ self.ones

    def variance(self):
        """Of the share among K packets, times K: the sum of all autocovariances."""
        share, size = self.share, len(self.at)
        resolvent = np.linalg.inv(np.eye(size) - self.step + np.outer(self.ones, self.at))
        later = self.at @ self.lost @ resolvent @ self.lost @ self.ones - share**2
        return share * (1.0 - share) + 2.0 * later

    def pair(self, lag):
        """Return the probability (2, 2) of losing a packet, and the one `lag` later."""
        between = np.linalg.matrix_power(self.step, lag - 1)
        kinds = (self.kept, self.lost)
        return np.array([[self.at @ a @ between @ b @ self.ones for b in kinds] for a in kinds])

    def memory(self):
        """Packets until a sample no longer knows what was before."""
        second = np.sort(np.abs(np.linalg.eigvals(self.step)))[-2]
        return forgets(second)

    def run(self, inside, outside):
        """The probability of a run's length, and the runs until one no longer knows another."""
        begin = self.at @ outside @ inside
        begin = begin / begin.sum()
        eye = np.eye(len(begin))
        cycle = np.linalg.solve(eye - inside, outside) @ np.linalg.solve(eye - outside, inside)
        second = np.sort(np.abs(np.linalg.eigvals(cycle)))[-2]

        def probability(lengths):
            at, out = begin, np.empty(len(lengths))
            for k in range(len(lengths)):
                out[k] = at @ outside @ self.ones
                at = at @ inside
            return out

        return probability, forgets(second)


def forgets(factor):
    return 1 if factor < 1e-12 else int(np.ceil(np.log(FORGOTTEN) / np.log(factor)))


def correlated(p, rho):
    """What a two-state chain of this share and lag-1 correlation does."""
    after_none, after_one = p * (1.0 - rho), p + rho * (1.0 - p)
    return Chain(
        [[0.0, after_none], [0.0, after_one]], [[1.0 - after_none, 0.0], [1.0 - after_one, 0.0]]
    )


def gilbert_elliott(p, r, loss_bad=1.0, loss_good=0.0):
    """A packet is lost by the state it finds; then the state changes."""
    step = np.array([[1.0 - p, p], [r, 1.0 - r]])
    loss = np.array([loss_good, loss_bad])[:, None]
    return Chain(loss * step, (1.0 - loss) * step)


def four_state(p13, p31, p32=0.0, p23=1.0, p14=0.0):
    """A packet is lost by the state it brings about, 3 and 4."""
    step = np.array(
        [
            [1.0 - p13 - p14, 0.0, p13, p14],
            [0.0, 1.0 - p23, p23, 0.0],
            [p31, p32, 1.0 - p31 - p32, 0.0],
            [1.0, 0.0, 0.0, 0.0],
        ]
    )
    return Chain(step * [0.0, 0.0, 1.0, 1.0], step * [1.0, 1.0, 0.0, 0.0])


MAKERS = {"bernoulli": correlated, "gilbert-elliott": gilbert_elliott, "four-state": four_state}
CHAINS = {
    "independent": {"kind": "bernoulli", "probability": 0.3},
    "correlated": {"kind": "bernoulli", "probability": 0.2, "correlation": 0.6},
    "sticky": {"kind": "bernoulli", "probability": 0.1, "correlation": 0.9},
    "gilbert": {"kind": "gilbert-elliott", "p": 0.03, "r": 0.25},
    "gilbert-elliott": {
        "kind": "gilbert-elliott",
        "p": 0.1,
        "r": 0.2,
        "loss_bad": 0.8,
        "loss_good": 0.05,
    },
    "bursts": {"kind": "four-state", "p13": 0.05, "p31": 0.3},
    "all four states": {
        "kind": "four-state",
        "p13": 0.06,
        "p31": 0.15,
        "p32": 0.25,
        "p23": 0.4,
        "p14": 0.03,
    },
}


def chain_of(loss):
    args = {key: value for key, value in loss.items() if key != "kind"}
    if loss["kind"] == "bernoulli":
        return correlated(args["probability"], args.get("correlation", 0.0))
    return MAKERS[loss["kind"]](**args)


def models():
    """Every chain; tc netem's chains are the same, its correlation is not."""
    for name, loss in CHAINS.items():
        yield pytest.param((loss, "exact"), id=name)
        if not loss.get("correlation"):
            yield pytest.param((loss, "netem"), id=f"netem {name}")


@pytest.fixture(scope="module", params=models())
def flight(request):
    loss, arithmetic = request.param
    return chain_of(loss), send(loss=loss, arithmetic=arithmetic)


def test_packet_not_lost_arrives_at_once(flight):
    _, flow = flight
    assert np.isin(flow.outcome, (PacketOutcome.DELIVERED, PacketOutcome.LOST)).all()
    assert np.array_equal(np.isnan(flow.received_s), flow.lost)
    assert np.array_equal(flow.received_s[~flow.lost], flow.sent_s[~flow.lost])
    assert np.array_equal(flow.copies, ~flow.lost)


def test_loss_share_is_that_of_the_stationary_chain(flight):
    chain, flow = flight
    assert_normal((flow.lost.mean() - chain.share) / np.sqrt(chain.variance() / PACKETS))


@pytest.mark.parametrize("lag", [1, 2, 3])
def test_near_packets_are_correlated_like_the_chain(flight, lag):
    """Pairs so far apart that they are independent fall into four cells."""
    chain, flow = flight
    first = np.arange(0, PACKETS - lag, lag + chain.memory())
    counts = np.bincount(2 * flow.lost[first] + flow.lost[first + lag], minlength=4)
    assert_counts(counts, chain.pair(lag).ravel())


@pytest.mark.parametrize("lag", [1, 2, 3])
def test_correlation_is_the_power_of_the_lag(lag):
    for name in ("correlated", "sticky"):
        p, rho = CHAINS[name]["probability"], CHAINS[name]["correlation"]
        joint = chain_of(CHAINS[name]).pair(lag)
        assert joint[1, 1] - p**2 == pytest.approx(rho**lag * p * (1.0 - p), rel=1e-9)


def test_burst_lengths_are_those_of_the_chain(flight):
    chain, flow = flight
    probability, apart = chain.run(chain.lost, chain.kept)
    assert_lengths(runs(flow.lost)[0][::apart], probability)


def test_gap_lengths_are_those_of_the_chain(flight):
    chain, flow = flight
    probability, apart = chain.run(chain.kept, chain.lost)
    assert_lengths(runs(flow.lost)[1][::apart], probability)


def test_chain_matrices_agree_with_closed_forms():
    """Shares and burst lengths that the literature writes out."""
    p, r, bad, good = 0.1, 0.2, 0.8, 0.05
    chain = gilbert_elliott(p, r, bad, good)
    assert chain.share == pytest.approx((p * bad + r * good) / (p + r), rel=1e-12)
    lengths = np.arange(1, 60)
    geometric = r * (1.0 - r) ** (lengths - 1)
    simple = gilbert_elliott(p, r)
    assert simple.run(simple.lost, simple.kept)[0](lengths) == pytest.approx(geometric)
    p13, p31, p32, p23, p14 = 0.06, 0.15, 0.25, 0.4, 0.03
    # Salsano, Ludovici, Ordine and Giannuzzi, "Definition of a general and intuitive loss model
    # for packet networks and its implementation in the Netem module in the Linux kernel", 2012
    weight = p13 * p23 + p31 * p23 + p13 * p32 + p14 * p31 * p23
    expected = (p13 * p23 + p14 * p31 * p23) / weight
    assert four_state(p13, p31, p32, p23, p14).share == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_loss_0_and_1_are_exact(arithmetic):
    """Whatever the correlation, in exact; netem's own walks off its certainties."""
    for correlation in (0.0, 0.9) if arithmetic == "exact" else (0.0,):
        for probability in (0.0, 1.0):
            loss = {"probability": probability, "correlation": correlation}
            flow = send(1000, loss=loss, arithmetic=arithmetic)
            assert flow.lost.mean() == probability


def first_packets(loss, packets):
    """Lost or not (packets, links) on 20 x 19 links whose random numbers are independent."""
    names = ["leader", *(f"uav{i}" for i in range(1, 20))]
    sent = transmit(make(names, loss=loss), packets=packets, period_s=0.1)
    apart = ~np.eye(len(names), dtype=bool)[1:]
    return sent.outcome[:, apart] == PacketOutcome.LOST


def test_first_packets_are_lost_as_often_as_all():
    """A correlation changes how losses cluster, not how many there are, from the start."""
    sticky = [{"kind": "bernoulli", "probability": 0.3, "correlation": rho} for rho in (0, 0.99)]
    slow = [
        {"kind": "gilbert-elliott", "p": 0.01, "r": 0.02, "loss_bad": 0.9, "loss_good": 0.1},
        {"kind": "four-state", "p13": 0.02, "p31": 0.01, "p32": 0.03, "p23": 0.02, "p14": 0.1},
    ]
    for loss in (*CHAINS.values(), *sticky, *slow):
        lost = first_packets(loss, 20)
        assert_share(lost[0], chain_of(loss).share)
        assert_share(lost[19], chain_of(loss).share)


@pytest.mark.parametrize(
    "loss",
    [
        {"kind": "gilbert-elliott", "p": 0.01, "r": 0.0},
        {"kind": "four-state", "p13": 0.01, "p31": 0.0},
    ],
    ids=["gilbert-elliott", "four-state"],
)
def test_link_that_fails_for_good_works_at_first(loss):
    lost = first_packets(loss, 2000)
    assert lost[-1].all()
    first_lost = np.argmax(lost, axis=0)  # the first packet lost; all later ones are
    assert all(lost[k:, link].all() for link, k in enumerate(first_lost))
    before = 1 if loss["kind"] == "gilbert-elliott" else 0  # which loses by the state it finds
    lived = first_lost + 1 - before
    bounds = np.array([1, 30, 60, 100, 150, 250])
    cumulative = np.append(1.0 - 0.99 ** (bounds[1:] - 1.0), 1.0)
    counts = np.bincount(np.digitize(lived, bounds[1:]), minlength=len(bounds))
    assert_counts(counts, np.diff(cumulative, prepend=0.0))


def test_losses_of_two_links_are_independent():
    lost = first_packets({"probability": 0.3}, 500)
    for other in (1, 20, 300):
        assert_chance(
            chi2_contingency(
                [
                    [np.sum((lost[:, 0] == a) & (lost[:, other] == b)) for b in (0, 1)]
                    for a in (0, 1)
                ]
            ).pvalue
        )


# tc netem's correlation


def blended_share(p, rho, cells=4096):
    """How often netem's correlated numbers are at most p: the stationary law, found by iteration.

    The next number is (1 - rho) u + rho x with a fresh u, so its distribution is an average of
    that of x over a window; the density starts even and settles by rho each time.
    """
    edges = np.linspace(0.0, 1.0, cells + 1)
    law = edges.copy()
    for _ in range(80):
        # F'(x) = E F((x - (1 - rho) u) / rho), with the integral of F for the mean over u
        whole = np.concatenate([[0.0], np.cumsum(0.5 * (law[1:] + law[:-1])) / cells])
        upper, lower = edges / rho, (edges - (1.0 - rho)) / rho

        def integral(at, whole=whole):
            inside = np.interp(np.clip(at, 0.0, 1.0), edges, whole)
            return inside + np.maximum(at - 1.0, 0.0)

        law = (integral(upper) - integral(lower)) * rho / (1.0 - rho)
    return float(np.interp(p, edges, law))


def test_blend_of_two_halves_has_closed_form():
    """The sum of 2^-k u_k has mean 1/2 and is even about it; blended by nothing u is even."""
    assert blended_share(0.5, 0.5) == pytest.approx(0.5, abs=1e-6)
    assert blended_share(0.3, 0.5) + blended_share(0.7, 0.5) == pytest.approx(1.0, abs=1e-6)
    assert blended_share(0.3, 1e-6) == pytest.approx(0.3, abs=1e-5)
    rng = np.random.default_rng(2)
    sums = rng.random((400_000, 40)) @ 0.5 ** np.arange(1, 41)
    for p in (0.1, 0.3, 0.45):
        assert_share(sums <= p, blended_share(p, 0.5))


@pytest.mark.parametrize(
    ("p", "rho"), [(0.3, 0.5), (0.3, 0.25), (0.1, 0.25), (0.5, 0.5), (0.3, 0.75), (0.45, 0.9)]
)
def test_netem_correlated_loss_is_that_of_its_blend(p, rho):
    flow = send(loss={"probability": p, "correlation": rho}, arithmetic="netem")
    assert_mean(flow.lost, blended_share(p, rho))


def test_netem_30_percent_loss_delivers_87_percent():
    assert 1.0 - blended_share(0.3, 0.5) == pytest.approx(0.87, abs=0.005)
