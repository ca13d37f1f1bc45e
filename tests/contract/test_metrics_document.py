"""metrics.json and the table: the keys others rely on, and what people see."""

import io
import json
import math
import os
import statistics

import pytest
import record_flight
from record_flight import event, run_frames
from rich.console import Console

from testbed.errors import InputError
from testbed.metrics import MetricsObserver
from testbed.metrics.document import complete, to_json, write_json
from testbed.metrics.table import render_table

PUBLISHED = {
    "source": "[HBH23] Table 1, Simulation 3",
    "rms_m": {"first": [1.3, 1.4, 1.5]},
    "mean_rms_m": {"first": 1.4},
    "percent_error": {"first": 18},
}


def run_info(followers=3, **changes):
    return record_flight.run_info(followers, **{"kappa_mps": (3.6,) * followers, **changes})


def link(sent=0, delivered=0, **more):
    """The numbers of a link, or of several, over which nothing was said unless told."""
    nothing = {"count": 0, "mean": None, "longest": 0, "lengths": {}}
    return {
        "sent": sent,
        "delivered": delivered,
        "delivered_share": delivered / sent if sent else None,
        "lost": {},
        "mute": 0,
        "duplicated": 0,
        "overtaken": 0,
        "delay_s": None,
        "bursts": nothing,
        "age_s": None,
    } | more


def age(mean, most, uses):
    return {"mean": mean, "max": most, "p50": mean, "p95": most, "uses": uses}


QUIET = {"links": {}, "all": link()}


def document(
    followers=3,
    *,
    published=None,
    outcome="flown",
    network=QUIET,
    noisy_from=None,
    gone_from=None,
    **changes,
):
    meter = MetricsObserver(published=published)
    meter.begin(run_info(followers, **changes))
    gusts = [event(k, f"gust {k}") for k in range(9)]
    seen = run_frames(80, followers, noisy_from=noisy_from, gone_from=gone_from, events=gusts)
    for frame in seen:
        meter.observe(frame)
    return complete(meter.summary(), network=network, outside={}, outcome=outcome, wall_s=2.0)


def shown(metrics, width=80):
    console = Console(file=io.StringIO(), width=width)
    render_table(metrics, console, log="logs/synthetic/20260101T000000Z-0000/run.mcap")
    return console.file.getvalue()


def test_the_document_has_the_promised_keys():
    metrics = json.loads(to_json(document()))
    portion = metrics["portions"]["first"]
    assert list(portion["rms_m"]) == ["uav1", "uav2", "uav3"]
    assert {"mean_rms_m", "percent_error"} <= set(portion)
    promised = {"min_separation_m", "engaged_at_s", "simulated_s", "wall_s", "real_time_factor"}
    promised |= {"leader_bank_deg", "outcome", "schema", "scenario", "seed", "versions", "guards"}
    promised |= {"kappa_mps", "kappa_at_s", "kappa_assumed_mps", "slot_speed_mps"}
    promised |= {"saturations", "published", "events", "left_speed_set"}
    promised |= {"estimate_error", "relative_position_m", "lost_at_s"}
    assert promised | {"network", "age_of_information_s"} <= set(metrics)
    assert {"kappa_mps", "slot_speed_mps"} <= set(portion)
    assert {"believed_rms_m", "believed_mean_rms_m"} <= set(portion)
    off = {"horizontal_m", "height_m", "velocity_mps", "tilt_deg", "heading_deg", "airspeed_mps"}
    assert set(metrics["estimate_error"]["leader"]) == off | {"largest_horizontal_m"}
    assert list(metrics["relative_position_m"]) == ["uav1", "uav2", "uav3"]
    assert list(metrics["lost_at_s"]) == ["leader", "uav1", "uav2", "uav3"]
    assert metrics["simulated_s"] == 79 / 25
    assert metrics["real_time_factor"] == metrics["simulated_s"] / 2.0


def test_the_text_is_the_same_for_the_same_run():
    assert to_json(document()) == to_json(document())


