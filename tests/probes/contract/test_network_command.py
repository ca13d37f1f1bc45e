"""`testbed network`: its file against the network's model and against a flight; table, errors."""

import csv
import json
import math
import re

import numpy as np
import pytest
from cases import in_full
from commands import call_command, refuse_all
from snapshot import check_snapshot
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.probes.channel_probe import probe_channel
from testbed.runs.run import run
from testbed.scenario import load_scenario, set_duration

COLUMNS = ["source", "destination", "sequence", "sent_s", "received_s", "outcome", "copies"]
NAMES = ("leader", "uav1", "uav2", "uav3")
LINKS = [(source, other) for source in NAMES for other in NAMES[1:] if other != source]


def network(*arguments, sets=(), scenario="simulation-3"):
    words = [word for each in sets for word in ("--set", each)]
    return CliRunner().invoke(app, ["network", scenario, *map(str, arguments), *words])


def sent(tmp_path, *arguments, sets=(), scenario="simulation-3"):
    """Rows that the command writes, by link."""
    path = tmp_path / "messages.csv"
    done = network("--out", path, *arguments, sets=sets, scenario=scenario)
    assert done.exit_code == 0, done.output
    links = {}
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        assert reader.fieldnames == COLUMNS
        for row in reader:
            links.setdefault((row["source"], row["destination"]), []).append(row)
    return links


def column(rows, name, kind=float):
    return np.array([kind(row[name] or "nan") for row in rows])


def outcomes(rows):
    return [row["outcome"] for row in rows]


def test_rows_are_in_order_of_links_and_sequence(tmp_path):
    links = sent(tmp_path, "--packets", 40)
    assert list(links) == LINKS
    for rows in links.values():
        assert column(rows, "sequence", int).tolist() == list(range(40))
        assert column(rows, "sent_s").tolist() == [k / 25.0 for k in range(40)]
        assert column(rows, "received_s").tolist() == column(rows, "sent_s").tolist()
        assert set(outcomes(rows)) == {"delivered"}
        assert {row["copies"] for row in rows} == {"1"}


def test_lost_message_has_no_time_and_no_copies(tmp_path):
    sets = ("network.loss=0.5", "network.duplicate=0.5", "network.delay_s=0.1")
    for rows in sent(tmp_path, "--packets", 300, sets=sets).values():
        for row in rows:
            assert row["outcome"] in ("delivered", "lost")
            assert (row["received_s"] == "") == (row["copies"] == "0") == (row["outcome"] == "lost")
        assert {row["copies"] for row in rows} == {"0", "1", "2"}
        here = [row for row in rows if row["received_s"]]
        delay = column(here, "received_s") - column(here, "sent_s")
        assert np.allclose(delay, 0.1, rtol=0.0, atol=1e-12)


def test_numbers_are_written_with_all_digits(tmp_path):
    sets = ("network.delay_s=0.1", "network.jitter={distribution: lognormal, spread_s: 0.05}")
    links = sent(tmp_path, "--packets", 200, sets=sets)
    for row in links["leader", "uav1"]:
        assert repr(float(row["received_s"])) == row["received_s"]
    assert max(len(row["received_s"]) for row in links["leader", "uav1"]) > 16


@pytest.mark.parametrize(
    ("sets", "link", "expected"),
    [
        (("network.drop=[0, 3]",), ("uav1", "uav2"), {0: "listed", 3: "listed"}),
        (("network.blackout_s=[[0.1, 0.2]]",), ("uav1", "uav2"), {3: "blackout", 4: "blackout"}),
        (
            ("network.transmitter_off_s={uav1: [[0.1, 0.2]]}",),
            ("uav1", "uav3"),
            {3: "muted", 4: "muted"},
        ),
        (("network.transmitter_off_s={uav1: [[0.1, 0.2]]}",), ("uav2", "uav1"), {}),
        (
            ("network.partitions=[{window_s: [0, 0.1], groups: [[leader, uav1]]}]",),
            ("leader", "uav2"),
            {0: "partition", 1: "partition", 2: "partition"},
        ),
        (("network.corrupt=1",), ("leader", "uav1"), dict.fromkeys(range(10), "corrupted")),
        (("network.range_loss=[[0, 1]]",), ("uav3", "uav1"), dict.fromkeys(range(10), "faded")),
        (
            # a message of 100 bytes takes 0.1 s, a new one comes every 0.04 s, and one may wait
            ("network.rate={bit_per_s: 8000, queue_packets: 1}",),
            ("leader", "uav1"),
            {k: "queue" for k in range(10) if k % 3},
        ),
    ],
)
def test_scripted_losses_have_their_outcome(sets, link, expected, tmp_path):
    rows = sent(tmp_path, "--packets", 10, sets=sets)[link]
    found = {k: outcome for k, outcome in enumerate(outcomes(rows)) if outcome != "delivered"}
    assert found == expected


