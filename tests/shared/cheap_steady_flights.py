"""Steady flights at less cost, for modules of tests that import the fixture.

What the leader demands of its slots is looked at less often: one that goes straight or turns
steadily demands the same at all times, and tests of plan have what is found in others. And a flight
may be found to be steady sooner.
"""

import pytest
from cases import ALL


@pytest.fixture(scope="module", autouse=True)
def cheap_steady_flights():
    """For all tests of a module."""
    with pytest.MonkeyPatch.context() as patch:
        if not ALL:
            patch.setattr("testbed.plan.leader.MAX_CHECKED", 500)
            patch.setattr("testbed.linear.steady_flight.SETTLE_S", 40.0)
        yield
