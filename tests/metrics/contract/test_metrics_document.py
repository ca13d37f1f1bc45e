"""metrics.json and its tables: the keys that others rely on, and the text on a terminal."""

import io
import json
import math
import re
import statistics
from typing import get_type_hints

import pytest
import record_flight
from cases import some
from record_flight import event, run_samples
from rich.console import Console
from snapshot import check_snapshot

from testbed.metrics.document import finalise, to_json
from testbed.metrics.document_check import check_metrics
from testbed.metrics.facts import (
    describe_arduplanes,
    describe_commands,
    describe_mavlink,
    describe_network,
    describe_pace,
    facts,
)
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.metrics.model import (
    EstimateErrorMetrics,
    Metrics,
    RingingMetrics,
    SaturationCounts,
    WindMetrics,
    WindowMetrics,
)
from testbed.metrics.observer import MetricsObserver
from testbed.metrics.printed_tables import render_table

PUBLISHED = {
    "source": "[HBH23] Table 1, Simulation 3",
    "rms_m": {"first": [1.3, 1.4, 1.5]},
    "mean_rms_m": {"first": 1.4},
    "percent_error": {"first": 18},
}
WIDTHS = (60, 80, 120)


def run_info(followers=3, **changes):
    return record_flight.run_info(followers, **{"kappa_mps": (3.6,) * followers, **changes})


def link(sent=0, delivered=0, **more):
    """Statistics of a link, or of several: by default nothing was sent."""
    nothing = {"count": 0, "mean": None, "longest": 0, "lengths": {}}
    return {
        "sent": sent,
        "delivered": delivered,
        "delivered_share": delivered / sent if sent else None,
        "lost": {},
        "muted": 0,
        "duplicated": 0,
        "overtaken": 0,
        "delay_s": None,
        "bursts": nothing,
        "age_s": None,
    } | more


def age(mean, largest, uses):
    return {"mean": mean, "max": largest, "p50": mean, "p95": largest, "uses": uses}


NO_MESSAGES = {"links": {}, "all": link()}


def document(
    followers=3,
    *,
    published=None,
    outcome="completed",
    network=NO_MESSAGES,
    noisy_from=None,
    lost_from=None,
    **changes,
):
    meter = MetricsObserver(published=published)
    meter.begin(run_info(followers, **changes))
    gusts = [event(k, f"gust {k}") for k in range(9)]
    for sample in run_samples(
        80, followers, noisy_from=noisy_from, lost_from=lost_from, events=gusts
    ):
        meter.observe(sample)
    return finalise(meter.summary(), network=network, external={}, outcome=outcome, wall_s=2.0)


def printed(metrics, width=80):
    console = Console(file=io.StringIO(), width=width)
    render_table(metrics, console, log="logs/synthetic/20260101T000000Z-0000/run.mcap")
    return console.file.getvalue()


def first_rows(text):
    """The first line that begins with each word, in words."""
    lines = [line.split() for line in text.splitlines() if line.strip()]
    return {words[0]: words for words in reversed(lines)}


def test_document_has_the_declared_keys():
    metrics = json.loads(to_json(document()))
    check_metrics(metrics, run_info(), "here")
    pairs = [
        (Metrics, metrics),
        (WindowMetrics, metrics["windows"]["first"]),
        (WindMetrics, metrics["wind"]["leader"]),
        (EstimateErrorMetrics, metrics["estimate_error"]["leader"]),
        (SaturationCounts, metrics["saturations"]["uav1"]),
        (RingingMetrics, metrics["ringing"]["uav1"]),
    ]
    for kind, values in pairs:
        assert values.keys() <= get_type_hints(kind).keys(), kind


def test_document_has_the_documented_keys():
    metrics = json.loads(to_json(document()))
    check_snapshot("metrics_keys", "\n".join([*metrics, "", *flatten_metrics(metrics)]))
    assert metrics["simulated_s"] == 79 / 25
    assert metrics["real_time_factor"] == metrics["simulated_s"] / 2.0


def test_document_refuses_unknown_outcome_and_nan():
    with pytest.raises(ValueError, match="'landed' is none of completed, lost"):
        document(outcome="landed")
    with pytest.raises(ValueError, match="JSON"):
        to_json({"rms_m": math.nan})


