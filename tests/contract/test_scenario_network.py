"""The network on the page: what it means, how it is changed, and how a wrong one is refused."""

from pathlib import Path

import jsonschema
import pytest

from testbed.scenario import ScenarioError, dump, find_data, json_schema, load, loads
from testbed.scenario.link import Bernoulli, FourState, GilbertElliott, Link
from testbed.scenario.network import Network

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
FULL = PAGES / "everything.yaml"
MINIMAL = (PAGES / "minimal.yaml").read_text()
START = MINIMAL.count("\n") + 1
BURSTS = "kind: gilbert-elliott, p: 0.1, r: 0.5"
UNIFORM = "distribution: uniform, spread_s: 0.2"
TRACE = "trace: {file: gusty-wind.csv}"


def page(network, overrides=()):
    return loads(f"{MINIMAL}network: {{{network}}}\n", overrides, source="page.yaml")


def complaint(network, overrides=()):
    with pytest.raises(ScenarioError) as caught:
        page(network, overrides)
    return str(caught.value)


def test_left_out_the_network_is_perfect():
    network = loads(MINIMAL).network
    assert (network.delay_s, network.message_bytes) == (0.0, 100)
    assert network.links == network.mute_s == network.broadcast == network.clocks == {}
    assert (network.partitions, network.tdma) == ((), None)
    rest = network.link("leader", "uav1").model_dump(exclude={"delay_s"})
    assert set(rest.values()) == {None}


def test_sections_have_the_defaults_they_document():
    network = page(
        f"delay_s: 1, jitter: {{spread_s: 0.1}}, loss: {{{BURSTS}}}, reorder: 0.1, "
        "rate: {bit_per_s: 9600}, slots: {every_s: 0.1}, shadowing: {loss: []}, "
        "links: {leader: {uav1: {loss: {kind: four-state, p13: 0.1, p31: 0.2}}}}"
    ).network
    assert (network.jitter.distribution, network.jitter.correlation) == ("uniform", 0.0)
    assert (network.jitter.file, network.jitter.in_order) == (None, False)
    assert (network.loss.loss_bad, network.loss.loss_good) == (1.0, 0.0)
    assert (network.reorder.gap, network.reorder.correlation) == (1, 0.0)
    assert (network.rate.overhead_bytes, network.rate.queue_packets) == (0, 1000)
    assert (network.slots.first_s, network.slots.packets) == (0.0, 1)
    assert network.shadowing.antenna == "below"
    four = network.links["leader"]["uav1"].loss
    assert (four.p32, four.p23, four.p14) == (0.0, 1.0, 0.0)


def test_a_number_stands_for_a_probability_and_one_for_a_pair():
    network = page("delay_s: 1, loss: 0.3, corrupt: 1, reorder: 0.25, slots: {every_s: 2}").network
    assert network.loss == Bernoulli(probability=0.3)
    assert network.loss == page("loss: {probability: 0.3}").network.loss
    assert network.loss == page("loss: {kind: bernoulli, probability: 0.3}").network.loss
    assert (network.corrupt.probability, network.reorder.probability) == (1.0, 0.25)
    assert network.slots.every_s == (2.0, 2.0)


# What is said of all links, and in four places that are ever more special.
LAYERS = {
    "delay_s": 1,
    "loss": 0.1,
    "links": {
        "*": {"*": {"delay_s": 2}, "uav2": {"delay_s": 3, "duplicate": 0.3, "drop": [3]}},
        "uav1": {"*": {"delay_s": 4, "drop": []}, "uav2": {"delay_s": 5}},
    },
}


