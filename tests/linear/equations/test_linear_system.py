"""Linear systems with names: by hand, by other libraries, and by their closed loops."""

import json
import math
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import dfreqresp
from slow_control import RATES
from small_study import in_this_process

import testbed
from testbed.core.errors import InputError
from testbed.linear.held_flight import COMMANDS
from testbed.linear.linear_system import LinearSystem, append

DT = 0.04
HZ = np.geomspace(0.01, 12.0, 50)
Z = np.exp(2j * np.pi * HZ * DT)
PRINTED = ("simulation-3", "simulation-1")[: 1 + int(os.environ.get("TESTBED_MARGINS", "0"))]


def system(a, b, c, d, inputs, outputs, *, part="x"):
    """Return a system of one part."""
    states = tuple(f"{part}.{k}" for k in range(len(a)))
    arrays = (np.array(each, dtype=float) for each in (a, b, c, d))
    return LinearSystem(*arrays, DT, states, tuple(inputs), tuple(outputs))


def first_order(pole, part, source, outputs, direct=0.0):
    """Return 0.1 / (z - pole) + d from an input to an output."""
    return system([[pole]], [[0.1]], [[1.0]], [[direct]], [source], outputs, part=part)


def second_order():
    """Return a system of two states with a direct part."""
    return system(
        *([[0.9, 0.1], [-0.2, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.3]]),
        *(["uav1.roll"], ["uav1.bank"]),
        part="uav1",
    )


def response_by_hand(z):
    return 0.1 / ((z - 0.9) * (z - 0.8) + 0.02) + 0.3


def random_system(inputs, outputs, part, *, states=4, seed=1):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(states, states))
    a *= 0.8 / np.abs(np.linalg.eigvals(a)).max()
    b, c = rng.normal(size=(states, len(inputs))), rng.normal(size=(len(outputs), states))
    return system(a, b, c, np.zeros((len(outputs), len(inputs))), inputs, outputs, part=part)


def test_response_of_two_states_by_hand():
    found = second_order().frequency_response(HZ)
    assert found.shape == (50, 1, 1)
    assert found[:, 0, 0] == pytest.approx(response_by_hand(Z))
    wrong = replace(second_order(), d=np.zeros((1, 1))).frequency_response(HZ)
    assert not np.allclose(wrong[:, 0, 0], response_by_hand(Z))


def test_scipy_has_the_same_response():
    _, found = dfreqresp(second_order().to_scipy(), w=2.0 * np.pi * HZ * DT)
    assert found == pytest.approx(response_by_hand(Z))


def test_control_has_the_same_response():
    """And the names, without dots."""
    pytest.importorskip("control")
    model = second_order().to_control()
    assert (model.input_labels, model.output_labels) == (["uav1_roll"], ["uav1_bank"])
    assert model.state_labels == ["uav1_0", "uav1_1"] and model.dt == DT
    assert model(Z) == pytest.approx(response_by_hand(Z))


@pytest.mark.parametrize("scenario", ["simulation-1", "simulation-3"])
def test_margins_of_control_are_ours(scenario):
    """Of three commands to four digits, by `frd`; a state space has others."""
    control = pytest.importorskip("control")
    system = testbed.linearise(scenario, bank_deg=30.0)
    for command in COMMANDS:
        loop = system.loop(f"uav2.{command}")
        own, response = loop.margins(), loop.frd()
        assert response.input_labels == [f"uav2_{command}"] and response.dt == loop.dt
        gain, phase_deg, distance, *_ = control.stability_margins(response)
        found = own.gain, own.phase_deg, own.distance
        assert (gain, phase_deg, distance) == pytest.approx(found, rel=5e-5)


def test_control_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    for convert in (second_order().to_control, second_order().frd):
        with pytest.raises(InputError, match="pip install control"):
            convert()


@pytest.mark.parametrize("late", [0, 1, 3])
def test_connect_is_a_product_with_a_delay(late):
    """Of the two responses and z^-late; not of one more or less."""
    one = first_order(0.9, "x", "u", ["x.out"])
    other = first_order(0.7, "y", "y.in", ["y.out"])
    joined = append([one, other]).connect("x.out", "y.in", late=late)
    assert joined.inputs == ("u",) and joined.outputs == ("x.out", "y.out")
    assert joined.states[2:] == tuple(f"x.out.{k + 1}" for k in range(late))
    found = joined.select(outputs="y.out").frequency_response(HZ)[:, 0, 0]
    product = 0.1 / (Z - 0.9) * 0.1 / (Z - 0.7)
    assert found == pytest.approx(product * Z**-late)
    assert not np.allclose(found, product * Z ** -(late + 1.0))


