"""Flight models that run on to the next period at once fly as those that go step by step."""

import numpy as np
import pytest
from run_flight import Collector

import testbed
from testbed.scenario import load, shorten
from testbed.sim.world import build
from testbed.vehicle.fleet import JsbsimFleet

APART = ["rates.synchronous=false"]
FADING = [*APART, "network.range_loss=[[0, 0.0], [5, 0.5], [50, 1.0]]"]


def flown(page):
    seen = Collector()
    testbed.run(page, write=False, observers=[seen])
    records = [(f.truth, f.estimate, f.air, f.command, f.links) for f in seen.frames]
    return np.array([np.concatenate([np.ravel(a) for r in of for a in r]) for of in records])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("bursty-wifi", []),
        ("mixed-fleet", APART),
        ("simulation-3", FADING),
        ("turbulence-moderate", [*APART, "fleet.*.sensors=pixhawk"]),
        ("engine-out-uav2", [*APART, "fleet.1.faults.0.at_s=3"]),
    ],
)
def test_to_run_ahead_changes_nothing(name, changes, monkeypatch):
    page = shorten(load(name, changes), 8.0)
    step, most, fewest = JsbsimFleet.step, 0, 99

    def counted(fleet, surfaces, ticks, legs=()):
        nonlocal most, fewest
        most = max(most, len(legs))
        fewest = min([fewest, *(sum(leg.wanted) for leg in legs if leg.wanted is not None)])
        step(fleet, surfaces, ticks, legs)

    def one_by_one(fleet, surfaces, ticks, legs=()):
        step(fleet, surfaces, ticks)

    monkeypatch.setattr(JsbsimFleet, "step", counted)
    ahead = flown(page)
    monkeypatch.setattr(JsbsimFleet, "step", one_by_one)
    np.testing.assert_array_equal(ahead, flown(page))
    assert most > 1
    # where distances fade messages, everybody's motion is asked for
    assert (fewest < len(page.aircraft)) != build(page).radio.looks_around
