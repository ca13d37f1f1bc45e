"""Delays have the distribution and the correlation of the scenario, in exact and in netem."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from cases import some
from network_samples import (
    PACKETS,
    assert_chance,
    assert_counts,
    assert_mean,
    assert_normal,
    assert_share,
    make,
    send,
)
from reference.channel_simulation import transmit
from scipy import stats
from scipy.integrate import quad
from scipy.special import ndtri

from testbed.core.errors import InputError
from testbed.network.delays import PARETO_WITH_Z
from testbed.network.links import PacketOutcome

DELAY, SPREAD = 0.1, 0.02
APART = 20  # packets, over which a correlation of a half is down to a millionth
# A delay is the difference of two times of up to 1e5 s.
ROUNDING = 2.0 * np.spacing(float(PACKETS))
MEASURED = np.sort(np.random.default_rng(8).gamma(2.0, 0.015, 257))  # s, of a file
PARETO = 3.0  # its shape


@dataclass
class Law:
    """A distribution of delays: cumulative, its inverses, and its mean and deviation, s."""

    cdf: Any
    ppf: Any
    isf: Any  # of what is above, which keeps its digits far out
    mean: float
    deviation: float

    def score(self, delay):
        """The standard normal number that stands where a delay does."""
        return stats.norm.ppf(np.clip(self.cdf(delay), 1e-16, 1.0 - 1e-16))


def of_scipy(frozen):
    return Law(frozen.cdf, frozen.ppf, frozen.isf, frozen.mean(), frozen.std())


def lognormal():
    """By moments: its mean is m and its variance m² (exp(s²) - 1), with m = exp(mu + s²/2)."""
    s = math.sqrt(math.log(1.0 + (SPREAD / DELAY) ** 2))
    return of_scipy(stats.lognorm(s, scale=DELAY * math.exp(-0.5 * s * s)))


def pareto():
    """Of shape 3 and scale a: mean 3a/2 and variance 3a²/4, from where it is moved."""
    scale = SPREAD / math.sqrt(0.75)
    return of_scipy(stats.pareto(PARETO, loc=DELAY - 1.5 * scale, scale=scale))


def paretonormal():
    """A quarter of a normal and three quarters of iproute2's Pareto that grow together."""
    u = np.concatenate([np.geomspace(1e-12, 1e-4, 2000), np.linspace(1e-4, 1 - 1e-4, 40001)[1:]])
    u = np.append(u, 1.0 - np.geomspace(1e-12, 1e-4, 2000)[::-1][1:])

    def raw(u):
        heavy = (1.0 - u) ** (-1.0 / PARETO) - 1.5
        return 0.25 * ndtri(u) + 0.75 * (4.0 / 3.0) * heavy

    # the integral over u up to 1 - 1e-15: beyond, u^(-2/3) adds 3e-5 of some 0.9
    def square(w):
        return raw(1.0 - w**3) ** 2 * 3.0 * w * w

    deviation = math.sqrt(quad(square, 1e-5, 1.0 - 1e-12, limit=200)[0])
    values = DELAY + SPREAD * raw(u) / deviation
    return Law(
        lambda x: np.interp(x, values, u),
        lambda p: np.interp(p, u, values),
        lambda p: np.interp(1.0 - p, u, values),
        DELAY,
        SPREAD,
    )


def empirical():
    """Straight lines through the sorted sample, added to delay_s."""
    values, p = DELAY + MEASURED, np.linspace(0.0, 1.0, len(MEASURED))
    low, high = values[:-1], values[1:]
    mean = np.mean(0.5 * (low + high))
    variance = np.mean((low**2 + low * high + high**2) / 3.0) - mean**2
    return Law(
        lambda x: np.interp(x, values, p),
        lambda q: np.interp(q, p, values),
        lambda q: np.interp(1.0 - q, p, values),
        mean,
        math.sqrt(variance),
    )