def test_trace_is_replayed(tmp_path):
    (tmp_path / "trace.csv").write_text("sent_s,received_s\n0,0.25\n0.04,\n0.08,0.1\n")
    scenario = (
        "extends: simulation-3\n"
        "scenario: {schema: 2, name: traced}\n"
        "network: {links: {leader: {uav1: {trace: {file: trace.csv}}}}}\n"
    )
    (tmp_path / "traced.yaml").write_text(scenario)
    links = sent(tmp_path, "--packets", 6, scenario=str(tmp_path / "traced.yaml"))
    rows = links["leader", "uav1"]
    assert outcomes(rows) == ["delivered", "lost", "delivered"] * 2
    delay = column(rows, "received_s") - column(rows, "sent_s")
    assert delay[::3] == pytest.approx([0.25, 0.25], abs=1e-12)
    assert delay[2::3] == pytest.approx([0.02, 0.02], abs=1e-12)
    assert set(outcomes(links["uav1", "uav2"])) == {"delivered"}


def test_written_file_replays_as_a_trace(tmp_path):
    """With senders at different times, the first of them later than one period."""
    beats = (
        "network.broadcast={leader: {period_s: 0.1, phase_s: 0.3}, uav1: {period_s: 0.11, "
        "phase_s: 0.05}}",
        "rates.synchronous=false",
    )
    knobs = ("network.delay_s=0.1", "network.jitter={spread_s: 0.08}", "network.loss=0.3")
    recorded = sent(tmp_path, "--packets", 200, sets=beats + knobs)
    (tmp_path / "messages.csv").rename(tmp_path / "trace.csv")
    trace = f"network.trace={{file: {tmp_path / 'trace.csv'}, begin_s: 0}}"
    replayed = sent(tmp_path, "--packets", 200, sets=(*beats, trace))
    assert replayed == recorded


def test_range_loss_uses_distances_of_the_start(tmp_path):
    # messages are lost with probability 1/2 at the distance between uav1 and uav2
    scenario = load_scenario("simulation-3")
    one, two = (np.array(scenario.fleet[k].start_m) for k in (0, 1))
    far = float(np.linalg.norm(one - two))
    curve = [[0, 0], [0.999 * far, 0], [1.001 * far, 1]]
    lost = outcomes(
        sent(tmp_path, "--packets", 1000, sets=(f"network.range_loss={curve}",))["uav1", "uav2"]
    )
    # six standard deviations of a binomial distribution
    assert abs(lost.count("faded") - 500) < 6.0 * math.sqrt(250.0)


def test_broadcast_period_of_a_sender_applies(tmp_path):
    sets = ("network.broadcast={uav2: {period_s: 0.07, phase_s: 0.013}}",)
    links = sent(tmp_path, "--packets", 50, sets=sets)
    own = column(links["uav2", "uav1"], "sent_s")
    assert own == pytest.approx(0.013 + 0.07 * np.arange(50), abs=1e-12)
    assert column(links["uav1", "uav2"], "sent_s") == pytest.approx(np.arange(50) / 25.0)


def test_flight_has_the_same_messages(tmp_path):
    sets = (
        "network.loss={probability: 0.3, correlation: 0.2}",
        "network.delay_s=0.05",
        "network.jitter={distribution: normal, spread_s: 0.02, correlation: 0.5}",
        "network.duplicate=0.1",
        "network.blackout_s=[[1, 2]]",
        "network.broadcast={uav2: {period_s: 0.05}}",
        "rates.synchronous=false",
    )
    scenario = set_duration(load_scenario("simulation-3", sets), 6.0)
    links_of_run = run(scenario, write=False).metrics["network"]["links"]
    links = sent(tmp_path, "--packets", 160, sets=sets)
    for (source, destination), rows in links.items():
        before = column(rows, "sent_s") <= 6.0 + 1e-9
        link = links_of_run[source][destination]
        assert link["sent"] == before.sum() > 100
        found = [outcome for outcome, there in zip(outcomes(rows), before, strict=True) if there]
        assert link["delivered"] == found.count("delivered")
        assert link["lost"] == {name: found.count(name) for name in ("lost", "blackout")}
        delay = (column(rows, "received_s") - column(rows, "sent_s"))[before]
        assert link["delay_s"]["mean"] == pytest.approx(np.nanmean(delay), rel=1e-9)
        assert link["delay_s"]["max"] == pytest.approx(np.nanmax(delay), rel=1e-9)


