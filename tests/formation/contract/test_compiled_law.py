"""Laws of users under `@testbed.kernel`: equal to classes, their errors, and their machine code."""

import inspect
import re
import time

import numpy as np
import pytest
from cases import in_full
from commands import environment
from fresh import run_fresh
from places import ROOT

import testbed
from testbed.core.code_digest import UnknownValueError, code_digest
from testbed.core.compile import cache_folder
from testbed.core.errors import FlightError, InputError
from testbed.core.records import AIRCRAFT, LINK, Messages, NedOrigin, allocate
from testbed.flight.law_inputs import declared_faults, give_inputs, wind_estimates
from testbed.formation.compiled_law import CompiledLaw, allocate_inputs
from testbed.formation.control_step import CONTROLLER, Hbh23Law
from testbed.formation.hbh23 import NEIGHBOUR
from testbed.logs.read import read_log
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.plan.user_code import build_law, check_law
from testbed.plan.world import build
from testbed.runs.run import list_stages
from testbed.scenario import load_scenario, set_duration

PAGE = (ROOT / "docs" / "own-law.md").read_text("utf-8")
FILES = dict(re.findall(r'^```\w+ title="([\w./-]+)"\n(.*?)^```$', PAGE, re.M | re.S))
HEAD = """
import numba
import numpy as np
import testbed
from math import nan
from testbed.law import FbwaCommand, LimiterFlag, UnicycleCommand, command_from_velocity

CONSTANTS = np.zeros(3)
CALM = FbwaCommand(0.0, 0.0, 0.4)


@testbed.kernel
def helper(x):
    return x.foo


@numba.njit
def bare(now, own, inbox, memory, config):
    return FbwaCommand(0.0, 0.0, 0.4)


@testbed.kernel(memory=[("flown_s", float), ("steps", int)])
def mine(now, own, inbox, memory, config, roll=0.0):
    BODY
    return FbwaCommand(0.0, roll, 0.4)
"""


@pytest.fixture(scope="module")
def chases(tmp_path_factory):
    """The example of the docs: the folder of its class, its kernel and their scenarios."""
    folder = tmp_path_factory.mktemp("chase")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def fly(path, *changes, duration=12.0, folder):
    """Fly a scenario; return its log and its metrics."""
    scenario = set_duration(load_scenario(path, changes), duration)
    flown = testbed.run(scenario, out=folder / f"run{len(list(folder.iterdir()))}")
    assert flown.outcome == "completed"
    return read_log(flown.directory / "run.mcap"), flown.metrics


def differences(ours, theirs):
    """Yield the logged fields that differ in a bit."""
    for group in ("truth", "estimate", "command", "surfaces", "formation"):
        for name, one in getattr(ours, group)._asdict().items():
            two = getattr(getattr(theirs, group), name)
            if one.tobytes() != two.tobytes():
                yield f"{group}.{name}"


def config_of(name="simulation-3"):
    """The configuration, what was read for its fields (nothing is noted), and the built-in law."""
    page = load_scenario(name)
    built = build_control(resolve(page), page.controller, build_clock(page))
    return built.config, {}, Hbh23Law(built.controllers["law"], built.neighbours)


@pytest.fixture(scope="module")
def configured():
    return config_of()


def write(folder, body="pass", *, text=HEAD):
    """Write a kernel with this body; return its name."""
    (folder / "mine.py").write_text(text.replace("BODY", body))
    return f"{folder / 'mine.py'}:mine"


BODIES = []
ANGLES = (1.0, 2.0, 3.0)  # an option of the kernel with all bodies that must be given


