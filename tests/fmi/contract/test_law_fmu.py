"""Formation laws that are FMUs: equal to a class and between versions, saved and restored."""

import os
import re
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from c_fmus import law_fmu, need_compiler
from cases import in_full
from commands import call_command, environment
from fmi2_importer import Archive, Instance
from forked import Forked
from waiting import TIMEOUT_S

import testbed
from testbed.core.errors import FlightError, InputError
from testbed.core.records import FbwaCommand
from testbed.fmi.archive import Archive as ProductArchive
from testbed.fmi.law_variables import match_variables
from testbed.fmi.model_description import read_description
from testbed.formation import fmu_step
from testbed.formation.compiled_law import python_function
from testbed.logs.read import read_log
from testbed.plan.world import build
from testbed.pool.flight_task import FlightTask, run_task
from testbed.scenario import load_scenario, set_duration

DURATION_S = float(os.environ.get("TESTBED_FMU_FLIGHT_S", "30"))
SCENARIO = """
extends: own-law-leader-follower
scenario: {{name: {name}}}
controller: {{law: {name}.fmu, options: {{field_per_m: 0.03}}}}
"""


def write_law(folder, name, *definitions, **how):
    """Write an FMU and its scenario; return the file of the scenario."""
    law_fmu(folder / f"{name}.fmu", *definitions, **how)
    file = folder / f"{name}.yaml"
    file.write_text(SCENARIO.format(name=name))
    return file


def fly(scenario, folder, *changes, duration_s=DURATION_S):
    """Fly a scenario; return its log."""
    flown = set_duration(load_scenario(scenario, changes), duration_s)
    out = folder / f"run{len(list(folder.iterdir()))}"
    assert testbed.run(flown, out=out).outcome == "completed"
    return read_log(out / "run.mcap")


@pytest.fixture(scope="module")
def laws(tmp_path_factory):
    """Folder with the law as an FMU of 2.0, of 3.0, and of 2.0 without a state."""
    need_compiler()
    folder = tmp_path_factory.mktemp("fmus")
    write_law(folder, "two")
    write_law(folder, "three", version=3, aircraft=3)
    write_law(folder, "stateless", state=False)
    return folder


@pytest.fixture(scope="module")
def logs(laws):
    """Log of each law, and of the class that it is a copy of."""
    names = "own-law-leader-follower", *(laws / f"{each}.yaml" for each in ("two", "three"))
    return [fly(each, laws) for each in names]


def same_motion(one, two):
    """Whether every bit of two motions is equal."""
    ours, theirs = one.truth.position_ned, two.truth.position_ned
    return np.array_equal(ours, theirs, equal_nan=True)


def test_fmu_flies_as_class(logs):
    """Positions are within 1e-6 m: where NumPy has sines of its own, last bits are not libm's.

    That it is the FMU that flies is shown by its other options, below.
    """
    of_class, two, _ = (each.truth.position_ned for each in logs)
    apart = np.abs(of_class - two).max()
    assert apart < 1e-6


def test_fmi_3_equals_fmi_2(logs):
    """Arrays of N aircraft fly as scalars of the leader, to the bit; other options do not."""
    assert same_motion(*logs[1:])


def test_options_are_parameters(laws, logs):
    """A parameter of the FMU has the value of the scenario."""
    other = fly(laws / "two.yaml", laws, "controller.options.closing=0.31", duration_s=2.0)
    n = len(other.tick)
    assert not np.array_equal(other.truth.position_ned, logs[1].truth.position_ned[:n])


def test_restored_flight_repeats_to_the_bit(laws):
    """Saved at 4 s, flown to 8 s, restored and flown again."""
    with testbed.Simulation(laws / "two.yaml") as simulation:
        simulation.step(until=4.0)
        saved = simulation.save()
        first = simulation.step(until=8.0).truth.position_ned.copy()
        simulation.restore(saved)
        again = simulation.step(until=8.0).truth.position_ned.copy()
        simulation.restore(saved)
        assert not np.array_equal(simulation.state.truth.position_ned, again)
    assert np.array_equal(first, again)


def test_batch_flies_as_run(laws):
    """Rows with lost messages, in two threads, equal flights alone."""
    changes = ["network.loss=0.2"]
    batch = testbed.Batch(laws / "three.yaml", changes, seeds=[1, 2, 1], threads=2, duration_s=4.0)
    metrics = batch.run()
    alone = [
        testbed.run(laws / "three.yaml", changes, seed=k, duration_s=4.0, write=False).metrics
        for k in (1, 2)
    ]
    ours = [each["max_error_m"] for each in metrics]
    assert ours == [alone[k]["max_error_m"] for k in (0, 1, 0)]
    assert ours[0] != ours[1]


