"""Measured traces: at their own rate they give their own outcomes; wrong files are named."""

import numpy as np
import pytest

from testbed.core.errors import InputError
from testbed.network.links import resolve_links
from testbed.network.trace import TraceFile, make_replays, replayed_delays, trace_delay
from testbed.scenario.network import Network

NAMES = ("leader", "uav1", "uav2")


def write(path, text):
    path.write_text(text)
    return path


def random_trace(path, seed, *, rows=200, period_s=0.1, jitter_s=0.0, first_s=0.0):
    """A file of one link; returns delays, infinite where lost."""
    rng = np.random.default_rng(seed)
    delay = np.where(rng.random(rows) < 0.3, np.inf, rng.uniform(0.01, 0.3, rows))
    sent = first_s + period_s * np.arange(rows) + rng.uniform(-jitter_s, jitter_s, rows)
    lines = [
        f"{s!r},{s + d!r}" if np.isfinite(d) else f"{s!r},"
        for s, d in zip(sent.tolist(), delay.tolist(), strict=True)
    ]
    write(path, "\n".join(["sent_s,received_s", *lines]))
    return delay


def same(delay, expected, within=1e-9):
    lost = np.isinf(expected)
    return np.array_equal(np.isinf(delay), lost) and np.allclose(
        delay[~lost], expected[~lost], rtol=0, atol=within
    )