def case(body):
    """Number of a body of the kernel with all of them, whose option chooses one."""
    BODIES.append(body)
    return len(BODIES)


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Folder of that kernel, which is compiled once."""
    folder = tmp_path_factory.mktemp("cases")
    indented = (each.replace("\n", "\n    ") for each in BODIES)
    body = "\n    ".join(f"if case == {k}:\n        {each}" for k, each in enumerate(indented, 1))
    gain = f"GAIN = float(np.loadtxt('{folder}/gain.txt'))\nCALM ="
    (folder / "gain.txt").write_text("0.25")
    text = HEAD.replace("CALM =", gain).replace("roll=0.0", "angles, roll=0.0, case=0")
    write(folder, body, text=text)
    return folder


def scenario_of(cases, number, more=""):
    path = cases / "law.yaml"
    options = f"{{angles: [1, 2, 3], case: {number}{more}}}"
    controller = f"{{law: 'mine:mine', options: {options}}}"
    path.write_text(f"extends: simulation-3\ncontroller: {controller}\n")
    return path


def options_of(number):
    return {"angles": ANGLES, "case": number}


def law_error(name, configured, **options):
    with pytest.raises(InputError) as caught:
        check_law(build_law(name, options, *configured)[0], configured[0])
    return str(caught.value)


# equal to classes


@pytest.mark.parametrize("engine", ["compiled", "jsbsim"])
def test_kernel_flies_as_the_class_to_the_bit(chases, engine, tmp_path):
    change = f"scenario.engine={engine}"
    runs = [
        fly(chases / name, change, duration=6.0, folder=tmp_path)
        for name in ("chase.yaml", "compiled_chase.yaml")
    ]
    (ours, metrics), (theirs, expected) = runs
    assert not list(differences(ours, theirs))
    assert metrics["max_error_m"] == expected["max_error_m"]
    assert np.abs(ours.formation.error_ned).max() > 1.0


def test_kernel_without_messages_flies_as_the_class(chases, tmp_path):
    changes = ("network.transmitter_off_s.leader=[[1, 8]]", "controller.leader_timeout_s=1.5")
    logs = [
        fly(chases / name, *changes, folder=tmp_path)[0]
        for name in ("chase.yaml", "compiled_chase.yaml")
    ]
    assert not list(differences(*logs))
    assert (logs[0].formation.limiter_flags & 8).any()


def test_no_python_is_left_in_the_control(chases):
    rows = list_stages(build(load_scenario(chases / "compiled_chase.yaml")))
    control = [runs for part, _, _, runs in rows if part == "control"]
    assert len(control) > 5 and all(runs.startswith("compiled") for runs in control)
    python = list_stages(build(load_scenario(chases / "chase.yaml")))
    assert ("control", "control", "step law and middle loop", "Python") in python


def test_kernel_in_a_batch_flies_as_in_a_run(chases):
    path = chases / "compiled_chase.yaml"
    batch = testbed.Batch(set_duration(load_scenario(path), 3.0), seeds=[1, 2], threads=2)
    found = batch.run()
    for metrics, seed in zip(found, (1, 2), strict=True):
        scenario = set_duration(load_scenario(path, [f"scenario.seed={seed}"]), 3.0)
        expected = testbed.run(scenario, write=False).metrics
        assert metrics["max_error_m"] == expected["max_error_m"]


FBWA_CLASS = """
import numpy as np
from testbed.law import FbwaCommand

class Mine:
    def __init__(self, config, *, roll=0.0): self.roll = roll
    def start(self, own): return np.zeros((len(own.airspeed), 2))
    def step(self, now, own, inbox, memory):
        memory = memory + [0.04, 1.0]
        climb = 0.1 * np.sin(memory[:, 0]) - 0.001 * memory[:, 1]
        return FbwaCommand(climb, self.roll * own.euler[:, 2], np.full(len(climb), 0.4)), memory
"""
FBWA_KERNEL = case("""memory.flown_s += 0.04
    memory.steps += 1
    climb = 0.1 * np.sin(memory.flown_s) - 0.001 * memory.steps
    return FbwaCommand(climb, roll * own.euler[2], 0.4)""")


def test_kernel_with_memory_commands_fly_by_wire(cases, tmp_path):
    """Angles of the logged motion are numpy's for a class, whose last bit is another."""
    (tmp_path / "theirs.py").write_text(FBWA_CLASS)
    path = tmp_path / "law.yaml"
    roll = "roll: 2"  # an integer, where the default is a float
    law = f"{{law: 'theirs:Mine', options: {{{roll}}}}}"
    path.write_text(f"extends: simulation-3\ncontroller: {law}\n")
    pages = scenario_of(cases, FBWA_KERNEL, f", {roll}"), path
    ours, theirs = logs = [fly(page, duration=6.0, folder=tmp_path)[0] for page in pages]
    angles = {"formation.course_desired", "formation.flight_path_angle_desired"}
    assert set(differences(ours, theirs)) <= angles
    for name in ("course_desired", "flight_path_angle_desired"):
        one, two = (getattr(each.formation, name) for each in logs)
        np.testing.assert_allclose(one, two, rtol=0.0, atol=1e-15)
    assert np.ptp(ours.command.pitch[:, 1]) > 0.1 and (ours.formation.saturations & 2).any()