def test_a_document_with_an_unknown_outcome_or_no_number_is_refused():
    with pytest.raises(ValueError, match="'landed' is none of flown, lost"):
        document(outcome="landed")
    with pytest.raises(ValueError, match="JSON"):
        to_json({"rms_m": math.nan})


def test_writing_replaces_the_file_in_one_move(tmp_path, monkeypatch):
    path = tmp_path / "metrics.json"
    write_json(path, {"a": 1})
    path.chmod(0o444)
    write_json(path, {"a": "ç"})
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": "ç"}

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=r"metrics\.json: cannot write .* No space left"):
        write_json(path, {"a": 3})
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": "ç"}
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_is_as_public_as_others(tmp_path):
    other = tmp_path / "other"
    other.touch()
    write_json(tmp_path / "metrics.json", {})
    assert (tmp_path / "metrics.json").stat().st_mode == other.stat().st_mode


def test_the_table_shows_ours_beside_the_published():
    metrics = document(published=PUBLISHED)
    text = shown(metrics)
    ours = metrics["portions"]["first"]["rms_m"]["uav2"]
    [row] = [line.split() for line in text.splitlines() if line.startswith(" uav2 ")][:1]
    other = metrics["portions"]["second"]["rms_m"]["uav2"]
    assert row == ["uav2", f"{ours:.2f}", "1.4", f"{ours / 1.4:.2f}", f"{other:.2f}"]
    assert "[HBH23] Table 1, Simulation 3" in text
    assert "flown · 3 s simulated in 2.0 s (1.6 × real time) · seed 7" in text
    assert "gust 5" in text
    assert "gust 6" not in text
    assert "… and 3 more in the log" in text
    assert "logs/synthetic/20260101T000000Z-0000/run.mcap" in text


def first_rows(text):
    """The first line that begins with each word, in words."""
    lines = [line.split() for line in text.splitlines() if line.strip()]
    return {words[0]: words for words in reversed(lines)}


def test_only_windows_flown_to_their_end_are_held_against_published_numbers():
    both = {"source": "elsewhere", "mean_rms_m": {"first": 1.0, "second": 1.0}}
    metrics = document(published=both)  # 3.16 s, of 2 to 4 s for the second
    rows = first_rows(shown(metrics))
    ours, other = (metrics["portions"][name]["mean_rms_m"] for name in ("first", "second"))
    assert rows["mean"] == ["mean", f"{ours:.2f}", "1", f"{ours:.2f}", f"{other:.2f}"]
    assert rows["flown,"] == ["flown,", "s", "all", "2–3.16"]
    assert "published: elsewhere; not flown to the end, so not compared: second" in shown(metrics)
    nothing = shown(document(published=both, portions={"second": (2.0, 4.0)}))
    assert not {"elsewhere;", "elsewhere", "paper", "ratio"} & set(nothing.split())
    never = shown(document(published=both, portions={"second": (8.0, 9.0)}))
    assert ["flown,", "s", "none"] in [line.split() for line in never.splitlines()]


def test_who_was_lost_within_a_window_is_not_held_against_published_numbers():
    theirs = {"source": "x", "rms_m": {"first": [1.0] * 3}, "mean_rms_m": {"first": 1.0}}
    rows = first_rows(shown(document(published=theirs, gone_from=40, portions={"first": (1, 2)})))
    beside = [rows[name][2:] for name in ("uav1", "uav2", "uav3", "mean")]
    assert [each == ["–", "–"] for each in beside] == [False, False, True, True]


@pytest.mark.parametrize("followers", [0, 1, 3, 30])
@pytest.mark.parametrize("published", [None, PUBLISHED], ids=["alone", "beside"])
@pytest.mark.parametrize("noisy_from", [None, 0], ids=["exact", "noisy"])
def test_the_table_fits_80_columns_and_cuts_no_word(followers, published, noisy_from):
    more = {"published": published, "noisy_from": noisy_from, "gone_from": noisy_from}
    names = {f"p{i}": (0.5 * i, 0.5 * i + 1.0) for i in range(7)}
    for portions in ({}, {"first": (1.0, 2.0)}, names, {"never": (90.0, 95.0)}):
        text = shown(document(followers, portions=portions, **more))
        assert "…" not in text.replace("… and 3 more", "")
        assert max(map(len, text.splitlines())) <= 80