def test_file_depends_only_on_the_seed(tmp_path):
    sets = ("network.loss=0.3", "network.delay_s=0.1", "network.jitter={spread_s: 0.1}")
    files = [tmp_path / name for name in ("one.csv", "two.csv", "other.csv")]
    for path, seed in zip(files, (7, 7, 8), strict=True):
        done = network("--packets", 200, "--out", path, "--seed", seed, sets=sets)
        assert done.exit_code == 0
    one, two, other = (path.read_bytes() for path in files)
    assert one == two != other


def test_summary_has_the_counts_of_the_rows(tmp_path):
    sets = ("network.loss=0.3", "network.delay_s=0.1", "network.duplicate=0.2")
    path = tmp_path / "table.json"
    links = sent(tmp_path, "--packets", 500, "--json", path, sets=sets)
    table = json.loads(path.read_text())
    assert (table["scenario"], table["seed"], table["packets"]) == ("simulation-3", 1, 500)
    all_rows = [row for rows in links.values() for row in rows]
    assert table["all"]["sent"] == len(all_rows) == 4500
    assert table["all"]["lost"] == {"lost": outcomes(all_rows).count("lost")}
    for (source, destination), rows in links.items():
        link = table["links"][source][destination]
        assert link["delivered"] == outcomes(rows).count("delivered")
        assert link["duplicated"] == [row["copies"] for row in rows].count("2")


def test_json_on_stdout_moves_table_to_stderr():
    done = network("--packets", 20, "--json", "-", sets=("network.loss=1",))
    assert json.loads(done.stdout)["all"]["delivered_share"] == 0.0
    assert "arrived" in done.stderr


EVERYTHING = (
    "network.delay_s=0.1",
    "network.jitter={distribution: paretonormal, spread_s: 20}",
    "network.loss=0.1",
    "network.duplicate=0.1",
    "network.corrupt=0.1",
    "network.rate={bit_per_s: 8000, queue_packets: 1}",
    "network.range_loss=[[0, 0.1]]",
    "network.drop=[1]",
    "network.blackout_s=[[2, 3]]",
    "network.transmitter_off_s={uav1: [[4, 5]]}",
    "network.partitions=[{window_s: [6, 7], groups: [[leader, uav1]]}]",
)


def test_table_fits_80_columns(tmp_path):
    words = [word for each in EVERYTHING for word in ("--set", each)]
    words += ["--packets", "1100", "--json", "table.json"]
    done = call_command("network", "simulation-3", *words, cwd=tmp_path, code=0, columns=80)
    check_snapshot("network", done.stdout)
    assert max(map(len, done.stdout.splitlines())) <= 80
    together = json.loads((tmp_path / "table.json").read_text())["all"]
    assert len(together["lost"]) == 7


def test_perfect_network_has_one_table(tmp_path):
    words = ("network", "simulation-3", "--packets", 10)
    done = call_command(*words, cwd=tmp_path, code=0, columns=80)
    check_snapshot("network_perfect", done.stdout)


def test_many_links_show_the_worst():
    names = [f"uav{k}" for k in range(1, 6)]
    fleet = [
        f"{{name: {each}, aircraft: rascal110, start_m: [-20, {9 * k}, 0]}}"
        for k, each in enumerate(names)
    ]
    offsets = [f"{each}: [-20, {9 * k}, 0]" for k, each in enumerate(names)]
    sets = (
        f"fleet=[{', '.join(fleet)}]",
        f"formation.offsets_m={{{', '.join(offsets)}}}",
        f"formation.leader_gains={{{', '.join(f'{each}: 1' for each in names)}}}",
        "scenario.published=null",
        "network.links={uav4: {uav2: {loss: 1}}}",
    )
    done = network("--packets", 30, sets=sets)
    assert done.exit_code == 0, done.exception
    assert "uav4 > uav2" in done.stdout
    assert "(the worst of 25 links)" in done.stdout
    assert sum(" > " in line for line in done.stdout.splitlines()) == 25  # in two tables, and below