STEPS = case("memory.flown_s += 0.04\n    memory.steps += 1")


def test_step_returns_the_memory_it_wrote(cases, configured):
    """So the checks before a flight step a law on from memories that it has written itself."""
    law = build_law(f"{cases}/mine.py:mine", options_of(STEPS), *configured)[0]
    n = len(law.own.airspeed)
    memory = law.start(law.own)
    for count in (1, 2, 3):
        _, memory = law.step(0.04 * count, law.own, law.inbox, memory)
        assert memory["steps"].tolist() == [count] * n
        assert memory["flown_s"] == pytest.approx([0.04 * count] * n, abs=1e-15)


@pytest.mark.parametrize("extrapolates", [False, True])
def test_excluded_sender_gives_no_number(extrapolates):
    """Every field of its message is NaN, and the numbers of the others are those of the links.

    Extrapolated are position and velocity of the others, whose message is then one of the present.
    """
    n, aircraft = 2, 3
    states, links = allocate(AIRCRAFT, aircraft), allocate(LINK, n, aircraft)
    neighbours = allocate(NEIGHBOUR, n, aircraft)
    for name in Messages._fields:
        links[name] = np.arange(1.0, 1.0 + links[name].size).reshape(links[name].shape)
    expected, now = {name: links[name].copy() for name in Messages._fields}, 20.0
    if extrapolates:
        dt = now - links["received_s"][..., np.newaxis]
        expected["position_ned"] += dt * links["velocity_ned"]
        expected["stamp_s"][:] = expected["received_s"][:] = now
    neighbours["excluded"][1, 2], neighbours["timeout_s"] = True, np.inf
    controllers = allocate(CONTROLLER, n)
    own, inbox = allocate_inputs(n, aircraft, 2)
    payloads = np.arange(2.0 * n * aircraft).reshape(n, aircraft, 2)
    v, a = expected["velocity_ned"], expected["acceleration_ned"]
    expected["payload"], expected["turn_rate"] = (
        payloads,
        np.cross(v, a)[..., 2] / (v[..., 0] ** 2 + v[..., 1] ** 2),
    )
    known = np.arange(n), states, links, neighbours, controllers
    around = wind_estimates(None, states), declared_faults(None), payloads
    give_inputs(*known, *around, extrapolates, own, inbox, now)
    assert not inbox.failed.any()
    received = np.ones((n, aircraft), dtype=bool)
    received[1, 2] = False
    for name in expected:
        values = getattr(inbox, name)
        assert np.isnan(values[1, 2]).all(), name
        assert np.array_equal(values[received], expected[name][received]), name


def end_of(path):
    """Positions after 0.2 s of a scenario with unicycles, as text."""
    scenario = set_duration(load_scenario(path, ["fleet.*.vehicle=unicycle"]), 0.2)
    with testbed.Simulation(scenario) as flight:
        while flight.outcome is None:
            state = flight.step()
        return state.truth.position_ned.tobytes().hex()


def test_kernel_runs_as_python_in_a_debugger(chases):
    path = chases / "compiled_chase.yaml"
    imports = "import testbed\nfrom testbed.scenario import load_scenario, set_duration\n"
    text = f"{imports}{inspect.getsource(end_of)}print(end_of({str(path)!r}))"
    env = {**environment(80), "NUMBA_DISABLE_JIT": "1"}
    code, output, errors = run_fresh(text, folder=chases, paths=[ROOT], env=env)
    assert code == 0, errors
    assert output.strip() == end_of(path) != ""


# errors