def test_messages_turn_under_way():
    """By the matrix of a step for each step."""
    c, s = math.cos(0.3), math.sin(0.3)
    turned = np.array([[c, s], [-s, c]])
    one = random_system(["u"], ["x.out.a", "x.out.b"], "x")
    other = random_system(["y.in.b", "y.in.a"], ["y.y"], "y", seed=2)
    joined = append([one, other]).connect("x.out", "y.in", late=2, turned=turned)
    found = joined.select(outputs="y").frequency_response(HZ)
    into = other.select(["y.in.a", "y.in.b"]).frequency_response(HZ)
    late = Z[:, np.newaxis, np.newaxis] ** -2
    product = late * (into @ turned @ turned @ one.frequency_response(HZ))
    assert found == pytest.approx(product)
    assert not np.allclose(found, late * (into @ turned @ one.frequency_response(HZ)))


def test_connected_loop_with_a_direct_part():
    """A loop through d: H = G / (1 - G K), with u added to what is fed back."""
    plant = first_order(0.9, "x", "x.in", ["x.out"], 0.5)
    gain = system(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, -0.6]], ["u", "k"], ["k.out"]
    )
    joined = append([plant, gain]).connect("k.out", "x.in").connect("x.out", "k")
    found = joined.select(outputs="x.out").frequency_response(HZ)[:, 0, 0]
    own = 0.1 / (Z - 0.9) + 0.5
    assert found == pytest.approx(own / (1.0 + 0.6 * own))


def test_receivers_share_messages_under_way():
    sender = first_order(0.9, "x", "u", ["x.out"])
    others = [first_order(0.5, name, f"{name}.in", [f"{name}.out"]) for name in ("y", "z")]
    joined = append([sender, *others]).connect("x.out", "y.in", late=3)
    joined = joined.connect("x.out", "z.in", late=2)
    assert len(joined.states) == 3 + 3
    found = joined.frequency_response(HZ)[..., 0]
    assert found[:, 2] == pytest.approx(found[:, 1] * Z)
    with pytest.raises(InputError, match=r"x\.out\.1 is turned otherwise"):
        append([joined, first_order(0.5, "w", "w.in", ["w.out"])]).connect(
            "x.out", "w.in", late=1, turned=np.array([[0.5]])
        )


def test_append_has_one_input_of_a_name():
    joined = append([first_order(0.9, "x", "u", ["x.o"]), first_order(0.7, "y", "u", ["y.o"])])
    assert joined.inputs == ("u",) and joined.outputs == ("x.o", "y.o")
    found = joined.frequency_response(HZ)[..., 0]
    assert found.T == pytest.approx(np.array([0.1 / (Z - 0.9), 0.1 / (Z - 0.7)]))


def test_loop_opens_a_command_with_a_direct_part():
    """Closed y = T v is y = G (v + y), so L = -G = -T / (1 + T)."""
    closed = replace(second_order(), inputs=("uav1.roll",), outputs=("uav1.roll",))
    own = response_by_hand(Z)
    found = closed.loop("uav1.roll").frequency_response(HZ)[:, 0, 0]
    assert found == pytest.approx(-own / (1.0 + own))
    assert not np.allclose(found, own / (1.0 + own))


def test_loop_keeps_what_is_unstable():
    """A state that the loop does not see makes the flight unstable, so there are no margins."""
    own = second_order()
    bank = replace(own, d=np.zeros((1, 1)), outputs=("uav1.roll",))
    assert len(bank.loop("uav1.roll").states) == 2 and bank.loop("uav1.roll").margins().gain > 1.0
    for pole, kept in ((0.99, 2), (1.01, 3)):
        hidden = append([bank, replace(first_order(pole, "uav1.h", "u", ["o"]))])
        loop = hidden.loop("uav1.roll")
        assert len(loop.states) == kept
        assert (loop.margins()[:4] == (1.0, 1.0, 0.0, 0.0)) is (kept == 3)


def test_modes_by_hand():
    """A pole r exp(iθ) is one of log(r) / dt ± iθ / dt."""
    r, angle = 0.95, 0.2
    c, s = r * math.cos(angle), r * math.sin(angle)
    own = system([[c, s], [-s, c]], np.zeros((2, 1)), [[1.0, 0.0]], [[0.0]], "u", ["x.o"], part="x")
    other = first_order(0.5, "y", "u", ["y.o"])
    first, second = append([other, own]).modes()
    pole = complex(math.log(r), angle) / DT
    assert first.pole == pytest.approx(pole) and first.follower == "x" and first.motion == ""
    assert first.frequency_hz == pytest.approx(pole.imag / (2.0 * math.pi))
    assert first.damping == pytest.approx(-pole.real / abs(pole))
    assert (second.frequency_hz, second.damping, second.follower) == (0.0, 1.0, "y")


