"""A flight is changed by one call at a time: others are refused, and leave no trace.

Also what a forked child of a process with flights does, and what a failed flight is.
"""

import os
import signal
import threading
import time

import numpy as np
import pytest

import testbed
from testbed.core.errors import FlightError, InputError
from testbed.core.exclusive import Exclusive
from testbed.rl.hold_slot import HoldSlotEnv
from testbed.rl.vector import HoldSlotVectorEnv
from testbed.scenario import load_scenario, set_duration

SHORT = set_duration(load_scenario("simulation-3"), 4.0)
LIMIT_S = 60.0


def make_simulation():
    simulation = testbed.Simulation(SHORT)
    simulation.step(until=0.1)
    saved = simulation.save()
    calls = {
        "step": lambda: simulation.step(),
        "save": lambda: simulation.save(),
        "restore": lambda: simulation.restore(saved),
        "reset": lambda: simulation.reset(),
        "close": lambda: simulation.close(),
        "metrics": lambda: simulation.metrics,
    }
    return simulation, simulation._flight, "fly_to", lambda: simulation.step(until=2.0), calls


def make_aircraft():
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=22, duration_s=4)
    calls = {
        "step": lambda: aircraft.step(0.0, 0.3, 0.5),
        "reset": lambda: aircraft.reset(),
    }
    flight = aircraft.simulation._flight
    return aircraft, flight, "fly_to", lambda: aircraft.step(0.0, 0.1, 0.5, until=2.0), calls


def make_batch():
    batch = testbed.Batch(SHORT, seeds=[1, 2], threads=2)
    calls = {
        "step": lambda: batch.step(3.0),
        "run": lambda: batch.run(),
        "reset": lambda: batch.reset(),
        "metrics": lambda: batch.metrics(0),
    }
    return batch, batch._rows[1], "set_pause", lambda: batch.step(2.0), calls


def make_vector():
    env = HoldSlotVectorEnv(2, threads=1, starts=2, duration_s=4.0)
    env.reset(seed=1)
    actions = np.full((2, 3), 0.1, np.float32)
    calls = {
        "step": lambda: env.step(-actions),
        "reset": lambda: env.reset(seed=2),
    }
    return env, env.batch, "step", lambda: env.step(actions), calls


def make_environment():
    env = HoldSlotEnv(duration_s=4.0)
    env.reset(seed=1)
    calls = {
        "step": lambda: env.step(np.full(3, -0.1, np.float32)),
        "reset": lambda: env.reset(seed=2),
    }
    flight = env._episodes.simulation._flight
    return env, flight, "fly_to", lambda: env.step(np.full(3, 0.1, np.float32)), calls


MAKES = make_simulation, make_aircraft, make_batch, make_vector, make_environment


def state_of(target):
    """All numbers of a flight, or of flights."""
    if hasattr(target, "aircraft") or hasattr(target, "batch"):
        batch = getattr(target, "batch", target)
        return batch.aircraft.tobytes(), batch.times_s.tolist(), batch.outcomes
    episodes = getattr(target, "_episodes", None)
    simulation = episodes.simulation if episodes else getattr(target, "simulation", target)
    return simulation.state.truth.position_ned.tobytes(), simulation.time_s, simulation.outcome


@pytest.mark.parametrize("make", MAKES)
def test_calls_of_another_thread_are_refused(make):
    """While one thread is within a call; the flight is that of one thread, to the bit."""
    target, part, name, fly, calls = make()
    inside, go, refused = threading.Event(), threading.Event(), {}
    method = getattr(part, name)

    def wait(*args, **kwargs):
        inside.set()
        assert go.wait(LIMIT_S)
        return method(*args, **kwargs)

    setattr_of(part, name, wait)
    thread = threading.Thread(target=fly)
    thread.start()
    assert inside.wait(LIMIT_S)
    for call, function in calls.items():
        with pytest.raises(InputError, match=r"is within \w+\(\) of another thread") as caught:
            function()
        refused[call] = str(caught.value)
    go.set()
    thread.join(LIMIT_S)
    setattr_of(part, name, method)
    for call, text in refused.items():
        assert f"(call {call}() after that" in text or call == "reset", (call, text)
    other, _, _, fly_other, _ = make()
    fly_other()
    assert state_of(target) == state_of(other)
    for function in calls.values():  # after that, as the text says
        function()
        break


def setattr_of(part, name, value):
    object.__setattr__(part, name, value)


@pytest.mark.parametrize("call", ["step", "save", "restore", "reset", "close"])
def test_call_within_a_stage_is_refused(call):
    box, seen = [], []

    def act(now, records):
        if now > 1.0 and not seen:
            simulation, saved = box
            arguments = [saved] if call == "restore" else []
            with pytest.raises(
                InputError, match=rf"{call}\(\) is called within step\(\)"
            ) as caught:
                getattr(simulation, call)(*arguments)
            seen.append(str(caught.value))
            assert simulation.metrics["outcome"] == "interrupted"  # may be read

    stage = testbed.UserStage("again", after="fly by wire", step=act)
    simulation = testbed.Simulation(SHORT, stages=[stage])
    box += [simulation, simulation.save()]
    simulation.step(until=2.0)
    assert "(call" in seen[0] and simulation.time_s == pytest.approx(2.0)
    plain = testbed.Simulation(SHORT)
    plain.step(until=2.0)
    assert state_of(simulation) == state_of(plain)
    if call != "close":
        getattr(simulation, call)(*([box[1]] if call == "restore" else []))  # after that