@pytest.mark.parametrize(
    ("source", "destination", "delay", "duplicate", "drop"),
    [
        ("leader", "uav1", 2.0, None, None),
        ("leader", "uav2", 3.0, 0.3, (3,)),
        ("uav1", "uav3", 4.0, None, ()),
        ("uav1", "uav2", 5.0, 0.3, ()),
    ],
)
def test_the_most_special_place_that_says_a_key_decides_it(
    source, destination, delay, duplicate, drop
):
    link = Network.model_validate(LAYERS).link(source, destination)
    assert type(link) is Link
    assert link.delay_s == delay
    assert (link.duplicate.probability if link.duplicate else None) == duplicate
    assert link.drop == drop
    assert link.loss == Bernoulli(probability=0.1)


def delays(network, names=("lead", "uav1", "uav2")):
    return {
        (source, destination): network.link(source, destination).delay_s
        for source in names
        for destination in names[1:]
        if source != destination
    }


SETTINGS = [
    ("network.loss=0.3", lambda n: n.loss == Bernoulli(probability=0.3)),
    ("network.loss.probability=0.3", lambda n: n.loss.probability == 0.3),
    ("network.loss.probability=0.3", lambda n: n.loss.correlation == 0.3),
    (
        f"network.loss={{{BURSTS}}}",
        lambda n: n.loss == GilbertElliott(kind="gilbert-elliott", p=0.1, r=0.5),
    ),
    ("network.loss=null", lambda n: n.loss is None),
    ("network.links.lead.uav1.loss=0.5", lambda n: n.links["lead"]["uav1"].loss.probability == 0.5),
    ("network.links.lead.uav1.loss.p=0.5", lambda n: n.link("lead", "uav1").loss.p == 0.5),
    ("network.links.lead.uav2=null", lambda n: n.link("lead", "uav2").trace is None),
    ("network.links.uav2.uav1.delay_s=3", lambda n: n.link("uav2", "uav1").delay_s == 3.0),
    ("network.slots.every_s=0.5", lambda n: n.slots.every_s == (0.5, 0.5)),
    ("network.partitions.0.window_s=[1, 2]", lambda n: n.partitions[0].window_s == (1.0, 2.0)),
    ("network.links.lead.uav1.drop=[]", lambda n: n.link("lead", "uav1").drop == ()),
]


@pytest.mark.parametrize(("text", "holds"), SETTINGS, ids=[text for text, _ in SETTINGS])
def test_a_setting_changes_the_network(text, holds):
    changed = load(FULL, [text])
    assert holds(changed.network)
    assert loads(dump(changed)) == changed


def test_settings_reach_a_page_that_says_nothing_of_its_network():
    def network(*changes):
        return loads(MINIMAL, changes).network

    assert network("network.loss=0.3") == network("network.loss.probability=0.3")
    link = network("network.links.leader.uav1.loss=0.5").link("leader", "uav1")
    assert link.loss == Bernoulli(probability=0.5)
    everyone = network("network.links.*.uav1.delay_s=1")
    assert everyone.links == {"*": {"uav1": Link(delay_s=1.0)}}


def test_an_asterisk_in_a_setting_is_every_link_whatever_the_page_says_of_some():
    trace = "network.links.lead.uav2=null"  # it has no delay_s
    assert set(delays(load(FULL, [trace, "network.links.*.*.delay_s=0.4"]).network).values()) == {
        0.4
    }
    some = delays(load(FULL, [trace, "network.links.*.uav1.delay_s=0.4"]).network)
    assert some == {
        ("lead", "uav1"): 0.4,
        ("lead", "uav2"): 0.1,
        ("uav1", "uav2"): 0.1,
        ("uav2", "uav1"): 0.4,
    }
    from_lead = delays(load(FULL, [trace, "network.links.lead.*.delay_s=0.4"]).network)
    assert [end for end, delay in from_lead.items() if delay == 0.4] == [
        ("lead", "uav1"),
        ("lead", "uav2"),
    ]


def extended(tmp_path, base, top):
    (tmp_path / "base.yaml").write_text(f"{MINIMAL}network: {{{base}}}\n")
    (tmp_path / "top.yaml").write_text(f"extends: base.yaml\nnetwork: {{{top}}}\n")
    return load(tmp_path / "top.yaml").network