def test_coupled_parts_are_circles_of_the_graph():
    """Of x to y and back, and y to z: z is by itself."""
    parts = [
        first_order(0.5, "x", "x.in", ["x.out"]),
        first_order(0.6, "y", "y.in", ["y.out"]),
        first_order(0.7, "z", "z.in", ["z.out"]),
    ]
    joined = append(parts).connect("x.out", "y.in", late=2).connect("y.out", "z.in")
    assert joined.coupled_parts() == (("x",), ("y",), ("z",))
    joined = joined.connect("y.out", "x.in", late=1)
    assert joined.coupled_parts() == (("x", "y"), ("z",))
    own = joined.coupled_with("y")
    assert own.outputs == ("x.out", "y.out") and len(own.states) == 2 + 3


@pytest.mark.parametrize("command", COMMANDS)
def test_reduced_system_has_the_margins(formation, command):
    """To a thousandth, with a third of the states, and the closed loop is stable."""
    name = f"uav2.{command}"
    own = formation.coupled_with("uav2").select(name, name)
    small = own.reduced()
    assert len(small.states) < 0.3 * len(own.states) and small.is_stable()
    expected = own.loop(name).margins()
    assert tuple(small.loop(name).margins()) == pytest.approx(tuple(expected), rel=1e-3, abs=1e-4)
    rough = own.reduced(0.1).loop(name).margins()
    assert rough.distance != pytest.approx(expected.distance, rel=1e-3)


def test_reduced_keeps_responses_within_its_bound():
    """Twice the sum of the Hankel singular values left out; and what never moves is taken off."""
    full = random_system(["u", "v"], ["x.o", "x.p"], "x", states=12)
    frozen = append([full, first_order(1.0, "x.frozen", "w", ["x.q"])]).select(
        ["u", "v"], ["x.o", "x.p"]
    )
    small = frozen.reduced(0.05)
    p = solve_discrete_lyapunov(full.a, full.b @ full.b.T)
    q = solve_discrete_lyapunov(full.a.T, full.c.T @ full.c)
    hankel = np.sort(np.sqrt(np.linalg.eigvals(p @ q).real))[::-1]
    kept = int((hankel > 0.05 * hankel[0]).sum())
    assert len(small.states) == kept < 12
    error = small.frequency_response(HZ) - full.frequency_response(HZ)
    largest = np.linalg.norm(error, ord=2, axis=(1, 2)).max()
    assert 0.0 < largest <= 2.0 * hankel[kept:].sum()
    assert len(frozen.reduced(1e-12).states) == 12


def test_poles_with_factors_by_hand():
    """Of L = 0.1 / (z - 0.9): the closed loop has z = 0.9 - 0.1 g."""
    loop = first_order(0.9, "x", "u", ["x.o"])
    found = loop.poles_with_factors([0.0, 1.0, 4.0])
    assert np.exp(found[:, 0] * DT) == pytest.approx([0.9, 0.8, 0.5])
    direct = replace(loop, d=np.array([[0.5]])).poles_with_factors([2.0])
    assert np.exp(direct[0, 0] * DT) == pytest.approx(0.9 - 0.2 / 2.0)


def test_without_unread_keeps_the_response():
    chain = append(
        [first_order(0.5, "x", "u", ["x.out"]), first_order(0.6, "y", "y.in", ["y.out"])]
    )
    chain = chain.connect("x.out", "y.in")
    assert chain.select(outputs="y.out").without_unread().states == ("x.0", "y.0")
    own = chain.select(outputs="x.out").without_unread()
    assert own.states == ("x.0",)
    assert own.frequency_response(HZ)[:, 0, 0] == pytest.approx(0.1 / (Z - 0.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: x.select("uav1.rol"), r"inputs: there is no uav1.rol \(write uav1.roll"),
        (lambda x: x.select(outputs=["uav2"]), "outputs: there is no uav2 .write uav1"),
        (lambda x: x.select("bank"), "inputs: there is no bank"),
        (lambda x: x.loop("uav1"), "outputs: there is no uav1 .write uav1.roll"),
        (lambda x: x.loop("uav1.bank"), "inputs: there is no uav1.bank"),
        (lambda x: x.coupled_with("uav3"), "states: there is no uav3 .write uav1"),
        (lambda x: x.margins(), "margins: 2 inputs and 2 outputs are no loop"),
        (lambda x: x.poles_with_factors([1.0]), "poles_with_factors: 2 inputs and 2 outputs"),
        (lambda x: x.reduced(0.0), "tolerance: is 0.0 .write a number between 0 and 1"),
        (
            lambda x: append([x, first_order(1.0, "y", "uav1.roll", ["y.sum"])]).reduced(),
            "y.sum does not come to rest after uav1.roll",
        ),
        (lambda x: x.connect("uav1.roll", "uav1.roll", late=-1), "late: is -1"),
        (lambda x: x.connect("uav1", "uav1", late=1), "uav1.gust has no output uav1.gust"),
        (lambda x: x.connect("uav1.roll", "uav1.roll", turned=np.eye(2)), "turned: has the shape"),
        (lambda x: append([x, x]), "states: uav1.0 stands twice"),
        (lambda x: append([x, replace(x, dt=1.0)]), "control periods differ"),
        (lambda x: replace(x, b=x.b[:1]), r"b: has the shape \(1, 2\) \(write \(4, 2\)"),
        (lambda x: replace(x, d=x.d - 1.0).loop("uav1.roll"), "1 [+] d is 0"),
        (lambda x: replace(x, d=x.d + 1.0).connect("uav1.roll", "uav1.roll"), "at once"),
    ],
)
def test_system_refuses(call, message):
    """Each error has what to write."""
    own = random_system(["uav1.roll", "uav1.gust"], ["uav1.roll", "uav1.bank"], "uav1")
    with pytest.raises(InputError, match=message):
        call(own)