LAWS = {
    "uniform": of_scipy(stats.uniform(DELAY - SPREAD, 2.0 * SPREAD)),
    "normal": of_scipy(stats.norm(DELAY, SPREAD)),
    "lognormal": lognormal(),
    "pareto": pareto(),
    "paretonormal": paretonormal(),
    "empirical": empirical(),
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A file of delays, in no order."""
    path = tmp_path_factory.mktemp("delays") / "delays.csv"
    shuffled = np.random.default_rng(1).permutation(MEASURED)
    path.write_text("delay_s\n" + "\n".join(map(repr, shuffled.tolist())), encoding="utf-8")
    return str(path)


def jitter(distribution, file, correlation=0.0):
    spread = {"file": file} if distribution == "empirical" else {"spread_s": SPREAD}
    return {"distribution": distribution, "correlation": correlation, **spread}


@pytest.fixture(scope="module", params=[(name, rho) for name in LAWS for rho in (0.0, 0.5)])
def flight(request, measured):
    """A law, the correlation of the scenario, that of the normal process behind it, and delays."""
    name, rho = request.param
    keys = {"delay_s": DELAY, "jitter": jitter(name, measured, rho)}
    behind = make(**keys).links[0, 0]["rho"]
    flow = send(**keys)
    assert (flow.outcome == PacketOutcome.DELIVERED).all()
    return name, LAWS[name], rho, behind, flow.delay_s


def test_pareto_covariance_with_normal_is_the_integral():
    """By Stein's lemma the mean of z g(z) is that of g'(z): another integrand."""

    def product(z):
        heavy = stats.norm.sf(z) ** (-1.0 / PARETO)
        return z * (heavy - 1.5) / math.sqrt(0.75) * stats.norm.pdf(z)

    def slope(z):
        return stats.norm.sf(z) ** (-1.0 / PARETO - 1.0) * stats.norm.pdf(z) ** 2 / PARETO

    assert quad(product, -12.0, 12.0)[0] == pytest.approx(PARETO_WITH_Z, rel=1e-14)
    other = quad(slope, -12.0, 12.0, epsrel=1e-12, limit=200)[0] / math.sqrt(0.75)
    assert other == pytest.approx(PARETO_WITH_Z, rel=1e-9)


def test_constant_delay_is_the_same_for_all_packets():
    for arithmetic in ("exact", "netem"):
        flow = send(1000, delay_s=0.125, arithmetic=arithmetic)
        assert np.array_equal(flow.delay_s, np.full(1000, 0.125))
        flow = send(1000, delay_s=0.125, jitter={"correlation": 0.5}, arithmetic=arithmetic)
        assert np.array_equal(flow.delay_s, np.full(1000, 0.125))


def test_delay_has_the_distribution(flight):
    """Kolmogorov and Smirnov's test, of packets that are independent."""
    _, law, rho, _, delay = flight
    sample = delay[:: APART if rho else 1]
    assert_chance(stats.kstest(sample, law.cdf).pvalue)


def test_delay_has_the_distribution_in_cells(flight):
    """As many in each of a hundred parts: tails count here as much as the middle."""
    _, law, rho, _, delay = flight
    sample = delay[:: APART if rho else 1]
    edges = law.ppf(np.arange(1, 100) / 100.0)
    assert_counts(np.bincount(np.searchsorted(edges, sample), minlength=100), np.ones(100))


def test_delay_is_within_its_range(flight):
    name, _, _, _, delay = flight
    low, high = {
        "uniform": (DELAY - SPREAD, DELAY + SPREAD),
        "normal": (0.0, np.inf),
        "lognormal": (0.0, np.inf),
        "pareto": (DELAY - 0.5 * SPREAD / math.sqrt(0.75), np.inf),
        "paretonormal": (0.0, np.inf),
        "empirical": (DELAY + MEASURED[0], DELAY + MEASURED[-1]),
    }[name]
    assert low - ROUNDING <= delay.min()
    assert delay.max() <= high + ROUNDING


@pytest.mark.parametrize("name", LAWS)
def test_law_has_the_scenario_mean_and_deviation(name):
    """Of all but uniform and empirical; of the Pareto laws by integrals of their inverses."""
    law = LAWS[name]
    if name in ("normal", "lognormal", "pareto", "paretonormal"):
        w = np.linspace(0.0, 1.0, 200_002)[1:-1]  # 1 - u = w³, which tames the tail
        x = law.isf(w**3)
        weight = 3.0 * w**2 / len(w)
        assert (weight * x).sum() == pytest.approx(DELAY, abs=2e-3 * SPREAD)
        assert np.sqrt((weight * (x - DELAY) ** 2).sum()) == pytest.approx(SPREAD, rel=5e-3)
    else:
        half = {"uniform": SPREAD / math.sqrt(3.0), "empirical": MEASURED.std()}[name]
        assert law.deviation == pytest.approx(half, rel=0.02)


def test_normal_process_is_autoregressive_of_order_1(flight):
    """Its innovations are independent normals, whatever the distribution of the delays."""
    name, law, _, rho, delay = flight
    z = law.score(delay)
    if name == "empirical":  # rounding of times: the ends of the file are at infinity
        z = np.clip(z, -6.0, 6.0)
    fresh = (z[1:] - rho * z[:-1]) / math.sqrt(1.0 - rho * rho)
    assert_chance(stats.kstest(fresh, "norm").pvalue)
    for known in (z[:-1], np.append(0.0, fresh[:-1])):  # what has no say in what comes next
        assert_normal((fresh * known).sum() / math.sqrt((known**2).sum()))


def test_lag_1_correlation_is_that_of_the_scenario(flight):
    """By Student's test of batches. Pareto's fourth moment is infinite: there, with a cut tail."""
    name, law, wanted, behind, delay = flight
    normed, cap = (delay - law.mean) / law.deviation, np.inf
    if name.startswith("pareto"):
        cap = (float(law.ppf(0.99)) - law.mean) / law.deviation
        normed, wanted = np.minimum(normed, cap), double_integral(law, float(behind), cap)
    assert_mean(normed[1:] * normed[:-1], wanted)


def double_integral(law, rho, cap=np.inf):
    """Mean of g(x) g(y), both of mean 0 and deviation 1, with normals x and y correlated by rho."""
    z = np.linspace(-9.0, 9.0, 1201)
    weight = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) * (z[1] - z[0])
    fine = np.linspace(-13.0, 13.0, 200_001)
    below, above = stats.norm.cdf(fine), stats.norm.sf(fine)
    g = np.where(fine < 0.0, law.ppf(np.minimum(below, 0.5)), law.isf(np.minimum(above, 0.5)))
    g = np.minimum((g - law.mean) / law.deviation, cap)
    first = np.interp(z, fine, g)
    second = np.interp(rho * z[:, None] + math.sqrt(1.0 - rho * rho) * z, fine, g)
    return (weight * first) @ second @ weight