@pytest.mark.parametrize(
    ("base", "top", "probability", "correlation"),
    [
        ("loss: 0.3", "loss: {probability: 0.2, correlation: 0.1}", 0.2, 0.1),
        ("loss: {probability: 0.2, correlation: 0.1}", "loss: 0.3", 0.3, 0.0),
        ("loss: {probability: 0.2, correlation: 0.1}", "loss: {probability: 0.3}", 0.3, 0.1),
        ("loss: {probability: 0.2}", "loss: {kind: bernoulli, correlation: 0.1}", 0.2, 0.1),
        (f"loss: {{{BURSTS}}}", "loss: 0.3", 0.3, 0.0),
        ("loss: 0.3", "delay_s: 1", 0.3, 0.0),
    ],
)
def test_a_loss_is_merged_as_it_is_meant(tmp_path, base, top, probability, correlation):
    loss = extended(tmp_path, base, top).loss
    assert loss == Bernoulli(probability=probability, correlation=correlation)


@pytest.mark.parametrize(
    "base",
    [
        "loss: 0.3",
        "loss: {probability: 0.2, correlation: 0.1}",
        "loss: {kind: bernoulli, probability: 0.2}",
        "loss: {kind: four-state, p13: 0.1, p31: 0.2}",
    ],
)
def test_a_loss_of_another_kind_keeps_nothing_of_the_old(tmp_path, base):
    assert extended(tmp_path, base, f"loss: {{{BURSTS}}}").loss == GilbertElliott(
        kind="gilbert-elliott", p=0.1, r=0.5
    )


def test_links_are_merged_one_by_one(tmp_path):
    network = extended(
        tmp_path,
        f"links: {{leader: {{uav1: {{delay_s: 1, loss: {{{BURSTS}}}}}}}}}",
        "links: {leader: {uav1: {loss: {p: 0.2}, delay_s: null}, '*': {drop: [1]}}}",
    )
    link = network.link("leader", "uav1")
    assert (link.loss.p, link.loss.r, link.drop, link.delay_s) == (0.2, 0.5, (1,), 0.0)


def test_the_resolved_page_says_of_a_link_what_was_said_of_it():
    text = dump(page("links: {leader: {'*': {loss: 0.25}}}"))
    assert "  links:\n    leader:\n      '*':\n        loss:\n          probability: 0.25\n" in text
    assert "delay_s: null" not in text


def test_files_of_links_are_found_beside_the_page_and_by_name(tmp_path, monkeypatch):
    full = load(FULL).network
    assert full.links["lead"]["uav1"].jitter.file == str(PAGES / "delays.csv")
    assert full.links["lead"]["uav2"].trace.file == str(PAGES / "trace.csv")
    (tmp_path / "mine.csv").write_text("delay_s\n1\n")
    (tmp_path / "mine.yaml").write_text(
        f"{MINIMAL}network: {{jitter: {{distribution: empirical, file: mine.csv}}}}\n"
    )
    mine = load(tmp_path / "mine.yaml")
    assert mine.network.jitter.file == str(tmp_path / "mine.csv")
    monkeypatch.chdir("/")
    assert loads(dump(mine)) == mine
    kept = page(TRACE)
    assert kept.network.trace.file == "gusty-wind.csv"
    assert page(f"trace: {{file: {find_data('gusty-wind.csv')}}}") == kept