@pytest.fixture(scope="module")
def formation():
    return testbed.linearise("simulation-3", RATES)


def closed(loop, gain, late):
    """Return a loop closed with a factor and a latency, in periods."""
    scaled = replace(loop, c=-gain * loop.c, d=-gain * loop.d)
    [name] = loop.inputs
    return scaled.connect(name, name, late=late)


@pytest.mark.parametrize("command", COMMANDS)
def test_margins_are_those_of_closed_loops(formation, command):
    """A pole leaves the unit circle at the factor, and at the latency."""
    loop = formation.loop(f"uav2.{command}")
    margins = loop.margins()
    for factor, stable in ((0.999, True), (1.001, False)):
        assert closed(loop, factor * margins.gain, 0).is_stable() is stable
    periods = int(margins.latency_s / loop.dt)
    assert closed(loop, 1.0, periods).is_stable()
    assert not closed(loop, 1.0, periods + 1).is_stable()


def test_loop_is_small(formation):
    """Without the other followers, of which none receives from it and sends to it."""
    loop = formation.loop("uav1.roll")
    assert {name.split(".")[0] for name in loop.states} == {"uav1"}
    assert 20 < len(loop.states) < len(formation.coupled_with("uav1").states)
    assert loop.dt == (0.04 if ALL else 0.1)
    text = f"LinearSystem({len(loop.states)} states, 1 inputs, 1 outputs, dt={loop.dt:g})"
    assert repr(loop) == text


@in_full  # the command beside studies, and margins of a loop beside its closed loop, are tested
@pytest.mark.parametrize("name", PRINTED)
def test_margins_are_those_printed(name, formation, tmp_path):
    """By `testbed margins`, of all followers and commands."""
    words = "margins", name, "--bank", "0", "--jobs", "1", "--json", "m.json"
    with in_this_process():
        call_command(*words, cwd=tmp_path, code=0, columns=80)
    printed = json.loads((tmp_path / "m.json").read_text())
    system = formation if name == "simulation-3" else testbed.linearise(name)
    [bank] = printed["predicted"]
    for follower in bank["followers"]:
        for command, expected in follower["commands"].items():
            found = system.loop(f"{follower['name']}.{command}").margins()._asdict()
            finite = {key: each if math.isfinite(each) else None for key, each in found.items()}
            assert finite == pytest.approx(expected, rel=1e-4)
    assert len(bank["followers"]) == 3


def test_modes_do_not_depend_on_the_order_of_states():
    """Also with messages under way, whose eigenvectors are almost the same."""
    late = testbed.linearise("simulation-1", ["network.delay_s=0.12"], bank_deg=30)
    order = np.random.default_rng(1).permutation(len(late.states))
    states = tuple(late.states[k] for k in order)
    a, b, c = late.a[np.ix_(order, order)], late.b[order], late.c[:, order]
    others = replace(late, a=a, b=b, c=c, states=states).modes()
    # faster ones are those of the messages alone, and of rounding
    modes = [mode for mode in late.modes() if abs(mode.pole) < 100.0]
    assert len(modes) > 50
    for mode in modes:
        other = min(others, key=lambda each: abs(each.pole - mode.pole))
        assert (other.follower, other.motion) == (mode.follower, mode.motion)


def test_old_name_of_the_class(formation):
    with pytest.warns(DeprecationWarning, match=r"testbed\.LinearSystem"):
        assert testbed.StateSpace is testbed.LinearSystem
    assert isinstance(formation, testbed.LinearSystem)