@pytest.mark.parametrize("wanted", some([0.1, 0.5, 0.9], 1))
@pytest.mark.parametrize("name", ["uniform", "normal", "lognormal", "pareto", "empirical"])
def test_rho_gives_delays_their_correlation(name, wanted, measured):
    """A sum over the plane, where the channel uses Hermite polynomials."""
    found = make(delay_s=DELAY, jitter=jitter(name, measured, wanted)).links[0, 0]["rho"]
    # a file has corners, which a sum of 1201 by 1201 points rounds off
    precise = 1e-4 if name == "empirical" else 1e-5
    assert double_integral(LAWS[name], float(found)) == pytest.approx(wanted, abs=precise)


@pytest.mark.parametrize("wanted", [0.05, 0.3, 0.5, 0.8, 0.99])
def test_rho_has_known_values(wanted, measured):
    """A normal law's own; 2 sin(pi c / 6) for a uniform one; a logarithm for a lognormal one."""
    s2 = math.log(1.0 + (SPREAD / DELAY) ** 2)
    known = {
        "normal": wanted,
        "uniform": 2.0 * math.sin(math.pi * wanted / 6.0),
        "lognormal": math.log(1.0 + wanted * math.expm1(s2)) / s2,
    }
    for name, rho in known.items():
        found = make(delay_s=DELAY, jitter=jitter(name, measured, wanted)).links[0, 0]["rho"]
        assert found == pytest.approx(rho, abs=1e-6)