@pytest.mark.parametrize("width", WIDTHS)
def test_follower_tables_have_unique_columns(width):
    """Each number has a heading of its own, which names it."""
    lines = printed(document(), width).splitlines()
    for first, last in ("limiter", "follower"), ("command", "saturated"):
        [k] = [k for k, line in enumerate(lines[:-1]) if first in line and last in lines[k + 1]]
        above, below = (re.split(r"  +", line.strip()) for line in lines[k : k + 2])
        columns = zip(above[-len(below) + 1 :], below[1:], strict=True)
        assert len(set(columns)) == len(below) - 1 >= 3


@pytest.mark.parametrize("width", WIDTHS)
def test_ringing_table_is_there_if_a_bank_rings(width):
    metrics = document()
    assert "ringing" not in printed(metrics, width)
    never = dict.fromkeys(metrics["ringing"]["uav1"])
    metrics["ringing"] = {
        "uav1": {"seconds": 3.96, "last_s": 534.16, "period_s": 0.99, "damping_ratio": 0.074},
        "uav2": {**never, "seconds": 0.0},
        "uav3": never,
    }
    lines = [line.split() for line in printed(metrics, width).splitlines()]
    start = lines.index(["bank", "any", "last", "period", "damping"])
    assert lines[start + 1] == ["ringing", "s", "at,", "s", "s", "ratio"]
    assert lines[start + 3 : start + 6] == [
        ["uav1", "4.0", "534.2", "0.99", "0.07"],
        ["uav2", "0", "–", "–", "–"],
        ["uav3", "–", "–", "–", "–"],
    ]


@pytest.mark.parametrize("width", WIDTHS)
def test_long_events_have_a_hanging_indent(width):
    """No line is cut; the lines after the first are indented; a number keeps its unit."""
    metrics = document(1)
    text = "left its slot and is 12.5 m away after a turn of 47.3° at 23.4 m/s for some 8.1 s"
    metrics["events"] = [
        {"time_s": 7.5, "level": "warning", "source": "uav1", "text": f"{text}; {text} (62.0 m)"}
    ]
    lines = printed(metrics, width).splitlines()
    [start] = [k for k, line in enumerate(lines) if line.startswith(" warning")]
    rest = lines[start + 1 : -1]
    assert lines[start].startswith(" warning      7.50 s  uav1: left its slot")
    assert rest and all(line.startswith("    ") for line in rest)
    assert all(len(line) <= width for line in lines[start:-1])
    assert not any(re.match(r" +(m|m/s|s)\b", line) for line in rest)


@pytest.mark.parametrize("width", WIDTHS[:2])
def test_tables_of_a_run_are_as_in_the_snapshot(width):
    """A run with published numbers, erring estimates, a lost aircraft and many events."""
    metrics = document(published=PUBLISHED, noisy_from=0, lost_from=50, outcome="lost")
    check_snapshot(f"metrics_table_{width}", printed(metrics, width))


def test_error_table_has_our_and_published_numbers():
    metrics = document(published=PUBLISHED)
    row = first_rows(printed(metrics))["uav2"]
    ours, other = (metrics["windows"][name]["rms_m"]["uav2"] for name in ("first", "second"))
    assert row == ["uav2", f"{ours:.2f}", "1.4", f"{ours / 1.4:.2f}", f"{other:.2f}"]


def test_error_table_compares_only_complete_windows():
    both = {"source": "elsewhere", "mean_rms_m": {"first": 1.0, "second": 1.0}}
    metrics = document(published=both)  # 3.16 s, of 2 to 4 s for the second
    rows = first_rows(printed(metrics))
    ours, other = (metrics["windows"][name]["mean_rms_m"] for name in ("first", "second"))
    assert rows["mean"] == ["mean", f"{ours:.2f}", "1", f"{ours:.2f}", f"{other:.2f}"]
    assert rows["covered,"] == ["covered,", "s", "all", "2–3.16"]
    nothing = printed(document(published=both, windows={"second": (2.0, 4.0)}))
    assert not {"elsewhere;", "elsewhere", "paper", "ratio"} & set(nothing.split())
    never = first_rows(printed(document(published=both, windows={"second": (8.0, 9.0)})))
    assert never["covered,"] == ["covered,", "s", "none"]