def test_error_names_the_line_of_its_cause(tmp_path, configured):
    """Where numba itself names none: an unknown name, and a vector of the memory that is assigned.

    For the latter numba has no text at all.
    """
    error = law_error(write(tmp_path, "pass\n    return FbwaCommand(spd, 0.0, 0.4)"), configured)
    text = (tmp_path / "mine.py").read_text().splitlines()
    assert f"mine.py:{1 + text.index('    return FbwaCommand(spd, 0.0, 0.4)')}: " in error
    assert "mine cannot be compiled: name 'spd' is not defined" in error and "\n" not in error
    memory = "@testbed.kernel(memory=[('mean_ned', float, 3)])"
    (tmp_path / "vector.py").write_text(
        f"import testbed\nfrom testbed.law import FbwaCommand\n\n{memory}\n"
        "def mine(now, own, inbox, memory, config):\n    memory.mean_ned = 0.5 * own.euler\n"
        "    return FbwaCommand(0.0, 0.0, 0.4)\n"
    )
    error = law_error(f"{tmp_path / 'vector.py'}:mine", configured)
    assert "vector.py:6: mine cannot be compiled: memory.mean_ned is a vector" in error
    assert error.endswith("(write memory.mean_ned[:] = …)")


NOT_COMPILED = [
    (
        "return FbwaCommand(own.postion_ned[0], 0.0, 0.4)",
        "Unknown attribute 'postion_ned' of type ",
    ),
    ("inbox.stamp_s[0] = 1.0", "Cannot modify readonly array"),
    ("config.offsets[0, 0] = 1.0", "Cannot modify readonly array"),
    pytest.param("own.position_ned[0] = 1.0", "Cannot modify readonly array", marks=in_full),
    pytest.param("CONSTANTS[0] = 1.0", "Cannot modify readonly array", marks=in_full),
    ("own.airspeed = 1.0", "OwnState.airspeed"),
    ("if now > 1.0:\n        return now", "Can't unify return type from the following types"),
    ("return 1.0", "the law returns float64 (return a UnicycleCommand or an FbwaCommand)"),
    ("return FbwaCommand(now, 0.0)", "missing a required argument: 'throttle'"),
    ("return FbwaCommand(own.euler, 0.0, 0.4)", "pitch of the law's command is "),
    (
        "return UnicycleCommand(20.0, (0.0, 0.0), 20.0, (1.0, 0.0, 0.0), 0)",
        "omega of the law's command is UniTuple(float64 x 2) (write 3 numbers)",
    ),
    (
        "return UnicycleCommand(20.0, (0, 0, 0), 20.0, (1, 0, 0), LimiterFlag.LEADER_TIMEOUT)",
        "limiter_flags of the law's command is Enum<int64>(LimiterFlag) (write its .value)",
    ),
    ("return command_from_velocity(config, own, (20.0, 0.0))", "(write 3 numbers)"),
    ("memory.missing = 1.0", "missing"),
    ("with open('x') as file:\n        pass", "construct is not supported"),
]


@pytest.mark.parametrize(("body", "message"), NOT_COMPILED, ids=lambda each: each[:30])
def test_what_numba_cannot_compile_is_one_line(body, message, tmp_path, configured):
    error = law_error(write(tmp_path, body), configured)
    place = rf"controller\.law: {re.escape(str(tmp_path))}/mine\.py:\d+: mine cannot be compiled: "
    assert re.match(place, error) and message in error
    assert "\n" not in error and len(error) < 400


def test_compile_error_has_line_of_a_called_function(tmp_path, configured):
    name = write(tmp_path, "return FbwaCommand(helper(now), 0.0, 0.4)")
    line = HEAD.split("return x.foo")[0].count("\n") + 1
    error = law_error(name, configured)
    assert (
        f"mine.py:{line}: mine cannot be compiled: Unknown attribute 'foo' of type float64" in error
    )


WRONG = [
    (
        case("return FbwaCommand(nan, 0.0, 0.4)"),
        "the law's pitch for uav1 is not a finite number at 0 s",
    ),
    (case("return FbwaCommand(own.euler[3 + memory.steps], 0.0, 0.4)"), "LINE: the law raised Ind"),
    (case("if now > 0.05:\n        raise ValueError('no')"), "LINE: the law raised ValueError: no"),
    (case("return FbwaCommand(0.0, 30.0, 0.4)"), "mine returns a roll of 30 (angles are in rad)"),
    (case("roll = np.random.random()"), "store state nowhere else"),
    (
        case("config.hbh23.gains[0].k = 1e9"),
        "mine writes into its inputs (assignment destination is read",
    ),
    (case("config.hbh23.gains[0].acceleration_blend[1] = 0.5"), "mine writes into its inputs"),
    (
        case("memory.steps += 1\n    if memory.steps > 3:\n        raise ValueError('four steps')"),
        "LINE: the law raised ValueError: four steps",
    ),
]
WRONG_UNICYCLES = {
    3: "mine returns omega with a first component of ",
    2: "omega or direction of the law's command has not 3 numbers",
}
UNICYCLES = "return UnicycleCommand(20.0, own.velocity_ned[:size], 20.0, (1.0, 0.0, 0.0), 0)"