def test_negative_delay_becomes_zero():
    """A normal law of mean and deviation 50 ms is cut at 0, where one packet in six is."""
    law = stats.norm(0.05, 0.05)
    delay = send(delay_s=0.05, jitter={"distribution": "normal", "spread_s": 0.05}).delay_s
    assert delay.min() == 0.0
    assert_share(delay == 0.0, law.cdf(0.0))
    above = delay[delay > 0.0]
    assert_chance(stats.kstest(above, lambda x: (law.cdf(x) - law.cdf(0.0)) / law.sf(0.0)).pvalue)


def test_in_order_packet_waits_for_those_before():
    """The same random numbers with and without: an arrival is the latest of all so far."""
    keys = {"delay_s": DELAY, "period_s": 0.01}
    free = send(jitter={"spread_s": SPREAD, "correlation": 0.3}, **keys)
    kept = send(jitter={"spread_s": SPREAD, "correlation": 0.3, "in_order": True}, **keys)
    assert (np.diff(free.received_s) < 0.0).mean() > 0.1
    assert (np.diff(kept.received_s) >= 0.0).all()
    assert np.array_equal(kept.received_s, np.maximum.accumulate(free.received_s))


def test_in_order_second_copy_waits_too():
    flow = send(
        2000,
        period_s=0.01,
        delay_s=DELAY,
        duplicate=0.5,
        jitter={"spread_s": SPREAD, "in_order": True},
    )
    arrivals = np.column_stack([flow.received_s, flow.second_s]).ravel()
    arrivals = arrivals[~np.isnan(arrivals)]
    assert len(arrivals) > 2500
    assert (np.diff(arrivals) >= 0.0).all()


# tc netem's tabledist


def in_netem(distribution, file, correlation=0.0, **keys):
    return send(
        delay_s=DELAY, jitter=jitter(distribution, file, correlation), arithmetic="netem", **keys
    )


def nanoseconds(delay):
    return np.rint(delay * 1e9).astype(np.int64)


def test_netem_uniform_delay_is_a_remainder(measured):
    """2^32 numbers over twice the spread in ns: the first of them come once more than others."""
    width = round(2e9 * SPREAD)
    whole, rest = divmod(2**32, width)

    def cdf(delay):
        upto = np.clip(np.rint((delay - DELAY + SPREAD) * 1e9) + 1.0, 0.0, width)
        return (whole * upto + np.minimum(upto, rest)) / 2.0**32

    delay = in_netem("uniform", measured).delay_s
    ends = nanoseconds(np.array([delay.min(), delay.max()]))
    assert nanoseconds(DELAY - SPREAD) <= ends[0]
    assert ends[1] <= nanoseconds(DELAY + SPREAD) - 1
    assert_chance(stats.kstest(delay, cdf).pvalue)


def iproute2(name):
    """The 4096 entries of a table as iproute2's programs make them, in 1/8192 of the spread."""
    k = np.arange(4096)
    normal = np.rint(8192 * stats.norm.ppf((k + 0.125) / 4096))
    heavy = np.rint(8192 * 4.0 / 3.0 * ((1.0 - k / 4096) ** (-1.0 / PARETO) - 1.5))
    heavy = np.minimum(heavy, 32767)
    entries = {"normal": normal, "pareto": heavy, "paretonormal": (normal + 3.0 * heavy) / 4.0}
    return np.clip(entries[name], -32768, 32767)