WRONG = [
    # numbers and kinds
    ("loss: 1.5", "network.loss: is 1.5 (write a number at most 1)"),
    ("loss: {probability: -1}", "network.loss.probability: is -1 (write a number at least 0)"),
    (
        "loss: true",
        "network.loss: is true (write a map of keys and values; Loss: a probability, 0",
    ),
    ("loss: {model: bernoulli}", "network.loss.model: is not a key of this part"),
    (
        "loss: {correlatoin: 0.5}",
        "correlatoin: is not a key of this part: did you mean 'correlatio",
    ),
    (
        "loss: {kind: gilbert}",
        "network.loss.kind: is 'gilbert': did you mean 'gilbert-elliott'? (write one of bernou",
    ),
    (
        "loss: {kind: gilbert-elliott, p: 0}",
        "network.loss.r: is missing (write r: ...; Probability",
    ),
    (
        f"loss: {{{BURSTS}, k: 1}}",
        "k: is not a key of this part (write one of kind, p, r, loss_bad",
    ),
    ("loss: {probability: 0.1, correlation: 1}", "correlation: is 1 (write a number below 1)"),
    ("duplicate: 2", "network.duplicate: is 2 (write a number at most 1)"),
    (
        "corrupt: {p: 1}",
        "network.corrupt.p: is not a key of this part (write one of probability, c",
    ),
    (
        "delay_s: 1, reorder: {probability: 1, gap: 0}",
        "reorder.gap: is 0 (write a number at least 1",
    ),
    ("delay_s: -0.1", "network.delay_s: is -0.1 (write a number at least 0)"),
    ("delay_s: null", "network.delay_s: is empty (write a number; Latency of every message, s)"),
    ("jitter: 0.1", "network.jitter: is 0.1 (write a map of keys and values; How latencies vary"),
    (
        "jitter: {distribution: gauss}",
        "is 'gauss' (write uniform, normal, lognormal, pareto, paret",
    ),
    ("rate: {bit_per_s: 0, queue_packets: 0}", "queue_packets: is 0 (write a number at least 1)"),
    ("range_loss: [[1, 2]]", "network.range_loss.0.1: is 2 (write a number at most 1)"),
    ("range_loss: [[1]]", "network.range_loss.0: has 1 elements (write 2; Loss by distance [[m, "),
    ("drop: [1.5]", "network.drop.0: is 1.5 (write a whole number; Sequence numbers of packets"),
    ("arithmetic: exakt", "is 'exakt': did you mean 'exact'? (write exact or netem)"),
    ("clocks: {uav1: {offset: 1}}", "offset: is not a key of this part: did you mean 'offset_s'?"),
    (
        "links: {leader: {uav1: 1}}",
        "network.links.leader.uav1: is 1 (write a map of keys and value",
    ),
    # names
    (
        "links: {lead: {uav1: {}}}",
        "network.links.lead: no aircraft has this name: did you mean 'leader'? (the run has "
        "leader, uav1)",
    ),
    (
        "links: {'*': {uav2: {}}}",
        "network.links.*.uav2: no follower has this name: did you mean 'uav1'? (the fleet has "
        "uav1; '*' is all of them)",
    ),
    (
        "links: {uav1: {leader: {}}}",
        "network.links.uav1.leader: is the leader, which does not listen (write the sender first, "
        "then a follower or '*')",
    ),
    (
        "links: {uav1: {uav1: {}}}",
        "network.links.uav1.uav1: an aircraft hears itself at once (leave this key out)",
    ),
    ("broadcast: {uav2: {}}", "network.broadcast.uav2: no aircraft has this name: did you mean"),
    ("clocks: {lead: {}}", "network.clocks.lead: no aircraft has this name: did you mean 'leader'"),
    (
        "partitions: [{window_s: [1, 2], groups: [[lead]]}]",
        "network.partitions.0.groups.0.0: no aircraft has this name: did you mean 'leader'?",
    ),
    (
        "tdma: {frame_s: 1, order: [leader, uav2]}",
        "network.tdma.order.1: no aircraft has this name: did you mean 'uav1'?",
    ),
    # windows and groups
    (
        "blackout_s: [[2, 1]]",
        "network.blackout_s.0: [2, 1] is not a window (write [from, to] in s)",
    ),
    (
        "links: {leader: {'*': {blackout_s: [[0, 1], [2, 2]]}}}",
        "network.links.leader.*.blackout_s.1: [2, 2] is not a window (write [from, to] in s)",
    ),
    (
        "partitions: [{window_s: [1, 1], groups: [[uav1]]}]",
        "network.partitions.0.window_s: [1, 1] is not a window",
    ),
    (
        "partitions: [{window_s: [1, 2], groups: [[uav1], [uav1]]}]",
        "network.partitions.0.groups.1.0: 'uav1' is in a group already (write each name once)",
    ),
    (
        "partitions: [{window_s: [1, 2], groups: [[uav1, leader]]}]",
        "network.partitions.0.groups: has everyone in one group: nothing is divided (write fewer)",
    ),
    # loss
    (
        "loss: {kind: gilbert-elliott, p: 0, r: 0}",
        "network.loss: p and r are both 0: the state never changes (write one of them above 0)",
    ),
    (
        "loss: {kind: four-state, p13: 0.6, p31: 0.1, p14: 0.5}",
        "network.loss.p14: p13 + p14 is 1.1, and both leave the same state (write at most 1 for",
    ),
    (
        "loss: {kind: four-state, p13: 0.6, p31: 0.9, p32: 0.3}",
        "network.loss.p32: p31 + p32 is 1.2, and both leave the same state (write at most 1 for",
    ),
    ("range_loss: [[5, 0], [5, 1]]", "range_loss.1.0: 5 does not increase from 5 (write the dist"),
    (
        "shadowing: {loss: [[0, 0], [40, 1], [30, 1]]}",
        "network.shadowing.loss.2.0: 30 does not increase from 40 (write the angles in "
        "rising order)",
    ),
    # delays
    (
        f"delay_s: 0.1, jitter: {{{UNIFORM}}}",
        "network.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from leader to uav1, 0.1 s: "
        "messages would arrive before they are sent (write less, or a longer delay_s)",
    ),
    (
        "delay_s: 0.1, jitter: {distribution: pareto, spread_s: 0.2}",
        "network.jitter.spread_s: 0.2 s reaches 0.1155 s below delay_s from leader to uav1, 0.1 s",
    ),
    (
        "slots: {every_s: [1e-6, 2e-6]}",
        "network.slots.every_s: 1e-06 s is too short for a slot (write at least 1e-05)",
    ),
    ("tdma: {frame_s: 1e-6}", "network.tdma.frame_s: is 1e-06 (write a number at least 1e-05)"),
    (
        "partitions: [{window_s: [1, 2], groups: [[]]}]",
        "network.partitions.0.groups.0: ",
    ),
    ("loss: {p: 0.1, r: 0.4}", "network.loss.kind: is missing (write one of bernoulli, four-"),
    ("links: {leader>uav1: {loss: 1}}", "network.links.leader>uav1: is no name (write letters"),
    (
        "jitter: {distribution: lognormal, spread_s: 0.1}",
        "network.jitter.distribution: is lognormal, whose mean is delay_s, and that is 0 s from "
        "leader to uav1 (write a longer delay_s)",
    ),
    (
        "jitter: {distribution: empirical}",
        "network.jitter.file: is missing (write the name of a CSV file with a column delay_s)",
    ),
    (
        "jitter: {file: gusty-wind.csv}",
        "network.jitter.file: belongs to distribution: empirical, and the distribution is uniform "
        "(leave one of them out)",
    ),
    (
        "jitter: {distribution: empirical, file: gusty-wind.csv, spread_s: 1}",
        "network.jitter.spread_s: is that of the file, for distribution: empirical (leave this "
        "out)",
    ),
    (
        "reorder: 0.1",
        "network.reorder: lets packets overtake those that wait, and delay_s is 0 from leader to "
        "uav1 (write a delay_s)",
    ),
    (
        "delay_s: 1, jitter: {spread_s: 0.1, in_order: true}, reorder: 0.1",
        "network.reorder: lets packets overtake, and jitter.in_order does not (leave one of them o",
    ),
    # slots
    (
        "slots: {every_s: [2, 1]}",
        "network.slots.every_s: [2, 1] is not a range of times (write [shortest, longest], both",
    ),
    ("slots: {every_s: [0, 1]}", "network.slots.every_s: [0, 1] is not a range of times"),
    (
        "tdma: {frame_s: 1}, slots: {every_s: 1}",
        "network.slots: are slots of this link alone, and network.tdma has everyone's (leave one",
    ),
    (
        "tdma: {frame_s: 1}, links: {'*': {uav1: {slots: {every_s: 1}}}}",
        "network.links.*.uav1.slots: are slots of this link alone, and network.tdma has everyone's",
    ),
    (
        "tdma: {frame_s: 1, order: [leader, uav1, leader]}",
        "network.tdma.order.2: 'leader' has a slot already (write each name once)",
    ),
    (
        "tdma: {frame_s: 1, order: [leader]}",
        "network.tdma.order: has no slot for uav1 (write every aircraft, or leave order out)",
    ),
    (
        "broadcast: {uav1: {period_s: 0.004}}",
        "network.broadcast.uav1.period_s: 0.004 s is less than a step of the run (write at least "
        "0.005, or a higher rates.physics_hz)",
    ),
    # traces
    (
        f"{TRACE}, loss: 0.1",
        "network.loss: has no say from leader to uav1: trace.file has all that arrives, and when "
        "(leave one of them out)",
    ),
    (
        f"{TRACE}, links: {{leader: {{'*': {{delay_s: 1}}}}}}",
        "network.links.leader.*.delay_s: has no say from leader to uav1: trace.file has all",
    ),
    (
        "links: {leader: {uav1: {trace: {file: gustywind.csv}}}}",
        "network.links.leader.uav1.trace.file: there is no data file 'gustywind.csv': did you mean "
        "'gusty-wind.csv'? (write one of: ",
    ),
    (
        "jitter: {distribution: empirical, file: nix.csv}",
        "network.jitter.file: there is no data file 'nix.csv' (write one of: ",
    ),
]


