"""The network section: defaults, precedence of links, settings and the editor's schema."""

import pytest
from places import TESTS

from testbed.scenario import ScenarioError, dump, find_data, load_scenario, loads
from testbed.scenario.network import Bernoulli, FourState, GilbertElliott, Link, Network

FOLDER = TESTS / "data" / "scenarios"
FULL = FOLDER / "everything.yaml"
MINIMAL = (FOLDER / "minimal.yaml").read_text()
BURSTS = "kind: gilbert-elliott, p: 0.1, r: 0.5"
UNIFORM = "distribution: uniform, spread_s: 0.2"
TRACE = "trace: {file: gusty-wind.csv}"


def read(network, overrides=()):
    return loads(f"{MINIMAL}network: {{{network}}}\n", overrides)


def error_of(network, overrides=()):
    with pytest.raises(ScenarioError) as caught:
        read(network, overrides)
    return str(caught.value)


def test_number_stands_for_probability_or_pair():
    network = read("delay_s: 1, loss: 0.3, corrupt: 1, reorder: 0.25, slots: {every_s: 2}").network
    assert network.loss == Bernoulli(probability=0.3)
    assert network.loss == read("loss: {probability: 0.3}").network.loss
    assert network.loss == read("loss: {kind: bernoulli, probability: 0.3}").network.loss
    assert (network.corrupt.probability, network.reorder.probability) == (1.0, 0.25)
    assert network.slots.every_s == (2.0, 2.0)


# Keys of all links, and of four entries that are ever more specific.
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
def test_most_specific_entry_decides_a_key(source, destination, delay, duplicate, drop):
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
def test_setting_changes_the_network(text, holds):
    changed = load_scenario(FULL, [text])
    assert holds(changed.network)
    assert loads(dump(changed)) == changed


def test_setting_adds_to_an_empty_network():
    def network(*changes):
        return loads(MINIMAL, changes).network

    assert network("network.loss=0.3") == network("network.loss.probability=0.3")
    link = network("network.links.leader.uav1.loss=0.5").link("leader", "uav1")
    assert link.loss == Bernoulli(probability=0.5)
    from_all = network("network.links.*.uav1.delay_s=1")
    assert from_all.links == {"*": {"uav1": Link(delay_s=1.0)}}


def test_asterisk_in_setting_is_every_link():
    trace = "network.links.lead.uav2=null"  # it has no delay_s
    assert set(
        delays(load_scenario(FULL, [trace, "network.links.*.*.delay_s=0.4"]).network).values()
    ) == {0.4}
    some = delays(load_scenario(FULL, [trace, "network.links.*.uav1.delay_s=0.4"]).network)
    assert some == {
        ("lead", "uav1"): 0.4,
        ("lead", "uav2"): 0.1,
        ("uav1", "uav2"): 0.1,
        ("uav2", "uav1"): 0.4,
    }
    from_lead = delays(load_scenario(FULL, [trace, "network.links.lead.*.delay_s=0.4"]).network)
    assert [end for end, delay in from_lead.items() if delay == 0.4] == [
        ("lead", "uav1"),
        ("lead", "uav2"),
    ]


def extended(tmp_path, base, top):
    (tmp_path / "base.yaml").write_text(f"{MINIMAL}network: {{{base}}}\n")
    (tmp_path / "top.yaml").write_text(f"extends: base.yaml\nnetwork: {{{top}}}\n")
    return load_scenario(tmp_path / "top.yaml").network


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
def test_loss_merges_numbers_and_maps(tmp_path, base, top, probability, correlation):
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
def test_loss_of_other_kind_replaces_the_old(tmp_path, base):
    assert extended(tmp_path, base, f"loss: {{{BURSTS}}}").loss == GilbertElliott(
        kind="gilbert-elliott", p=0.1, r=0.5
    )


def test_links_merge_one_by_one(tmp_path):
    network = extended(
        tmp_path,
        f"links: {{leader: {{uav1: {{delay_s: 1, loss: {{{BURSTS}}}}}}}}}",
        "links: {leader: {uav1: {loss: {p: 0.2}, delay_s: null}, '*': {drop: [1]}}}",
    )
    link = network.link("leader", "uav1")
    assert (link.loss.p, link.loss.r, link.drop, link.delay_s) == (0.2, 0.5, (1,), 0.0)


def test_dump_has_only_set_keys_of_a_link():
    text = dump(read("links: {leader: {'*': {loss: 0.25}}}"))
    assert "  links:\n    leader:\n      '*':\n        loss:\n          probability: 0.25\n" in text
    assert "delay_s: null" not in text


def test_files_of_links_are_found_by_path_and_name(tmp_path, monkeypatch):
    full = load_scenario(FULL).network
    assert full.links["lead"]["uav1"].jitter.file == str(FOLDER / "delays.csv")
    assert full.links["lead"]["uav2"].trace.file == str(FOLDER / "trace.csv")
    (tmp_path / "mine.csv").write_text("delay_s\n1\n")
    (tmp_path / "mine.yaml").write_text(
        f"{MINIMAL}network: {{jitter: {{distribution: empirical, file: mine.csv}}}}\n"
    )
    mine = load_scenario(tmp_path / "mine.yaml")
    assert mine.network.jitter.file == str(tmp_path / "mine.csv")
    monkeypatch.chdir("/")
    assert loads(dump(mine)) == mine
    by_name = read(TRACE)
    assert by_name.network.trace.file == "gusty-wind.csv"
    assert read(f"trace: {{file: {find_data('gusty-wind.csv')}}}") == by_name


def test_error_of_many_links_is_reported_once():
    three = [
        "fleet=[{name: a, aircraft: rascal110, start_m: [-9, 9, 0]}, {name: b, aircraft: "
        "rascal110, start_m: [-9, -9, 0]}, {name: c, aircraft: rascal110, start_m: [-20, 0, 0]}]",
        "formation.offsets_m={a: [-9, 9, 0], b: [-9, -9, 0], c: [-20, 0, 0]}",
    ]
    text = error_of(f"delay_s: 0.1, jitter: {{{UNIFORM}}}", three)
    assert text.count("\n") == 0
    text = error_of(
        f"delay_s: 1, jitter: {{{UNIFORM}}}, links: {{'*': {{b: {{delay_s: 0.1}}}}}}", three
    )
    assert (
        "network.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from leader to b, 0.1 s" in text
    )
    assert text.count("\n") == 0
    text = error_of(f"delay_s: 0.1, links: {{a: {{b: {{jitter: {{{UNIFORM}}}}}}}}}", three)
    assert (
        "network.links.a.b.jitter.spread_s: 0.2 s reaches 0.2 s below delay_s from a to b" in text
    )
    text = error_of(f"links: {{c: {{'*': {{jitter: {{{UNIFORM}}}}}, a: {{delay_s: 1}}}}}}", three)
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
        "broadcast: {uav1: {period_s: 0.01}, leader: {phase_s: 5}}",
    ],
)
def test_unusual_networks_are_accepted(network):
    scenario = read(network)
    assert loads(dump(scenario)) == scenario


def test_kinds_of_loss_survive_the_round_trip():
    for kind, loss in (
        (Bernoulli, "0.1"),
        (GilbertElliott, f"{{{BURSTS}}}"),
        (FourState, "{kind: four-state, p13: 0.1, p31: 0.2}"),
    ):
        scenario = read(f"loss: {loss}")
        assert type(loads(dump(scenario)).network.loss) is kind