def test_without_state_flies_and_is_not_saved(laws, logs):
    """It flies as the one with a state; save and Batch name the file and the flag."""
    log = fly(laws / "stateless.yaml", laws, duration_s=4.0)
    n = len(log.tick)
    assert np.array_equal(log.truth.position_ned, logs[1].truth.position_ned[:n], equal_nan=True)
    with testbed.Simulation(laws / "stateless.yaml") as simulation:
        simulation.step(until=1.0)
        with pytest.raises(InputError, match=r"stateless\.fmu: its state .*canGetAndSetFMUstate"):
            simulation.save()
        at_1 = simulation.state.truth.position_ned.copy()
        simulation.reset()
        assert np.array_equal(simulation.step(until=1.0).truth.position_ned, at_1)
    with pytest.raises(InputError, match=r"stateless\.fmu: its state"):
        testbed.Batch(laws / "stateless.yaml")


@pytest.mark.parametrize(
    ("definition", "how", "text"),
    [
        ("LEFT_OUT", {}, "does not carry its memory .*serialised state"),
        ("SHARED", {"state": False}, "returns another|does not carry|only inputs of"),
        ("NO_RESET", {"state": False}, "for the same input .*reset function"),
        ("FAIL_S=0.1", {}, r"at 0\.12 s: fmi2DoStep returns fmi2Error"),
        ("FAIL_S=0.1", {"version": 3}, r"at 0\.12 s: fmi3DoStep returns fmi3Error"),
        ("NOT_FINITE_S=0.1", {}, "its roll is not a finite number"),
        ("GROWS_S=0.1", {}, "fmi2SerializedFMUstateSize is"),
    ],
)
def test_faulty_fmu_is_refused(tmp_path, definition, how, text):
    """What breaks the contract is an error of validation with the FMU's name."""
    need_compiler()
    file = write_law(tmp_path, "faulty", definition, **how)
    with pytest.raises(InputError, match=rf"faulty\.fmu.*({text})"):
        build(load_scenario(file))


def test_error_in_flight_names_fmu_and_follower(tmp_path):
    """A function that fails in flight ends it with file, follower, time and function."""
    need_compiler()
    file = write_law(tmp_path, "failing", "FAIL_S=2.0")
    text = r"failing\.fmu: uav1 at 2\.04 s: fmi2DoStep returns fmi2Error"
    with pytest.raises(FlightError, match=text):
        testbed.run(file, duration_s=5.0, write=False)


def test_crash_leaves_a_complete_log(tmp_path):
    """A segmentation fault is an error with the FMU's name; the log ends before that step."""
    need_compiler()
    file = write_law(tmp_path, "crashing", "CRASH_S=2.0")
    text = r"crashing\.fmu: uav1 at 2\.04 s: crashed \(SIGSEGV\) in the call to step"
    with pytest.raises(FlightError, match=text):
        testbed.run(file, duration_s=3.0, out=tmp_path / "cut")
    result = run_task(FlightTask(0, set_duration(load_scenario(file), 3.0)))  # of a study
    assert result.outcome == "failed" and re.search(text, result.error)
    log = read_log(tmp_path / "cut" / "run.mcap")
    assert log.finished and log.time_s[-1] == pytest.approx(2.0, abs=0.1)
    assert log.metrics["outcome"] == "failed"
    whole = fly(write_law(tmp_path, "sound"), tmp_path, duration_s=2.2)
    n = len(log.tick)
    assert np.array_equal(log.truth.position_ned, whole.truth.position_ned[:n])


def test_crash_before_flight_is_an_error(tmp_path):
    """In `validate`, a run and a Simulation it is one line, and the process goes on."""
    need_compiler()
    file = write_law(tmp_path, "dead", "CRASH_AT_ONCE")
    done = call_command("validate", file, cwd=tmp_path, code=2, columns=200)
    [line] = done.stderr.splitlines()
    text = "dead.fmu: crashed (SIGSEGV) when it was loaded or initialised"
    assert text in line
    for fly in (testbed.run, testbed.Simulation):
        with pytest.raises(InputError) as found:
            fly(file, out=tmp_path / "none")
        assert text in str(found.value) and not isinstance(found.value, FlightError)
    assert not (tmp_path / "none").exists()


def test_run_keeps_the_fmu(laws):
    """The run directory has a copy, with which its scenario flies; the digest is printed."""
    out = laws / "kept"
    testbed.run(laws / "two.yaml", duration_s=2.0, out=out)
    assert (out / "two.fmu").read_bytes() == (laws / "two.fmu").read_bytes()
    assert load_scenario(out / "scenario.resolved.yaml").controller.law == str(out / "two.fmu")
    done = call_command("validate", out / "scenario.resolved.yaml", cwd=laws, code=0, columns=200)
    assert "runs the FMU two.fmu (SHA-256 " in done.stderr