@pytest.mark.parametrize("name", ["normal", "pareto", "paretonormal"])
def test_netem_tables_are_drawn_evenly(name, measured):
    """Every entry is as likely: 4096 divides 2^32."""
    expected = DELAY + SPREAD * iproute2(name) / 8192
    delay = in_netem(name, measured).delay_s
    nearest = np.clip(np.searchsorted(expected, delay), 1, 4095)
    off = np.minimum(abs(expected[nearest] - delay), abs(expected[nearest - 1] - delay))
    assert off.max() < 1.6 * SPREAD / 8192  # a unit, by which iproute2's own search is off
    # cells end in the widest gaps near equal parts, where no rounding moves a delay across
    cuts = [k - 8 + int(np.argmax(np.diff(expected[k - 8 : k + 9]))) for k in range(64, 3968, 64)]
    edges = np.array([0.5 * (expected[k] + expected[k + 1]) for k in cuts])
    counts = np.bincount(np.searchsorted(edges, delay), minlength=len(edges) + 1)
    assert_counts(counts, np.diff([0, *(k + 1 for k in cuts), 4096]))


@pytest.mark.parametrize("name", ["normal", "lognormal", "empirical"])
def test_netem_has_the_scenario_distribution(name, measured):
    """To the width of its tables, of those that iproute2 has no other table for."""
    delay = in_netem(name, measured).delay_s
    edges = LAWS[name].ppf(np.arange(1, 20) / 20.0)
    assert_counts(np.bincount(np.searchsorted(edges, delay), minlength=20), np.ones(20))


@pytest.mark.parametrize("name", ["uniform", "normal"])
def test_netem_remainder_removes_the_correlation(name, measured):
    """Random numbers are correlated; their remainders after division are not."""
    delay = in_netem(name, measured, correlation=0.5).delay_s
    normed = (delay - LAWS[name].mean) / LAWS[name].deviation
    assert_mean(normed[1:] * normed[:-1], 0.0)
    sample = delay[::APART]
    edges = LAWS[name].ppf(np.arange(1, 20) / 20.0)
    assert_counts(np.bincount(np.searchsorted(edges, sample), minlength=20), np.ones(20))


def test_netem_table_of_each_link_is_its_own(tmp_path):
    """Files and tables on several links do not get into another's way."""
    links = {}
    for k, (receiver, low) in enumerate((("uav1", 0.2), ("uav2", 0.4), ("uav3", 0.6))):
        path = tmp_path / f"{receiver}.csv"
        path.write_text(f"delay_s\n{low}\n{low + 0.1}\n", encoding="utf-8")
        empirical = {"distribution": "empirical", "file": str(path)}
        links[receiver] = {"jitter": empirical, "arithmetic": ("exact", "netem")[k % 2]}
    normal = {"delay_s": 1.0, "jitter": {"spread_s": 0.01}, "arithmetic": "netem"}
    names = ("leader", "uav1", "uav2", "uav3")
    channel = make(names, links={"leader": links, "uav1": {"*": normal}})
    sent = transmit(channel, packets=500, period_s=1.0)
    delay = sent.received_s - sent.sent_s[:, None, :]
    for i, low in enumerate((0.2, 0.4, 0.6)):
        assert low - 1e-4 <= delay[:, i, 0].min() < low + 0.01
        assert low + 0.09 < delay[:, i, 0].max() <= low + 0.1 + 1e-4
    assert delay[:, 1:, 1].mean() == pytest.approx(1.0, abs=0.005)


def test_netem_has_32_bits_for_a_jitter():
    """In ns; its random numbers have 32 too, so a wider one would reach no further than 4.3 s."""
    keys = {"delay_s": 10.0, "arithmetic": "netem"}
    delay = send(jitter={"spread_s": 5.0}, **keys).delay_s
    longest = 0x7FFFFFFF / 1e9
    assert_chance(stats.kstest(delay, stats.uniform(10.0 - longest, 2.0 * longest).cdf).pvalue)


def test_negative_empirical_delay_is_refused(tmp_path):
    path = tmp_path / "delays.csv"
    path.write_text("delay_s\n0.1\n-0.3\n0.2\n", encoding="utf-8")
    jitter = {"distribution": "empirical", "file": str(path)}
    with pytest.raises(InputError) as caught:
        make(delay_s=0.2, jitter=jitter)
    assert str(caught.value).startswith(
        f"{path}:3: delay_s -0.3 s plus the scenario's 0.2 s is neg"
    )
    make(delay_s=0.3, jitter=jitter)