def with_line(message, cases, number):
    """A message in which LINE is the file and the last line of a body."""
    lines = [each.strip() for each in (cases / "mine.py").read_text().splitlines()]
    line = lines.index(BODIES[number - 1].splitlines()[-1].strip()) + 1
    return message.replace("LINE", f"mine.py:{line}")


@pytest.mark.parametrize(("number", "message"), WRONG, ids=[m[:30] for _, m in WRONG])
def test_a_kernel_is_held_to_the_contract(number, message, cases, configured):
    error = law_error(f"{cases}/mine.py:mine", configured, **options_of(number))
    assert with_line(message, cases, number) in error


def test_commands_of_unicycles_are_held_to_it(tmp_path, configured):
    text = HEAD.replace("roll=0.0", "size").replace("return FbwaCommand(0.0, roll, 0.4)", "")
    name = write(tmp_path, UNICYCLES, text=text)
    for size, message in WRONG_UNICYCLES.items():
        assert message in law_error(name, configured, size=size)


def test_zero_velocity_has_no_command(chases, configured):
    """The example asks for its own velocity where the leader is silent, here for zero."""
    law, _ = build_law(f"{chases / 'compiled_chase.py'}:chase", {}, *configured)
    with pytest.raises(ValueError, match="velocity_ned is zero: it has no direction"):
        law.step(100.0, law.own, law.inbox, None)


def test_wrong_names_and_options_are_named(tmp_path, configured):
    name = write(tmp_path)
    assert "unexpected keyword argument 'rolll'" in law_error(name, configured, rolll=1.0)
    assert "options: roll is 'up' (an option of a law" in law_error(name, configured, roll="up")
    bare = law_error(name.replace(":mine", ":bare"), configured)
    assert "bare is compiled by numba alone (write @testbed.kernel in place" in bare
    helper = law_error(name.replace(":mine", ":helper"), configured)
    assert "helper(x) has other arguments than a law (write helper(now, own, inbox" in helper
    missing = law_error(name.replace(":mine", ":yours"), configured)
    assert "has no class 'yours', and no function of this name under @testbed.kernel" in missing
    assert "mine)" in missing
    text = HEAD.replace('("steps", int)', '("steps", object)')
    assert "memory is no list of fields with numbers" in law_error(
        write(tmp_path, text=text), configured
    )


LIST = case("roll = 0.01 * angles[2]")


def test_list_of_numbers_is_an_option(cases, configured):
    name = f"{cases}/mine.py:mine"
    law, _ = build_law(name, options_of(LIST), *configured)
    assert isinstance(law, CompiledLaw)
    check_law(law, configured[0])
    assert law.command.fbwa.roll == pytest.approx([0.03] * 3)
    assert "missing a required argument: 'angles'" in law_error(name, configured)


FAILING = [
    (case("roll = nan if now > 1.0 else 0.0"), "roll for uav1 is not a finite number at 1.04"),
    (case("roll = 1.0 // 0.0 if now > 1.0 else 0.0"), "the law's roll for uav1 is not a finite"),
    (
        case("if now > 1.0 and config.agents == 2:\n        raise ValueError('lost')"),
        "LINE: the law raised ValueError: lost",
    ),
    (
        case(
            "if now > 1.0 and config.agents == 2:\n        config.hbh23.gains[0].speed_max = 17.0"
        ),
        "LINE: the law raised ValueError: assignment destination is read-only",
    ),
]


@pytest.mark.parametrize(("number", "message"), FAILING, ids=["nan", "division", "raise", "write"])
def test_kernel_that_fails_ends_the_flight(number, message, cases):
    """As a law in Python; see `test_law_nan_in_flight_ends_the_run_with_its_time`."""
    scenario = set_duration(load_scenario(scenario_of(cases, number)), 2.0)
    with pytest.raises(FlightError, match=re.escape(with_line(message, cases, number))):
        testbed.run(scenario, write=False)