@pytest.fixture(scope="module")
def new_laws(tmp_path_factory):
    """Folders of `testbed new law`: of an FMU, which its commands have built, and of a kernel."""
    need_compiler()
    # of one name, as test_new_law.py's, so that its kernel is compiled once
    places = {each: tmp_path_factory.mktemp(each) for each in ("fmu", "kernel")}
    done = call_command("new", "law", "mine", "--fmu", cwd=places["fmu"], code=0, columns=200)
    lines = [each.strip() for each in done.stdout.splitlines()]
    commands = lines[2 : lines.index("cd -")]
    assert any(each.startswith("cc ") for each in commands)
    folder = places["fmu"] / "mine" / "mine-fmu"
    subprocess.run(["sh", "-ec", "\n".join(commands)], cwd=folder, check=True,
                   env=environment(80))  # fmt: skip
    call_command("new", "law", "mine", cwd=places["kernel"], code=0, columns=200)
    return {each: place / "mine" for each, place in places.items()}


def test_new_fmu_law_computes_as_the_kernel(new_laws, tmp_path):
    """Its velocity and acceleration, by an importer of our own; also where the leader is lost."""
    archive = Archive((new_laws["fmu"] / "mine.fmu").read_bytes(), tmp_path)
    instance, outputs = Instance(archive).begin(), archive.outputs()
    inputs = [each for each in archive.reals if each not in outputs]
    kernel = find_kernel(new_laws["kernel"] / "mine.py")
    random = np.random.default_rng(1)
    for age_s in (0.0, 0.1, 0.9, 1.1, 5.0):
        # own position and velocity; position, velocity and acceleration of the leader; the slot
        vectors = random.normal(0.0, 15.0, (6, 3))
        own = SimpleNamespace(position_ned=vectors[0], velocity_ned=vectors[1])
        names = "position_ned", "velocity_ned", "acceleration_ned"
        inbox = dict(zip(names, vectors[2:5, np.newaxis], strict=True))
        inbox = SimpleNamespace(received_s=[7.0 - age_s], turn_rate=[0.2], **inbox)
        config = SimpleNamespace(leader_timeout_s=1.0, offsets=[None, vectors[5]], agents=1)
        expected = kernel(7.0, own, inbox, SimpleNamespace(), config, 0.7)
        given = [*vectors[:2].flat, age_s, *vectors[2:5].flat, 0.2, *vectors[5], 1.0, 0.7]
        instance.set(inputs, given)
        instance.step(0.04)
        np.testing.assert_allclose(instance.get(outputs), expected, atol=1e-9)


def find_kernel(file):
    """Return the law of a file as Python, with the desired velocity and acceleration as result."""
    names = {}
    exec(compile(file.read_text(), str(file), "exec"), names)
    names["length"] = np.linalg.norm
    still = np.zeros(3)
    names["command_from_velocity"] = lambda config, own, v, a=still: [*v, *a]
    return python_function(names[file.stem])


def test_outputs_are_the_commands_of_their_kind(new_laws, monkeypatch):
    """As Python; the law of `testbed new law` is of a kind that no other flight here has."""
    file = new_laws["fmu"] / "mine.fmu"
    scenario = load_scenario(file.with_suffix(".yaml")).controller
    assert scenario.law == str(file)
    model = read_description(ProductArchive(file))
    assert match_variables(model, {}, scenario.options, 4, 0.04).kind == "velocity"
    found = np.arange(1.0, 9.0)
    monkeypatch.setattr(fmu_step, "step_fmu", lambda *_: found)
    monkeypatch.setattr(fmu_step, "command_from_velocity", lambda config, own, *given: given)
    commands = {kind: law(*[None] * 6) for kind, law in fmu_step.LAWS.items()}
    assert commands["fly-by-wire"] == FbwaCommand(pitch=1.0, roll=2.0, throttle=3.0)
    np.testing.assert_array_equal(commands["velocity"], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    unicycle = commands["unicycle"]
    assert (unicycle.speed, unicycle.speed_desired, unicycle.limiter_flags) == (1.0, 5.0, 0)
    np.testing.assert_array_equal(unicycle.omega, [2.0, 3.0, 4.0])
    np.testing.assert_array_equal(unicycle.direction, [6.0, 7.0, 8.0])


@in_full
def test_new_fmu_law_flies_as_the_kernel(new_laws):
    laws = {each: load_scenario(place / "mine.yaml") for each, place in new_laws.items()}
    errors = [
        testbed.run(each, duration_s=10.0, write=False).metrics["max_error_m"]
        for each in laws.values()
    ]
    assert errors[0] == pytest.approx(errors[1], abs=1e-6)


def test_nothing_stays_in_the_temporary_folder(tmp_path):
    """After a flight, a crash and a validation no unpacked file is left."""
    need_compiler()
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    place = {**environment(200), "TMPDIR": str(temporary)}
    for name, *definitions in (("sound",), ("crashing", "CRASH_S=5.0")):
        file = write_law(tmp_path, name, *definitions)
        for words in ("validate", file), ("run", file, "--duration", "6", "--out", name):
            process = Forked("testbed.cli.main:main", *words, cwd=tmp_path, env=place)
            code = process.wait(TIMEOUT_S)
            assert code == (2 if definitions and words[0] == "run" else 0), words
    assert not [*temporary.glob("testbed-fmu-*")]