def test_of_many_followers_the_one_in_the_middle_is_told():
    metrics = document(30)
    portions = metrics["portions"]
    middle = [statistics.median(portions[name]["rms_m"].values()) for name in ("first", "second")]
    assert first_rows(shown(metrics))["median"][1:] == [f"{each:.2f}" for each in middle]
    assert "median" not in shown(document(12))


def facts(metrics):
    """The first line of each fact."""
    return {line[:20].strip(): line[21:].rstrip() for line in shown(metrics).splitlines()}


def test_the_table_says_nothing_of_exact_estimates_and_of_lost_aircraft_that_are_not():
    text = shown(document())
    assert "believed" not in text
    assert "estimates" not in text
    assert "lost" not in facts(document())


def test_the_table_says_what_estimates_were_worth():
    metrics = document(noisy_from=0)
    [row] = [line.split() for line in shown(metrics).splitlines() if "believed" in line]
    means = [metrics["portions"][name]["believed_mean_rms_m"] for name in ("first", "second")]
    assert row == ["mean", "believed", *(f"{mean:.2f}" for mean in means)]
    off = [numbers["horizontal_m"] for numbers in metrics["estimate_error"].values()]
    together = math.sqrt(sum(each**2 for each in off) / len(off))
    assert facts(metrics)["estimates err by"].startswith(f"{together:.2f} m horizontal, ")


def test_the_table_says_who_was_lost_and_when():
    metrics = document(gone_from=50)
    assert metrics["lost_at_s"]["uav3"] == 2.0
    assert facts(metrics)["lost"] == "uav3 at 2.0 s; counted until then"
    metrics["lost_at_s"] |= {"leader": 1.04, "uav3": 61.25}
    expected = "leader at 1.0 s, uav3 at 61.2 s; counted until then"
    assert facts(metrics)["lost"] == expected
    many = document(30, noisy_from=0)
    many["lost_at_s"] = {name: 0.1 * k for k, name in enumerate(many["lost_at_s"])}
    text = shown(many)
    assert "uav11 at 1.1 s, 19 more; counted until then" in " ".join(text.split())


def test_the_table_says_whose_kappa_was_smallest_and_what_the_page_says():
    metrics = document(kappa_mps=(3.6, 3.6, 9.0))
    # uav3 keeps more than uav2, but least of what the page says of it
    metrics |= {"kappa_mps": {"uav1": None, "uav2": 3.5, "uav3": 4.0}}
    metrics |= {"kappa_at_s": {"uav1": None, "uav2": 1.0, "uav3": 12.34}}
    metrics["left_speed_set"] = {name: {"times": 0, "first_s": None} for name in metrics["guards"]}
    shown_facts = facts(metrics)
    assert shown_facts["kappa measured"] == "4.00 m/s, uav3 at 12.3 s; the page says 9"
    assert "left the speed set" not in shown_facts
    metrics["left_speed_set"]["uav2"] = {"times": 3, "first_s": 4.0}
    assert facts(metrics)["left the speed set"] == "uav2 at 4.0 s, 3 × in all"
    metrics["left_speed_set"]["uav3"] = {"times": 1, "first_s": 2.0}
    assert facts(metrics)["left the speed set"] == "uav3 at 2.0 s, 1 × in all; 1 more"