ZERO = case("zero = int(0.0 * now)\n    roll = 1 // zero + 1 % zero + 1.0 / (1 / zero)")


def test_integers_divided_by_zero(cases, configured):
    """As docs/own-law.md has it; floats divided by zero are not finite."""
    law, _ = build_law(f"{cases}/mine.py:mine", options_of(ZERO), *configured)
    check_law(law, configured[0])
    assert law.command.fbwa.roll.tolist() == [0.0] * 3


FIRST_STEP = case("memory.steps += 1\n    roll = 0.1 if memory.steps == 1 else 0.0")


def test_memory_is_zero_at_the_first_step(cases, tmp_path):
    """The checks before the flight leave nothing in it."""
    log, _ = fly(scenario_of(cases, FIRST_STEP), duration=0.2, folder=tmp_path)
    assert (log.command.roll[0, 1:] == 0.1).all() and (log.command.roll[-1, 1:] == 0.0).all()


# machine code


def digest(body, **variables):
    namespace = {"testbed": testbed, "np": np, **variables}
    exec(f"@testbed.kernel\ndef f(x, y=1.0):\n    {body}\n", namespace)
    return code_digest(namespace["f"])


@testbed.kernel
def twice(x):
    return 2.0 * x


@testbed.kernel
def thrice(x):
    return 3.0 * x


def test_digest_is_of_all_that_is_compiled_in():
    bodies = (
        "return x",
        "return x + 1.0",
        "return x + 2.0",
        "return np.sin(x)",
        "return np.cos(x)",
    )
    seen = [digest(body) for body in bodies]
    values = (1.0, 2.0, 1, (1.0, 2.0), np.ones(2), np.ones(3), np.zeros(2), twice, thrice)
    seen += [digest("return gain", gain=value) for value in values]
    assert len(set(seen)) == len(seen)
    assert digest("return x") == seen[0] and digest("return gain", gain=twice) == seen[-2]
    for value in (object(), [1.0], np.random.default_rng(1), NedOrigin()):
        with pytest.raises(UnknownValueError, match="^gain$"):
            digest("return gain", gain=value)


def test_digest_of_a_module_is_of_what_is_read(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "a_gain_module.py").write_text("GAIN = 1.0\nother = object()\n")
    import a_gain_module

    body = "return a_gain_module.GAIN"
    one = digest(body, a_gain_module=a_gain_module)
    a_gain_module.GAIN = 2.0
    assert digest(body, a_gain_module=a_gain_module) != one


def kept(law):
    """Return the machine code of a law on disk, without that of laws of other tests meanwhile."""
    return set(cache_folder().glob(f"*step_law_{code_digest(law._kernel)[:32]}-*.code"))


GAINED = case("roll = GAIN")


def test_changed_constant_is_compiled_again(cases, configured):
    """A file that the law's file reads is no text of it."""

    def command():
        law, note = build_law(f"{cases}/mine.py:mine", options_of(GAINED), *configured)
        check_law(law, configured[0])
        assert "compiled for each run" not in note
        return law.command.fbwa.roll.tolist(), kept(law)

    roll, first = command()
    assert roll == [0.25] * 3 and len(first) == 1
    assert command() == (roll, first)
    other = 0.1 + 1e-12 * (time.time_ns() % 10**9)  # of no run before
    (cases / "gain.txt").write_text(repr(other))
    roll, second = command()
    (cases / "gain.txt").write_text("0.25")
    assert roll == [other] * 3 and len(second) == 1 and not second & first


def test_value_without_a_digest_is_named(tmp_path, configured):
    """Its machine code is not kept."""
    text = HEAD.replace("CALM =", "import enum\nclass Side(enum.IntEnum):\n    LEFT = 1\n\nCALM =")
    name = write(tmp_path, "roll = 0.1 if Side.LEFT == 1 else 0.0", text=text)
    law, note = build_law(name, {}, *configured)
    check_law(law, configured[0])
    assert law.command.fbwa.roll.tolist() == [0.1] * 3
    assert not set(cache_folder().glob("*.step_law-*.code"))  # a name without a digest
    assert "; it is compiled for each run, as the value of Side in it is no number" in note