def test_error_table_omits_windows_of_lost_aircraft():
    theirs = {"source": "x", "rms_m": {"first": [1.0] * 3}, "mean_rms_m": {"first": 1.0}}
    rows = first_rows(printed(document(published=theirs, lost_from=40, windows={"first": (1, 2)})))
    beside = [rows[name][2:] for name in ("uav1", "uav2", "uav3", "mean")]
    assert [each == ["–", "–"] for each in beside] == [False, False, True, True]


KINDS = (None, None), (None, 0), (PUBLISHED, None), (PUBLISHED, 0)


@pytest.mark.parametrize("followers", [0, 1, 3, 30])
@pytest.mark.parametrize(("published", "noisy_from"), some(KINDS, 2))
def test_tables_fit_the_width_and_cut_no_word(followers, published, noisy_from):
    more = {"published": published, "noisy_from": noisy_from, "lost_from": noisy_from}
    names = {f"p{i}": (0.5 * i, 0.5 * i + 1.0) for i in range(7)}
    for windows in some(({}, {"first": (1.0, 2.0)}, names, {"never": (90.0, 95.0)}), 2):
        metrics = document(followers, windows=windows, **more)
        for width in WIDTHS:
            lines = printed(metrics, width).splitlines()
            assert "…" not in "".join(lines).replace("… and 3 more", "")
            assert max(len(line) for line in lines if "run.mcap" not in line) <= width


def test_error_table_of_many_followers_has_the_median():
    metrics = document(30)
    windows = metrics["windows"]
    middle = [statistics.median(windows[name]["rms_m"].values()) for name in ("first", "second")]
    assert first_rows(printed(metrics))["median"][1:] == [f"{each:.2f}" for each in middle]
    assert "median" not in printed(document(12))


def test_exact_estimates_and_no_loss_have_no_lines():
    text = printed(document())
    assert "estimate" not in text
    assert "lost" not in dict(facts(document()))


def test_error_table_has_the_error_from_the_estimates():
    metrics = document(noisy_from=0)
    [row] = [line.split() for line in printed(metrics).splitlines() if "mean estimated" in line]
    means = [metrics["windows"][name]["estimated_mean_rms_m"] for name in ("first", "second")]
    assert row == ["mean", "estimated", *(f"{mean:.2f}" for mean in means)]
    errors = [numbers["horizontal_m"] for numbers in metrics["estimate_error"].values()]
    together = math.sqrt(sum(each**2 for each in errors) / len(errors))
    assert f"horizontal {together:.2f} m, " in dict(facts(metrics))["estimate error, RMS"]


def test_lost_aircraft_are_named_in_order_of_time():
    metrics = document(lost_from=50)
    assert metrics["lost_at_s"]["uav3"] == 2.0
    metrics["lost_at_s"] |= {"leader": 1.04, "uav3": 61.25}
    assert str(dict(facts(metrics))["lost"]).startswith("leader at 1.0 s, uav3 at 61.2 s;")
    many = document(30)
    many["lost_at_s"] = {name: 0.1 * k for k, name in enumerate(many["lost_at_s"])}
    assert "uav11 at 1.1 s, 19 more;" in str(dict(facts(many))["lost"])


def test_kappa_line_names_the_smallest_margin():
    metrics = document(kappa_mps=(3.6, 3.6, 9.0))
    # uav3 keeps more than uav2, but least of what the scenario assumes of it
    metrics |= {"kappa_mps": {"uav1": None, "uav2": 3.5, "uav3": 4.0}}
    metrics |= {"kappa_at_s": {"uav1": None, "uav2": 1.0, "uav3": 12.34}}
    assert str(dict(facts(metrics))["kappa measured"]) == "4.00 m/s, uav3 at 12.3 s; assumed 9"


