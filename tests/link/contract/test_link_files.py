"""The file of a link has the checks of a scenario's network, and says what to write instead."""

import os
import random

import pytest
from mutations import mutate
from places import ROOT

import testbed
from testbed.core.errors import InputError
from testbed.link.link_file import load_link_file
from testbed.link.link_settings import settings_from_file, settings_from_scenario
from testbed.network.single_link import SingleLink
from testbed.probes.channel_probe import probe_channel
from testbed.scenario import ScenarioError, load_scenario

# The text of a file, and what each line of the error has, with its place.
WRONG = {
    "network:\n  delay: 0.1\n": ["2:3: network.delay: is not a key", "did you mean 'delay_s'?"],
    "delay_s: 0.1\n": ["1:1: delay_s: is not a key", "write one of ends, unit, radio, positions"],
    "network:\n  loss: 30%\n": ["2:9: network.loss: is '30%'", "write 0.3"],
    "network: {loss: {kind: gilbert-elliott, p: 0, r: 0}}\n": ["p and r are both 0"],
    "network: {links: {a: {c: {loss: 0.1}}}}\n": ["no end has this name", "the ends are a, b"],
    "ends: [x, y]\nnetwork: {links: {a: {y: {loss: 0.1}}}}\n": ["the ends are x, y"],
    "network: {links: {a: {a: {loss: 0.1}}}}\n": ["is sender and receiver"],
    "ends: [x, x]\n": ["write two names"],
    "network: {partitions: [{window_s: [1, 2], groups: [[a, b]]}]}\n": ["puts all ends in one"],
    "network: {tdma: {frame_s: 0.1, order: [a]}}\n": ["has no slot for b (write every end"],
    "network: {message_bytes: 50, clocks: {a: {offset_s: 1}}}\n": [
        "network.message_bytes: has no effect here",
        "network.clocks: has no effect here",
    ],
    "unit: frames\nnetwork: {delay_s: 0.1, reorder: 0.1}\n": ["2:34:", "frames stay in order"],
    "network: {corrupt: {probability: 0.1, bits: 2}}\n": ["write unit: frames"],
    "radio: sik\nunit: datagrams\n": ["1:8: radio: sends frames", "write unit: frames"],
    "radio: sik\nnetwork: {links: {a: {b: {rate: {bit_per_s: 9600}}}}}\n": ["no rate from b to a"],
    "radio: sik\n": ["no rate from a to b"],
    "positions: {c: {latitude_deg: 1, longitude_deg: 1}}\n": ["positions.c: no end has this name"],
    "network: {jitter: {distribution: empirical, file: nowhere.csv}}\n": ["nowhere.csv"],
    "[1, 2]\n": ["is no map of keys and values"],
    "network: {delay_s: !!python/name:os.system 1}\n": ["1:"],
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_file_is_an_error_with_its_place(text, tmp_path):
    (tmp_path / "radio.yaml").write_text(text)
    with pytest.raises(ScenarioError) as caught:
        load_link_file(tmp_path / "radio.yaml")
    assert "radio.yaml:1" in str(caught.value) or "radio.yaml:2" in str(caught.value)
    for each in WRONG[text]:
        assert each in str(caught.value)


def test_settings_change_keys_of_the_file(tmp_path):
    (tmp_path / "radio.yaml").write_text("network: {delay_s: 0.1, loss: 0.1}\n")
    file = load_link_file(tmp_path / "radio.yaml", ["network.loss=0.2", "ends=[ground, uav1]"])
    assert (file.network.delay_s, file.network.loss.probability) == (0.1, 0.2)
    assert file.ends == ("ground", "uav1") and file.unit == "datagrams"
    with pytest.raises(ScenarioError, match="--set network.los=1: network.los: is not a key"):
        load_link_file(None, ["network.los=1"])


def test_frames_are_for_ends_without_datagrams(tmp_path):
    (tmp_path / "radio.yaml").write_text("network: {}\n")
    assert load_link_file(tmp_path / "radio.yaml", unit="frames").unit == "frames"
    (tmp_path / "radio.yaml").write_text("unit: datagrams\n")
    assert load_link_file(tmp_path / "radio.yaml", unit="frames").unit == "datagrams"


def test_a_time_slot_is_that_of_its_end_both_ways():
    """In TDMA each end has the slot that it has among all, whichever way a packet goes."""
    settings = settings_from_file(load_link_file(None, ["network.tdma={frame_s: 0.1}"]))
    arrivals = []
    for sender, receiver in (settings.names, settings.names[::-1]):
        link = SingleLink(settings.network, sender, receiver, 1)
        link.send(0.001)
        arrivals.append(float(link.arrivals_s[0]))
    assert arrivals == pytest.approx([0.1, 0.05])


SETTINGS = (
    "network.loss={kind: gilbert-elliott, p: 0.1, r: 0.4}",
    "network.delay_s=0.05",
    "network.jitter={spread_s: 0.02, distribution: pareto, correlation: 0.3}",
    "network.duplicate=0.02",
    "network.rate={bit_per_s: 57600, queue_packets: 3}",
    "network.partitions=[{window_s: [20, 25], groups: [[leader, uav1], [uav2, uav3]]}]",
    "network.links.uav1.uav2.blackout_s=[[3, 4]]",
)


@pytest.mark.parametrize("between", [("leader", "uav2"), ("uav1", "uav2"), ("uav3", "uav1")])
def test_a_link_of_a_scenario_is_that_of_a_run(between):
    """The same counts, mean and longest delay, to the last digit: by a run's own radio."""
    scenario = load_scenario("simulation-3", SETTINGS)
    probe = probe_channel(scenario, 1000, record=True)
    sender, receiver = between
    row = scenario.aircraft_names.index(sender)
    settings = settings_from_scenario(scenario, between)
    link = SingleLink(settings.network, sender, receiver, settings.seed)
    for sent_s in probe.messages.sent_s[:, row].tolist():
        link.send(sent_s, scenario.network.message_bytes)
    own, found = probe.summary["links"][sender][receiver], link.summary()
    assert found["delay_s"] == own["delay_s"] and found["delay_s"]["max"] > 0.06
    for key in ("sent", "delivered", "lost", "duplicated", "bursts"):
        assert found[key] == own[key]
    assert found["lost"]["lost"] > 100 and found["duplicated"] > 5
    other = SingleLink(settings.network, receiver, sender, settings.seed)
    for sent_s in probe.messages.sent_s[:, row].tolist():
        other.send(sent_s, scenario.network.message_bytes)
    assert other.summary()["delay_s"] != own["delay_s"]


@pytest.mark.skipif("TESTBED_LINK_PACKETS" not in os.environ, reason="TESTBED_LINK_PACKETS=10000")
def test_a_link_is_that_of_a_whole_flight():
    """100 s of Simulation 3: 2,500 packets, against the metrics of the run."""
    scenario = load_scenario("simulation-3", SETTINGS)
    run = testbed.run(scenario, duration_s=100.0, write=False)
    own = run.metrics["network"]["links"]["leader"]["uav1"]
    settings = settings_from_scenario(scenario, ("leader", "uav1"))
    link = SingleLink(settings.network, "leader", "uav1", settings.seed)
    for k in range(own["sent"]):
        link.send(0.04 * k, scenario.network.message_bytes)
    found = link.summary()
    for key in ("sent", "delivered", "lost", "duplicated", "bursts", "delay_s"):
        assert found[key] == own[key], key
    assert own["sent"] >= 2500 and own["delay_s"]["max"] > 0.1


MUTATIONS = int(os.environ.get("TESTBED_LINK_NOISE", "150"))


def test_a_mutated_file_is_used_or_is_one_error(tmp_path):
    """No other exception, and every accepted link carries packets."""
    rng, file = random.Random(5), tmp_path / "radio.yaml"
    whole = (ROOT / "examples" / "sik-57600.yaml").read_bytes() + MORE
    used = 0
    for _ in range(MUTATIONS):
        file.write_bytes(mutate(whole, ".yaml", rng)[0])
        try:
            settings = settings_from_file(load_link_file(file, unit="frames"))
            links = [
                SingleLink(settings.network, *names, settings.seed, in_order=settings.frames)
                for names in (settings.names, settings.names[::-1])
            ]
        except InputError as error:
            assert "radio.yaml" in str(error) or "delay_s" in str(error)
            continue
        used += 1
        for link in links:
            for k in range(4):
                link.send(0.01 * k, 40)
                assert not (link.arrivals_s < 0.01 * k).any()
    assert 0.1 * MUTATIONS < used < 0.9 * MUTATIONS


MORE = b"""ends: [a, b]
positions: {a: {latitude_deg: 38.0, longitude_deg: 0.0, height_m: 300.0}}
"""
