"""Steady flights at less cost: what the leader demands of its slots is looked at less often.

The motion of a leader that goes straight or turns steadily is the same at all times; tests of plan
have what is found in others.
"""

import pytest
from cases import ALL


@pytest.fixture(scope="module", autouse=True)
def coarse_leaders():
    """For all tests of a module that imports it."""
    with pytest.MonkeyPatch.context() as patch:
        if not ALL:
            patch.setattr("testbed.plan.leader.MAX_CHECKED", 500)
        yield