def test_speed_set_line_names_first_follower_to_leave():
    metrics = document()
    left = {name: {"times": 0, "first_s": None} for name in metrics["limiter_flags"]}
    metrics["left_speed_set"] = left
    assert "left the speed set" not in dict(facts(metrics))
    left["uav2"] = {"times": 3, "first_s": 4.0}
    assert str(dict(facts(metrics))["left the speed set"]) == "uav2 at 4.0 s, 3 times"
    left["uav3"] = {"times": 1, "first_s": 2.0}
    assert str(dict(facts(metrics))["left the speed set"]) == "uav3 at 2.0 s, 1 time; 1 more"


def test_age_of_information_is_over_all_uses():
    # uav1 used 10 messages of the leader, 0.1 s old in the mean, and 30 of uav2, 0.3 s old
    links = {
        "leader": {"uav1": link(age_s=age(0.1, 0.4, 10)), "uav2": link(age_s=age(0.2, 0.2, 5))},
        "uav1": {"uav2": link()},
        "uav2": {"uav1": link(age_s=age(0.3, 0.35, 30))},
    }
    ages = document(2, network={"links": links, "all": link()})["age_of_information_s"]
    assert ages["uav1"] == {"mean": pytest.approx(0.25, rel=1e-15), "max": 0.4}
    assert ages["uav2"] == {"mean": 0.2, "max": 0.2}
    nothing_received = document(1)["age_of_information_s"]
    assert nothing_received == {"uav1": {"mean": None, "max": None}}


def delay(p50, p95):
    return {"mean": p50, "min": p50, "max": p95, "p50": p50, "p95": p95, "p99": p95}


def bursts(count, mean, longest):
    return {"count": count, "mean": mean, "longest": longest, "lengths": {}}


NETWORKS = {
    "perfect": link(300, 300, delay_s=delay(0.0, 1e-12)),
    "late": link(300, 300, delay_s=delay(0.1, 0.1 + 1e-12)),
    "jitter": link(300, 300, delay_s=delay(0.0804, 0.1916)),
    "overtaken": link(300, 300, delay_s=delay(0.0, 0.0), overtaken=1200, duplicated=3),
    "bursts": link(
        324_000,
        225_921,
        lost={"lost": 96_876, "blackout": 1_203},
        bursts=bursts(7000, 1.43, 11),
        delay_s=delay(0.1, 0.1),
    ),
    "seldom": link(99_000, 98_997, lost={"listed": 3}, bursts=bursts(3, 1.0, 1), muted=10),
    "everything": link(
        300_000,
        210_000,
        lost={"lost": 90_000},
        muted=100,
        overtaken=37_297,
        duplicated=2_795,
        bursts=bursts(64_000, 1.40625, 11),
        delay_s=delay(0.115, 0.245),
    ),
}


def test_network_lines_are_as_in_the_snapshot():
    assert describe_network(None) == []
    lines = []
    links = {"leader": {"uav1": link(1000, 700), "uav2": link(1000, 698)}}
    for name, total in NETWORKS.items():
        lines += [f"{name}:", *describe_network({"links": links, "all": total})]
    check_snapshot("metrics_network", "\n".join(lines))


def test_external_program_lines_match_snapshot():
    late = {"mean": 0.0012, "p99": 0.0051, "max": 0.0117}
    traffic = {"frames_sent": 9, "frames_received": 4, "clients": ["255.190"]}
    rejected = {"forged": 1, "replayed": 1, "unsigned": 3}
    texts = [
        describe_pace({"requested": 1.0, "achieved": 0.998, "late_s": late}),
        describe_pace({"requested": 2.0, "achieved": None, "late_s": late}),
        describe_mavlink(traffic | {"rejected": {}}),
        describe_mavlink(traffic | {"clients": [], "rejected": rejected}),
        describe_arduplanes({"uav1": "4.7.1", "uav2": "4.6.0", "uav3": "4.7.1"}),
        describe_commands({"leader": {"airspeeds": 2}, "uav1": {"modes": 1, "parameters": 1}}),
    ]
    check_snapshot("metrics_external", "\n\n".join(map(str, texts)))


def test_tables_without_a_terminal_have_no_colours():
    assert "\x1b" not in printed(document(published=PUBLISHED))


def test_tables_of_an_unfinished_run_can_be_printed():
    meter = MetricsObserver()
    meter.begin(run_info())
    text = printed(meter.summary())
    assert "in flight" in text
    assert "never" in text