@pytest.mark.parametrize(("network", "message"), WRONG, ids=[network for network, _ in WRONG])
def test_a_wrong_network_is_named_with_its_place_and_its_cure(network, message):
    lines = complaint(network).splitlines()
    assert all(line.startswith(f"page.yaml:{START}:") for line in lines)
    assert any(message in line for line in lines)


def test_what_is_wrong_for_many_links_is_said_once_and_where_it_was_written():
    three = [
        "fleet=[{name: a, aircraft: rascal110, start_m: [-9, 9, 0]}, {name: b, aircraft: "
        "rascal110, start_m: [-9, -9, 0]}, {name: c, aircraft: rascal110, start_m: [-20, 0, 0]}]",
        "formation.offsets_m={a: [-9, 9, 0], b: [-9, -9, 0], c: [-20, 0, 0]}",
    ]
    text = complaint(f"delay_s: 0.1, jitter: {{{UNIFORM}}}", three)
    assert text.count("\n") == 0
    text = complaint(
        f"delay_s: 1, jitter: {{{UNIFORM}}}, links: {{'*': {{b: {{delay_s: 0.1}}}}}}", three
    )
    assert (
        "network.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from leader to b, 0.1 s" in text
    )
    assert text.count("\n") == 0
    text = complaint(f"delay_s: 0.1, links: {{a: {{b: {{jitter: {{{UNIFORM}}}}}}}}}", three)
    assert (
        "network.links.a.b.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from a to b" in text
    )
    text = complaint(f"links: {{c: {{'*': {{jitter: {{{UNIFORM}}}}}, a: {{delay_s: 1}}}}}}", three)
    assert (
        "network.links.c.*.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from c to b, 0 s"
        in text
    )


