"""Margins with other gains, of one steady flight."""

import pytest
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from slow_control import RATES

import testbed
from testbed.core.errors import InputError

GAINS = ("controller.gains.course.p=5", "formation.k=2", "formation.neighbour_gains.uav3.uav2=3")


@pytest.fixture(scope="module")
def scan():
    """Return a scan of a steady turn."""
    return testbed.GainScan("simulation-3", RATES, bank_deg=30.0)


def numbers(margins):
    """Return factor and latency of the roll and throttle commands of all followers."""
    return [
        number
        for commands in margins.values()
        for name in ("roll", "throttle")
        for number in (commands[name].gain, commands[name].latency_s)
    ]


def test_scan_has_the_margins_of_a_flight(scan):
    """With the gains of the flight, and with others those of a flight with them."""
    own = testbed.linearise("simulation-3", (*RATES, *GAINS), bank_deg=30.0)
    assert len(own.a) == len(scan.formation().a)
    flown = {
        name: {each: own.loop(f"{name}.{each}").margins() for each in ("roll", "throttle")}
        for name in ("uav1", "uav2", "uav3")
    }
    found = numbers(scan.margins(GAINS))
    assert found == pytest.approx(numbers(flown), rel=0.05)
    # the gains matter, and the scan forgets them
    assert found != pytest.approx(numbers(scan.margins()), rel=0.05)
    assert numbers(scan.margins(GAINS)) == found


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("network.delay_s=0.2", "changes more than gains"),
        ("formation.neighbour_gains.uav3.uav2=0", "changes which messages are used"),
        ("fleet.*.aircraft=skywalker_x8", "changes more than gains"),
        ("controller.gains.course.q=5", "course.q"),
    ],
)
def test_scan_changes_gains_alone(scan, override, message):
    """Everything else needs another flight."""
    with pytest.raises(InputError, match=message):
        scan.margins([override])