def test_two_threads_get_errors_not_other_numbers():
    simulation, errors = testbed.Simulation(SHORT), []

    def step():
        for _ in range(60):
            try:
                simulation.step()
            except InputError as error:
                errors.append(str(error))

    threads = [threading.Thread(target=step) for _ in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join(LIMIT_S)
    plain = testbed.Simulation(SHORT)
    plain.step(until=simulation.time_s)
    assert state_of(simulation) == state_of(plain)
    flown = round(simulation.time_s / 0.02) + len(errors)
    assert flown == 240 and all("another thread" in each or "ended" in each for each in errors)


def in_child(function):
    """Return what a function returns in a forked child, as text; "hangs" if it does not."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        try:
            text = repr(function())
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(write, text.encode()[:60_000])
        os._exit(0)
    os.close(write)
    end = time.monotonic() + LIMIT_S
    while not os.waitpid(child, os.WNOHANG)[0]:
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "hangs"
        time.sleep(0.02)
    with os.fdopen(read) as pipe:
        return pipe.read()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_batch_flies_on_in_a_forked_child():
    """It has flown with threads, which a child does not have."""
    batch = testbed.Batch(SHORT, seeds=range(4), threads=2)
    for until in (0.5, 1.0):
        batch.step(until)

    def fly():
        batch.step(2.0)
        return batch.aircraft["truth"]["position_ned"].tolist()

    found = in_child(fly)
    assert found == repr(fly())
    batch.step(3.0)
    assert in_child(lambda: batch.run()[0]["outcome"]) == "'completed'"


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_simulation_in_a_forked_child():
    simulation = testbed.Simulation(SHORT)
    simulation.step(until=1.0)

    def fly():
        return simulation.step(until=2.0).truth.position_ned.tolist()

    assert in_child(fly) == repr(fly())
    simulation._exclusive.acquire("step")
    text = in_child(simulation.step)
    assert text.startswith(
        "InputError: the flight of simulation-3: was within step() in the parent"
    )
    simulation._exclusive.release()


def test_fork_within_a_call_of_another_thread_is_named():
    lock, inside, go = Exclusive("this"), threading.Event(), threading.Event()

    def hold():
        lock.acquire("step")
        inside.set()
        go.wait(LIMIT_S)
        lock.release()

    thread = threading.Thread(target=hold)
    thread.start()
    assert inside.wait(LIMIT_S)
    with pytest.raises(InputError, match="another thread"):
        lock.check("metrics")
    go.set()
    thread.join(LIMIT_S)
    lock.check("metrics")
    lock.acquire("step")
    lock.check("metrics")  # of the same thread


def failing_stage(at_s):
    def fail(now, records):
        if now > at_s:
            raise RuntimeError("mine")

    return testbed.UserStage("fails", after="fly by wire", step=fail)


def test_failure_has_the_time_of_its_tick(tmp_path):
    simulation = testbed.Simulation(SHORT, stages=[failing_stage(1.0)])
    with pytest.raises(RuntimeError):
        simulation.step(until=3.0)
    assert (simulation.time_s, simulation.outcome) == (pytest.approx(1.02), "failed")
    with pytest.raises(InputError, match=r"ended: failed at 1\.02 s; reset\(\)"):
        simulation.step()
    assert simulation.reset().time_s == 0.0 and simulation.outcome is None
    with pytest.raises(RuntimeError):
        testbed.run(SHORT, stages=[failing_stage(1.0)], out=tmp_path / "run")
    events = testbed.load_run(tmp_path / "run").events
    assert events[-1].text.startswith("failed: RuntimeError") and events[-1].time_s == 1.02


LAW = """
import numpy as np
from testbed.law import FbwaCommand
class Fails:
    def __init__(self, config, *, at_s=1.0):
        self.at_s = at_s
    def start(self, own):
        return None
    def step(self, now, own, inbox, memory):
        n = len(own.airspeed)
        if now > self.at_s:
            raise ValueError("mine")
        return FbwaCommand(np.zeros(n), np.zeros(n), np.full(n, 0.5)), memory
"""


def test_failed_row_leaves_the_others_flying(tmp_path):
    (tmp_path / "fails_late.py").write_text(LAW)
    law = [f"controller.law={tmp_path}/fails_late.py:Fails"]
    rows = [[f"controller.options={{at_s: {at_s}}}"] for at_s in (1.5, 9.0, 9.0, 9.0)]
    batch = testbed.Batch("simulation-3", law, rows=rows, threads=2, duration_s=4.0)
    with pytest.raises(FlightError, match="mine"):
        batch.step(2.0)
    assert batch.outcomes == ["failed", None, None, None]
    assert batch.times_s[1:] == pytest.approx(2.0) and 1.5 <= batch.times_s[0] < 1.6
    batch.step(3.0)
    assert batch.times_s[1:] == pytest.approx(3.0) and batch.metrics(0)["outcome"] == "failed"
    batch.reset([0])
    batch.step([1.0, 0.0, 0.0, 0.0])
    assert batch.outcomes[0] is None