@pytest.mark.parametrize(
    "network",
    [
        "links: {leader: {uav1: {}}}",
        "links: {'*': {'*': {loss: 1}}}",
        f"delay_s: 0.2, jitter: {{{UNIFORM}}}",
        f"delay_s: 0.1, jitter: {{{UNIFORM}}}, arithmetic: netem",  # sent at once, as there
        "delay_s: 0.1, jitter: {distribution: pareto, spread_s: 0.173}",
        f"jitter: {{{UNIFORM}}}, links: {{'*': {{'*': {{delay_s: 1}}}}}}",
        f"delay_s: 0.2, loss: 0.1, jitter: {{{UNIFORM}}}, links: {{leader: {{uav1: {{{TRACE}}}}}}}",
        f"{TRACE}, reorder: 0.1, duplicate: 0.5, slots: {{every_s: 1}}",
        "jitter: {distribution: lognormal}",
        "jitter: {distribution: normal, spread_s: 0.1}, reorder: 0.1",
        "slots: {every_s: 0}, tdma: {frame_s: 1, order: [uav1, leader]}",
        "range_loss: [], shadowing: {loss: []}, blackout_s: [], drop: [], rate: {bit_per_s: 0}",
        "range_loss: [[0, 0.1]], drop: [7, 1, 1]",
        "partitions: [{window_s: [1, 2], groups: [[uav1]]}]",
        "loss: {kind: gilbert-elliott, p: 0, r: 1, loss_good: 0.1}",
        "broadcast: {uav1: {period_s: 0.005}, leader: {phase_s: 5}}",
    ],
)
def test_what_is_unusual_is_not_wrong(network):
    read = page(network)
    assert loads(dump(read)) == read