def test_bad_input_error_has_the_remedy(tmp_path):
    refuse_all("network", tmp_path)


def test_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "messages.csv"
    path.write_text("old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    done = network("--packets", 10, "--out", path)
    assert "cannot be written: No space left" in str(done.exception)
    assert [each.read_text() for each in tmp_path.iterdir()] == ["old"]


LINKED = (
    "network.links.leader.uav2.loss=0.6",
    "network.delay_s=0.06",
    "network.jitter={spread_s: 0.05}",
)


def test_summary_fits_60_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    lines = network("--packets", 300, scenario="bursty-wifi").stdout.splitlines()
    assert max(map(len, lines)) <= 60 and not any("…" in line for line in lines)
    # what arrived, bursts, and outcomes by three and the rest
    assert sum(line.startswith(" leader > uav1 ") for line in lines) == 4


def test_summary_names_the_worst_link():
    """One bad link of nine, which a median over links hides."""
    done = network("--packets", 400, sets=LINKED)
    text = " ".join(done.stdout.split())
    found = re.search(r"worst link: leader > uav2, (\S+) % arrived, 95 % of these within", text)
    assert found and 30.0 < float(found[1]) < 50.0
    assert "lost in a row" in text
    assert all(line.startswith((" ", "─")) for line in done.stdout.splitlines() if line)
    assert "worst link" not in network("--packets", 40).stdout


PLOTS = (
    pytest.param("a.png", b"\x89PNG", marks=in_full),
    pytest.param("a.pdf", b"%PDF", marks=in_full),
    ("a.SVG", b"<?xml"),
)


@pytest.mark.parametrize(("name", "start"), PLOTS)
def test_plot_is_reproducible(name, start, tmp_path):
    """A PNG is drawn twice by that of the air, and a PDF by that of settings of the user."""
    drawn = []
    for _ in range(1 if name == "a.png" else 2):
        done = network("--packets", 50, "--plot", tmp_path / name, sets=LINKED)
        assert done.exit_code == 0, done.output
        drawn.append((tmp_path / name).read_bytes())
    assert drawn[0].startswith(start) and drawn[0] == drawn[-1]


def test_plot_has_the_numbers_of_the_table(tmp_path, monkeypatch):
    """Each link's share in its cell; curves that end at the share that arrived."""
    grids = []
    monkeypatch.setattr(
        "testbed.views.matplotlib_backend.save_figure", lambda grid, *_: grids.append(grid)
    )
    words = ("--packets", 500, "--plot", tmp_path / "a.png", "--json", tmp_path / "a.json")
    assert network(*words, sets=LINKED).exit_code == 0
    links = json.loads((tmp_path / "a.json").read_text())["links"]
    [[shares, delays, curves]] = grids[0].rows
    names = ["leader", "uav1", "uav2", "uav3"]
    for k, receiver in enumerate(reversed(names[1:])):
        for m, sender in enumerate(names):
            cell, late = shares.heat.values[k, m], delays.heat.values[k, m]
            if sender == receiver:
                assert np.isnan(cell) and np.isnan(late)
                assert shares.heat.texts[k][m] == "–"
            else:
                link = links[sender][receiver]
                assert cell == 100.0 * link["delivered_share"]
                assert late == pytest.approx(1e3 * link["delay_s"]["p95"], rel=0.1)
    by_name = {line.label.partition(": ")[0]: line for line in curves.lines if line.label}
    assert by_name["worst"].label == "worst: leader > uav2"
    assert by_name["worst"].y[-1] == 100.0 * links["leader"]["uav2"]["delivered_share"]
    assert by_name["best"].y[-1] == 100.0 and len(curves.lines) == 9


def test_plot_of_equal_links_and_of_a_large_fleet(tmp_path, monkeypatch):
    grids = []
    monkeypatch.setattr(
        "testbed.views.matplotlib_backend.save_figure", lambda grid, *_: grids.append(grid)
    )
    words = ("--packets", 5, "--plot", tmp_path / "a.png")
    assert network(*words, scenario="vee-30").exit_code == 0
    [[shares, _, curves]] = grids[0].rows
    assert [line.label for line in curves.lines] == ["all links"]
    assert shares.heat.texts == () and len(shares.x_ticks) <= 8


def test_old_name_of_the_probe_warns():
    with pytest.warns(DeprecationWarning, match="testbed.probes.channel_probe now"):
        from testbed.trials.channel_probe import probe_channel as old
    assert old is probe_channel