# 0.04 s is no binary number; stamps since 1970 have 0.2 us to spare; a real sender is never even.
@pytest.mark.parametrize(
    "recorded",
    [
        {},
        {"period_s": 0.04},
        {"first_s": 1.7e9},
        {"first_s": -3.0},
        {"jitter_s": 0.02},
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_trace_at_its_own_pace_gives_its_outcomes(recorded, seed, tmp_path):
    delay = random_trace(tmp_path / "t.csv", seed, **recorded)
    trace = TraceFile(tmp_path / "t.csv").trace("leader", "uav1")
    times = trace.earliest_s + np.arange(200) * recorded.get("period_s", 0.1)
    # the first row may have been sent off its beat, and begins the replay
    within = 1e-6 if "first_s" in recorded else 1e-9
    assert same(trace_delay(trace, times), delay, within)
    if not recorded.get("jitter_s"):
        assert trace.span_s == pytest.approx(200 * recorded.get("period_s", 0.1))
        for lap in (1, 2, 1000):
            assert same(trace_delay(trace, times + lap * trace.span_s), delay, within), lap


@pytest.mark.parametrize("begin_s", [5.0, 5.02, -15.0])
def test_trace_with_offset_is_the_same_trace_later(begin_s, tmp_path):
    delay = random_trace(tmp_path / "t.csv", 7)
    trace = {"file": str(tmp_path / "t.csv"), "begin_s": begin_s}
    replays = make_replays(resolve_links(NAMES, Network.model_validate({"trace": trace})), seed=1)
    assert len(replays.traces) == 1, "links that replay one file share what was read"
    row = np.array([0])
    found = [replayed_delays(replays, np.array([0.1 * k]), row)[0, 0] for k in range(200)]
    assert same(np.array(found), np.roll(delay, -50))


def test_links_of_one_file_share_its_time(tmp_path):
    """One link's rows begin later, and both have an outage from 50 s to 55 s."""
    rows = ["source,destination,sent_s,received_s"]
    for destination, first, period in (("uav1", 0.0, 0.1), ("uav2", 30.0, 0.25)):
        for sent in np.arange(first, 100.0, period).round(6).tolist():
            arrived = "" if 50.0 <= sent < 55.0 else sent + 0.01
            rows.append(f"leader,{destination},{sent},{arrived}")
    path = write(tmp_path / "t.csv", "\n".join(rows))
    network = Network.model_validate({"links": {"leader": {"*": {"trace": {"file": str(path)}}}}})
    replays = make_replays(resolve_links(NAMES, network), seed=1)
    for lap in (0.0, 100.0, 300.0):
        for at, lost in ((49.7, False), (50.3, True), (54.7, True), (55.3, False)):
            delay = replayed_delays(replays, np.array([lap + at]), np.array([0]))[:, 0]
            assert np.isinf(delay).tolist() == [lost, lost], (lap, at)


def test_message_takes_the_row_nearest_in_time(tmp_path):
    path = write(tmp_path / "t.csv", "sent_s,received_s\n10,10.1\n11,11.2\n14,\n15,15.4\n")
    trace = TraceFile(path).trace("leader", "uav1")
    assert trace.span_s == 6.0  # the median of 1, 3 and 1 after the last
    times = 10.0 + np.array([0.0, 0.49, 0.51, 1.0, 2.49, 2.51, 4.49, 4.51, 5.49, 5.51, 6.0, 7.0])
    expected = np.array([0.1, 0.1, 0.2, 0.2, 0.2, np.inf, np.inf, 0.4, 0.4, 0.1, 0.1, 0.2])
    assert same(trace_delay(trace, times), expected)


LINKS = """# measured
sequence,source,destination,sent_s,received_s,outcome,copies
0,leader,uav1,0,0.01,delivered,1
0,leader,uav2,0,,lost,0
1,leader,uav1,1,1.02,delivered,2
1,leader,uav2,1,1.03,delivered,1
0,uav1,uav2,0.5,0.54,delivered,1
1,uav1,uav2,1.5,,corrupted,0
"""


def test_each_link_of_a_file_has_its_own_rows(tmp_path):
    path = write(tmp_path / "t.csv", LINKS)
    for source, destination, delay in (
        ("leader", "uav1", [0.01, 0.02]),
        ("leader", "uav2", [np.inf, 0.03]),
        ("uav1", "uav2", [0.04, np.inf]),
    ):
        trace = TraceFile(path).trace(source, destination)
        begins = 0.5 if source == "uav1" else 0.0
        assert trace.sent_s.tolist() == [begins, begins + 1.0]
        assert (trace.earliest_s, trace.span_s) == (0.0, 2.0)
        assert same(trace.delay_s, np.array(delay))


def test_link_without_trace_has_delay_nan(tmp_path):
    path = write(tmp_path / "t.csv", LINKS)
    network = {"links": {"leader": {"*": {"trace": {"file": str(path)}}}}}
    replays = make_replays(resolve_links(NAMES, Network.model_validate(network)), seed=1)
    delay = replayed_delays(replays, np.array([0.0, 0.0, 5.0]), np.arange(3))
    assert np.allclose(delay[0], [0.01, np.nan, np.nan], equal_nan=True)
    assert np.array_equal(delay[1], [np.inf, np.nan, np.nan], equal_nan=True)
    later = replayed_delays(replays, np.array([5.0, 3.0]), np.array([2, 0]))
    assert np.allclose(later, [[np.nan, 0.02], [np.nan, 0.03]], equal_nan=True)
    assert make_replays(resolve_links(NAMES, Network()), seed=1) is None


def test_random_start_depends_on_seed_and_link(tmp_path):
    random_trace(tmp_path / "t.csv", 9)
    network = Network.model_validate(
        {"trace": {"file": str(tmp_path / "t.csv"), "random_start": True}}
    )
    begin = make_replays(resolve_links(NAMES, network), seed=1).begin_s
    own = np.array([[False, True, False], [False, False, True]])
    assert (begin[own] == 0.0).all()
    assert len(set(begin[~own])) == 4
    assert (0.0 < begin[~own]).all() and (begin[~own] < 20.0).all()
    assert np.array_equal(make_replays(resolve_links(NAMES, network), seed=1).begin_s, begin)
    assert (make_replays(resolve_links(NAMES, network), seed=2).begin_s != begin)[~own].all()
    more = make_replays(resolve_links((*NAMES, "uav3"), network), seed=1).begin_s
    assert np.array_equal(more[:2, :3], begin)


WRONG = [
    ("t_s,received_s\n0,1\n", ":1: missing column sent_s; write sent_s and received_s in the hea"),
    ("sent_s\n0\n1\n", ":1: missing column received_s; write"),
    ("source,sent_s,received_s\nleader,0,1\n", ":1: source without the other end; write both sou"),
    (
        "source,destination,sent_s,received_s\nlead,uav1,0,1\nlead,uav2,0,1\n",
        ":1: no row is from leader to uav1; it has lead to uav1, lead to uav2 (rename these, or gi",
    ),
    ("source,destination,sent_s,received_s\n", ":1: no row is from leader to uav1; it has no rows"),
    ("sent_s,received_s\n0,1\n", ":1: fewer than two rows; a trace needs two, to have a rate"),
    ("sent_s,received_s\n0,1\n1,2,3\n", ":3: 3 values under 2 columns; write one value per column"),
    ("sent_s,received_s\n0,1\n,2\n", ":3: sent_s is empty; write a number or remove the row"),
    (
        "sent_s,received_s\n0,lost\n1,2\n",
        ":2: received_s is 'lost'; write a number",
    ),
    ("sent_s,received_s\n0,1\n1,nan\n", ":3: received_s is nan; remove the row or write a finite"),
    (
        "# a\nsent_s,received_s\n0,1\n\n2,3\n1,4\n",
        ":6: sent_s goes from 2 to 1 after line 5; sort the rows by sent_s, or name source and des",
    ),
    ("sent_s,received_s\n0,\n1,1.5\n2,1.75\n", ":4: received 0.25 s before it was sent; correct"),
    (
        "source,destination,sent_s,received_s\n"
        "leader,uav1,0,1\nuav2,uav1,5,6\nleader,uav1,2,3\nuav2,uav1,4,7\nleader,uav1,1,2\n",
        ":6: sent_s goes from 2 to 1 after line 4",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_wrong_trace_is_refused_with_line_and_remedy(text, message, tmp_path):
    path = write(tmp_path / "t.csv", text)
    with pytest.raises(InputError) as caught:
        TraceFile(path).trace("leader", "uav1")
    assert str(caught.value).startswith(f"{path}{message}")
