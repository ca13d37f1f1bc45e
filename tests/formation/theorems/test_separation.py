"""The separation filter keeps what (F1) promises, on ideal aircraft and on Rascals.

TESTBED_SEPARATION=10000 flies as many encounters of ideal aircraft, and a tenth of them of Rascals.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from cases import ALL, in_full
from separation_encounters import CROSSINGS, DT, HEAD_ON, encounters

import testbed
from testbed.core.records import FOLLOWER, allocate
from testbed.formation.hbh23 import reach_velocity, write_inputs
from testbed.formation.paper_law import make_paper_law
from testbed.formation.separation_filter import desired_acceleration

COUNT = int(os.environ.get("TESTBED_SEPARATION", "120"))
RASCALS = max(COUNT // 10, 12) if ALL else 3
OF_LARGE_SAMPLES = [] if "TESTBED_SEPARATION" in os.environ else [in_full]
SEPARATION_M = 6.0
LATE = {"lag": 0.4, "delay_s": 0.2, "loss": 0.2}  # roll lag and messages
DATA = Path(__file__).parents[2] / "data"


def test_distance_of_exact_flight_is_exponential():
    """Both fly at their filtered velocities, at each other: d − D falls as exp(−α t) at most."""
    rate, distances = 0.3, np.zeros(500)
    encounters(1, HEAD_ON, lag=-1.0, margin_m=0.0, rate=rate, seconds=20.0, distances=distances)
    left = distances - SEPARATION_M
    steps = np.arange(len(left))
    # of steps of Euler: exp(−α t) for short ones
    least = left[0] * (1.0 - rate * DT) ** steps
    assert left.min() > 0.0
    assert (left >= least - 1e-6).all()


def test_twice_the_rate_breaks_the_exponential():
    """The control: each with β = 1 in place of 1/2 closes twice as fast."""
    rate, distances = 0.3, np.zeros(500)
    encounters(
        1, HEAD_ON, lag=-1.0, margin_m=0.0, rate=2.0 * rate, seconds=20.0, distances=distances
    )
    left = distances - SEPARATION_M
    least = left[0] * (1.0 - rate * DT) ** np.arange(len(left))
    assert (left < least - 1.0).any()


@pytest.mark.parametrize(("kind", "late"), [(0, {}), (0, LATE), (CROSSINGS, {}), (CROSSINGS, LATE)])
def test_pairs_keep_separation_and_reach_their_slots(kind, late):
    """Rate 0.3 1/s and margin 1 m; slot changes behind a leader, and crossings without one."""
    closest, away = encounters(COUNT, kind, **late)
    assert closest.min() >= SEPARATION_M
    assert away.max() < 5.0


@pytest.mark.parametrize("late", [{}, LATE], ids=["exact", "late"])
def test_five_that_change_slots_keep_separation(late):
    closest, away = encounters(max(COUNT // 10, 10), n=5, **late)
    assert closest.min() >= SEPARATION_M
    assert away.max() < 5.0


@pytest.mark.parametrize("kind", [0, CROSSINGS])
def test_without_filter_or_margin_pairs_come_closer(kind):
    """The controls: without the filter, and with a rate that velocities do not follow."""
    none, _ = encounters(60, kind, filtered=0)
    fast, _ = encounters(60, kind, rate=1.0, margin_m=0.0)
    assert (none < SEPARATION_M).mean() > 0.9
    assert (fast < SEPARATION_M).any()


def test_acceleration_is_the_inverse_of_the_command():
    """ṗ_d that is found in (u, ω) is the one that they were computed from."""
    rng = np.random.default_rng(4)
    law = make_paper_law(np.zeros((1, 3)), np.zeros((1, 2))).law[0]
    out = allocate(FOLLOWER, 1)[0]
    for _ in range(100):
        v = rng.uniform([10, -12, -3], [20, 12, 3])
        v *= rng.uniform(17.0, 29.0) / np.linalg.norm(v)
        p = v + rng.uniform(-4.0, 4.0, 3)
        p *= np.clip(np.linalg.norm(p), 17.0, 29.0) / np.linalg.norm(p)
        wanted, airspeed = rng.uniform(-5.0, 5.0, 3), float(np.linalg.norm(v))
        write_inputs(reach_velocity(law, v, airspeed, tuple(p), tuple(wanted)), out)
        np.testing.assert_allclose(desired_acceleration(law, v, airspeed, out), wanted, atol=1e-8)


def fly_rascals(count, followers=2, settings=()):
    """Fly slot changes before and in a corner at 45° of bank; return the smallest distances, m.

    Returns:
        Between followers, and between a follower and the leader.
    """
    rng, rows = np.random.default_rng(7), []
    while len(rows) < count:
        starts = np.column_stack(
            [
                rng.uniform(-45.0, -20.0, followers),
                rng.uniform(4.0, 20.0, followers) * np.array([-1.0, 1.0, 1.0])[:followers],
                rng.uniform(-3.0, 3.0, followers),
            ]
        )
        east = rng.uniform(-60.0, 490.0)
        apart = np.linalg.norm(starts[:, np.newaxis] - starts, axis=2)[
            np.triu_indices(followers, 1)
        ]
        if apart.min() < 10.0:
            continue
        named = zip(("uav1", "uav2", "uav3"), starts.tolist(), strict=False)
        row = [f"fleet.{name}.start_m={start}" for name, start in named]
        rows.append([*row, f"leader.start.east_m={east:.1f}"])
    name = "separation_encounters.yaml" if followers == 2 else "separation_encounters_of_three.yaml"
    file = str(DATA / name)
    batch = testbed.Batch(file, settings, rows=rows, seeds=list(range(1, count + 1)), threads=1)
    pairs = np.triu_indices(followers, 1)
    among, behind = np.full(count, np.inf), np.full(count, np.inf)
    for k in range(1, 601):
        batch.step(until=0.1 * k)
        q = batch.aircraft["truth"]["position_ned"]
        apart = np.linalg.norm(q[:, 1:, np.newaxis] - q[:, np.newaxis, 1:], axis=3)
        among = np.minimum(among, apart[:, pairs[0], pairs[1]].min(axis=1))
        behind = np.minimum(behind, np.linalg.norm(q[:, 1:] - q[:, :1], axis=2).min(axis=1))
    batch.run()
    assert set(batch.outcomes) == {"completed"}
    return among, behind


LATE_MESSAGES = ("network.delay_s=0.2", "network.loss=0.2")


@pytest.mark.parametrize(
    ("followers", "late"),
    [
        *[pytest.param(2, late, marks=OF_LARGE_SAMPLES) for late in ((), LATE_MESSAGES)],
        (3, LATE_MESSAGES),
    ],
)
def test_rascals_keep_6_m_with_the_margin_of_the_docs(followers, late):
    among, behind = fly_rascals(RASCALS, followers, late)
    assert among.min() >= SEPARATION_M and behind.min() >= SEPARATION_M


def test_rascals_without_the_filter_come_closer():
    among, _ = fly_rascals(12 if ALL else 4, settings=("controller.safety=null",))
    assert (among < SEPARATION_M).mean() > 0.4