def test_the_three_kinds_of_loss_survive_the_round_trip_with_their_kind():
    for kind, loss in (
        (Bernoulli, "0.1"),
        (GilbertElliott, f"{{{BURSTS}}}"),
        (FourState, "{kind: four-state, p13: 0.1, p31: 0.2}"),
    ):
        read = page(f"loss: {loss}")
        assert type(loads(dump(read)).network.loss) is kind


@pytest.mark.parametrize(
    ("network", "valid"),
    [
        ({"loss": 0.3}, True),
        ({"loss": 1.3}, False),
        ({"loss": {"probability": 0.3}}, True),
        ({"loss": {"correlation": 0.3}}, True),  # of a page that another completes
        ({"loss": {"kind": "gilbert-elliott", "p": 0.1}}, True),
        ({"loss": {"kind": "gilbert-elliott", "p13": 0.1}}, False),
        ({"loss": {"p": 0.1}}, False),
        ({"loss": {"kind": "gilbert"}}, False),
        ({"loss": None, "jitter": None}, True),
        ({"loss": "high"}, False),
        ({"duplicate": 0.1, "corrupt": {"probability": 1}, "reorder": 0.5}, True),
        ({"reorder": {"probability": 0.5, "gap": 0}}, False),
        ({"duplicate": {"gap": 5}}, False),
        ({"slots": {"every_s": 0.1}}, True),
        ({"slots": {"every_s": [0.1, 0.2]}}, True),
        ({"slots": {"every_s": [0.1, 0.2, 0.3]}}, False),
        ({"links": {"leader": {"*": {"loss": 0.3, "range_loss": [[1, 0], [2, 1]]}}}}, True),
        ({"links": {"leader": {"*": {"loss": 3}}}}, False),
        ({"links": {"leader": {"loss": 0.3}}}, False),
        ({"range_loss": [[1, 0, 0]]}, False),
        ({"tdma": {"frame_s": 0}}, False),
        ({"clocks": {"leader": {"offset_s": -1, "drift_ppm": 3}}}, True),
    ],
)
def test_the_editors_schema_knows_the_network(network, valid):
    validator = jsonschema.Draft202012Validator(json_schema())
    assert validator.is_valid({"network": network}) is valid
