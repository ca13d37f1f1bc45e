"""Flight models that run only when somebody asks for them fly as those that always do."""

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
def test_to_follow_later_changes_nothing(name, changes, monkeypatch):
    page = shorten(load(name, changes), 8.0)
    step, behind = JsbsimFleet.step, []

    def counted(fleet, surfaces, ticks, wanted=None):
        behind.append(wanted is not None and not all(wanted))
        step(fleet, surfaces, ticks, wanted)

    def at_once(fleet, surfaces, ticks, wanted=None):
        step(fleet, surfaces, ticks)

    monkeypatch.setattr(JsbsimFleet, "step", counted)
    later = flown(page)
    monkeypatch.setattr(JsbsimFleet, "step", at_once)
    np.testing.assert_array_equal(later, flown(page))
    # where distances fade messages, everybody's motion is asked for
    assert any(behind) != build(page).radio.looks_around