def test_the_age_of_information_is_over_all_uses_of_what_was_heard():
    # uav1 used 10 messages of the leader, 0.1 s old in the mean, and 30 of uav2, 0.3 s old
    links = {
        "leader": {"uav1": link(age_s=age(0.1, 0.4, 10)), "uav2": link(age_s=age(0.2, 0.2, 5))},
        "uav1": {"uav2": link()},
        "uav2": {"uav1": link(age_s=age(0.3, 0.35, 30))},
    }
    ages = document(2, network={"links": links, "all": link()})["age_of_information_s"]
    assert ages["uav1"] == {"mean": pytest.approx(0.25, rel=1e-15), "max": 0.4}
    assert ages["uav2"] == {"mean": 0.2, "max": 0.2}
    nothing_heard = document(1)["age_of_information_s"]
    assert nothing_heard == {"uav1": {"mean": None, "max": None}}


def radio(together, **shares):
    """Facts about a network of these numbers in all and these shares on links from the leader."""
    links = {"leader": {name: link(1000, round(1000 * share)) for name, share in shares.items()}}
    text = shown(document(3, network={"links": links, "all": together}))
    assert max(map(len, text.splitlines())) <= 80
    lines = text.splitlines()
    at = [k for k, line in enumerate(lines) if line.startswith(" network ")]
    if not at:
        return []
    end = next((k for k in range(at[0] + 1, len(lines)) if lines[k][:3].strip()), len(lines))
    return [line[21:].rstrip() for line in lines[at[0] : end]]


def late(p50, p95):
    return {"mean": p50, "min": p50, "max": p95, "p50": p50, "p95": p95, "p99": p95}


def test_the_table_says_nothing_of_a_perfect_radio_and_how_late_another_is():
    assert radio(link(300, 300, delay_s=late(0.0, 1e-12)), uav1=1.0) == []
    assert radio(link(300, 300, delay_s=late(0.1, 0.1 + 1e-12)), uav1=1.0) == ["100 ms late"]


def test_the_table_says_what_was_lost_and_why():
    bursts = {"count": 7000, "mean": 1.43, "longest": 11, "lengths": {}}
    losses = {"lost": 96876, "blackout": 1203}
    together = link(324000, 225921, lost=losses, bursts=bursts, delay_s=late(0.1, 0.1))
    assert radio(together, uav1=0.7, uav2=0.698) == [
        "69.7 % of 324,000 delivered; worst leader > uav2 69.8 %",
        "96,876 lost, 1,203 in a blackout",
        "1.4 lost in a row, 11 at most; 100 ms late",
    ]
    lone = {"count": 3, "mean": 1.0, "longest": 1, "lengths": {"1": 3}}
    seldom = link(99000, 98997, lost={"listed": 3}, bursts=lone, mute=10)
    assert radio(seldom, uav1=0.7, uav2=0.7) == [
        "> 99.9 % of 99,000 delivered",
        "3 as listed",
        "10 not sent: sender mute or lost",
    ]


def test_the_table_says_how_late_messages_were_if_they_were_not_equally_late():
    jitter = link(300, 300, delay_s=late(0.0804, 0.1916))
    assert radio(jitter) == ["80.4 ms late, p95 192"]
    twice = link(300, 300, delay_s=late(0.0, 0.0), overtaken=1200, duplicated=3)
    assert radio(twice) == ["1,200 overtaken, 3 twice"]


def test_the_table_says_all_of_it_in_four_lines():
    together = link(
        300_000,
        210_000,
        lost={"lost": 90_000},
        mute=100,
        overtaken=37_297,
        duplicated=2_795,
        bursts={"count": 64_000, "mean": 1.40625, "longest": 11, "lengths": {}},
        delay_s=late(0.115, 0.245),
    )
    assert radio(together, uav1=0.7, uav2=0.698) == [
        "70.0 % of 300,000 delivered; worst leader > uav2 69.8 %",
        "90,000 lost, 37,297 overtaken, 2,795 twice",
        "100 not sent: sender mute or lost",
        "1.4 lost in a row, 11 at most; 115 ms late, p95 245",
    ]


def test_a_pipe_gets_no_colours():
    assert "\x1b" not in shown(document(published=PUBLISHED))


def test_a_run_in_flight_can_be_shown():
    meter = MetricsObserver()
    meter.begin(run_info())
    text = shown(meter.summary())
    assert "in flight" in text
    assert "never" in text
