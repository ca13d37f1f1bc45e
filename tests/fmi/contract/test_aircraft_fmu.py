"""An aircraft as an FMU flies the numbers of `testbed.Aircraft`, and keeps the standard."""

import json
import math
import os
import re
import shutil
import struct
import subprocess
import zipfile

import numpy as np
import pytest
from aircraft_copies import changed
from commands import call_command
from fmi2_importer import DISCARD, ERROR, MAC, Archive, Instance
from places import ROOT
from run_flight import small_grids

import testbed
from testbed.core.errors import InputError
from testbed.core.library import library
from testbed.fmi.aircraft_fmu import AircraftFmu, make_fmu
from testbed.fmi.description_writing import identifier

ALL = os.environ.get("TESTBED_FMUS") == "1"
SECONDS = 60.0 if ALL else 4.0
RASCAL = library() / "aircraft" / "rascal110"
WIND = [f"wind_ned[{k}]" for k in (1, 2, 3)]
TURNS = [f"wind_gradient_rates[{k}]" for k in (1, 2, 3)]
COMMAND = ["command.pitch", "command.roll", "command.throttle"]
START = [f"start.position_ned[{k}]" for k in (1, 2, 3)]
COHERENT = {"turbulence": {"model": "coherent", "intensity": "moderate"}}
MOST_BYTES = 100_000  # compressed, of one platform
# libraries of C and mathematics, and what the linker refers to where there is one
LIBC = {"calloc", "free", "malloc", "memcpy", "memset", "memcmp", "bcmp", "snprintf", "strcmp"}
LIBC |= {"strlen", "__stack_chk_fail", "__snprintf_chk", "__memcpy_chk", "nearbyint"}
LIBM = {"acos", "asin", "atan", "atan2", "cos", "exp", "fmod", "pow", "sin", "sincos", "sqrt"}


ECOS = """
import json, sys
from ecospy import EcosSimulation, EcosSimulationStructure
from ecospy.EcosParameterSet import EcosParameterSet
structure, start = EcosSimulationStructure(), EcosParameterSet()
structure.add_model("a", "rascal110.fmu")
values = {"start.airspeed": 22.0, "command.pitch": 0.02, "command.roll": 0.3,
          "command.throttle": 0.6}
for name, value in values.items():
    start.add_real(f"a::{name}", value)
structure.add_parameter_set("start", start)
simulation = EcosSimulation(structure=structure, step_size=0.02)
simulation.init(parameter_set="start")
for _ in range(500):
    simulation.step()
print(json.dumps([simulation.get_real(f"a::{name}") for name in sys.argv[1:]]))
simulation.terminate()
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What the command writes: the FMU and its JSON."""
    folder = tmp_path_factory.mktemp("fmu")
    words = ("--airspeed", "18:22:2", "--height", "100,500", "--out", "made/fmus")
    words += ("--json", "made.json")
    done = call_command("fmu", "rascal110", *words, cwd=folder, code=0, columns=100)
    assert "rascal110" in done.stdout and "trim at 20 m/s, 500 m" in done.stderr
    return (folder / "made/fmus/rascal110.fmu").read_bytes(), json.loads(
        (folder / "made.json").read_text()
    )


@pytest.fixture(scope="module")
def archive(written, tmp_path_factory):
    return Archive(written[0], tmp_path_factory.mktemp("unpacked"))


def command_at(time_s):
    """Commands that move all the time, to beyond the limits of bank."""
    side = 1.0 if time_s < 30.0 else -1.0
    roll = 0.9 * side * math.sin(0.31 * time_s)
    return 0.08 * math.sin(0.7 * time_s), roll, 0.5 + 0.3 * math.sin(0.2 * time_s)


def numbers_of(aircraft, names):
    """The numbers of `testbed.Aircraft` that the outputs of an FMU have."""
    fields = {**aircraft.truth._asdict(), **aircraft.air._asdict()}
    fields |= {f"surfaces.{name}": value for name, value in aircraft.surfaces._asdict().items()}
    found = []
    for name in names:
        field, _, part = name.rstrip("]").partition("[")
        found.append(fields[field][int(part) - 1] if part else float(fields[field]))
    return np.array(found)


def fly_beside(instance, aircraft, seconds):
    """Fly both by the same commands and wind; yield both numbers at each communication point."""
    names = instance.archive.outputs()
    for step in range(round(seconds / 0.02)):
        air, command = aircraft.air, command_at(0.02 * step)
        instance.set([*WIND, *TURNS, *COMMAND], [*air.wind_ned, *air.wind_gradient_rates, *command])
        instance.step()
        aircraft.step(*command)
        yield instance.get(names), numbers_of(aircraft, names)


@pytest.mark.parametrize("air", [None, COHERENT], ids=["calm", "turbulence"])
def test_numbers_are_those_of_the_testbed(archive, air, monkeypatch):
    small_grids(monkeypatch)  # the FMU is given the wind of a field of any size
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=20.0, air=air)
    instance = Instance(archive).begin()
    names = archive.outputs()
    np.testing.assert_array_equal(instance.get(names), numbers_of(aircraft, names))
    for ours, theirs in fly_beside(instance, aircraft, SECONDS):
        np.testing.assert_array_equal(ours, theirs)
    assert abs(ours[names.index("euler[1]")]) > 0.1  # it turns


def test_last_bit_of_the_mass_changes_the_numbers(archive):
    """A negative control of the test above: the mass is found in the state by its value.

    How many numbers differ depends on the processor, whose functions of libm round otherwise: from
    1 s on some differ at each point.
    """
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=20.0)
    (kind,) = aircraft.simulation._world.fleet.kinds
    mass = float(kind.state[0, kind.aircraft.columns["inertia/mass-slugs"]])
    instance = Instance(archive).begin()
    data, time = instance.serialize(instance.save())
    old, new = struct.pack("<d", mass), struct.pack("<d", math.nextafter(mass, math.inf))
    assert data.count(old) == 1
    instance.restore(instance.deserialize((data.replace(old, new), time)))
    pairs = list(fly_beside(instance, aircraft, 2.0))
    assert all(np.any(ours != theirs) for ours, theirs in pairs[50:])
    assert max(np.abs(ours - theirs).max() for ours, theirs in pairs) < 1e-6


def test_other_starts_are_those_of_the_testbed(archive):
    """On a course in wind: placed by another arithmetic than JSBSim's, so not to the bit."""
    air = {"wind": {"speed_mps": 5.0, "from_deg": 250.0}}
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=22.0, course_deg=57.0, air=air)
    instance = Instance(archive)
    instance.set(["start.airspeed", "start.course", *WIND], [22.0, math.radians(57.0), 0, 0, 0])
    instance.set(WIND, aircraft.air.wind_ned)
    instance.begin()
    pairs = list(fly_beside(instance, aircraft, SECONDS))
    assert max(np.abs(ours - theirs).max() for ours, theirs in pairs) < 1e-9
    # the ground speed is held from the first moment: no gust meets the aircraft at its start
    names = archive.outputs()
    assert abs(pairs[0][0][names.index("airspeed")] - 22.0) < 0.01


def test_start_is_chosen_by_parameters(archive):
    """Position and course; commands that are not set hold the trim of the airspeed."""
    instance, seen = Instance(archive), []
    instance.set(START, [500.0, -300.0, -120.0])
    instance.set(["start.course"], [math.pi / 2])
    for airspeed in (18.0, 22.0):  # values may change until the initialization ends
        instance.set(["start.airspeed"], [airspeed])
        seen.append(instance.get(["position_ned[1]", "position_ned[2]", "position_ned[3]"]))
        velocity = instance.get([f"velocity_ned[{k}]" for k in (1, 2, 3)])
        np.testing.assert_allclose(velocity, [0.0, airspeed, 0.0], atol=1e-9)
        np.testing.assert_allclose(seen[-1], [500.0, -300.0, -120.0], atol=1e-8)
    instance.begin()
    trim = testbed.Aircraft("rascal110", airspeed_mps=22.0)
    pitch = trim.truth.euler[1]
    assert instance.get(["command.pitch"]) == pytest.approx([pitch], abs=1e-12)
    instance.step(10.0)
    assert instance.get(["airspeed"]) == pytest.approx([22.0], abs=0.2)
    assert -instance.get(["position_ned[3]"]) == pytest.approx([120.0], abs=2.0)


def test_start_takes_the_trim_of_the_nearest_height(archive):
    """Its accelerations vanish where a trim was made, and nearly between two."""
    largest = []
    for height in (100.0, 500.0, 310.0):
        instance = Instance(archive)
        instance.set(["start.airspeed", START[2]], [20.0, -height])
        found = instance.begin().get([f"acceleration_ned[{k}]" for k in (1, 2, 3)])
        largest.append(np.abs(found).max())
    assert max(largest[:2]) < 1e-3 < largest[2] < 0.3


def test_saved_states_fly_on_alike(archive):
    names, instance, other = archive.outputs(), Instance(archive).begin(), Instance(archive).begin()
    instance.set(COMMAND, [0.1, 0.5, 0.7])
    instance.step(3.0)
    saved = instance.save()
    flights = []
    for state in (saved, instance.deserialize(instance.serialize(saved))):
        instance.restore(state)
        instance.step(2.0)
        flights.append(instance.get(names))
    np.testing.assert_array_equal(*flights)
    instance.restore(saved)
    for _ in range(100):  # steps of one period are those of many
        instance.step()
    np.testing.assert_array_equal(instance.get(names), flights[0])
    other.step(1.0)  # independent of the first
    instance.reset()
    instance.begin().step(1.0)
    np.testing.assert_array_equal(other.get(names), instance.get(names))
    data, time = instance.serialize(saved)
    other.deserialize((data[:-8], time), expected=ERROR)
    other.deserialize((b"x" + data[1:], time), expected=ERROR)
    assert other.messages[-1] == "the bytes are no state of this FMU"


def test_wrong_calls_are_refused(archive):
    def message():
        return instance.messages[-1]

    instance = Instance(archive, guid="{another}")
    assert instance.component is None and message().startswith("the guid is not that of")
    instance = Instance(archive)
    instance.step(expected=ERROR)
    assert message() == "fmi2DoStep is called after the initialization"
    for names, value, text in (
        (["airspeed"], 3.0, "airspeed: an output cannot be set"),
        (["command.roll"], math.nan, "command.roll: is not a finite number"),
    ):
        instance.set(names, [value], expected=ERROR)
        assert message() == text
    instance.set(["start.airspeed"], [19.0])
    instance.begin(expected=ERROR)
    assert message() == "start.airspeed: is 19 m/s: write one of 18, 20, 22"
    instance.set(["start.airspeed"], [18.0])
    instance.set(WIND[:1], [-30.0])
    instance.begin(expected=ERROR)
    assert message() == "start: the wind is too strong to fly its course over the ground"
    instance.set([*WIND[:1], START[2]], [0.0, 0.0])
    instance.begin(expected=ERROR)
    assert message() == "start: it is so low that the ground may touch it"
    instance.set(START[2:], [-100.0])
    instance.begin()
    instance.set(["start.course"], [1.0], expected=ERROR)
    assert message() == "start.course: can be set before the flight only"
    for step in (0.0, 0.03, -0.02, math.nan):
        instance.step(step, expected=ERROR)
        assert message().endswith("write a multiple of 0.02 s")
    instance.step(now=1.0, expected=ERROR)
    assert message() == "the step begins at 1 s, and the flight is at 0 s"
    before = instance.get(archive.outputs())
    instance.step()
    assert not np.array_equal(instance.get(archive.outputs()), before)


def test_flight_ends_at_the_ground(archive):
    """At the tick of the testbed, with the standard's signs of it."""
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=20.0)
    instance, names = Instance(archive).begin(), archive.outputs()
    dive = -0.4, 0.0, 0.2
    while aircraft.outcome is None:
        aircraft.step(*dive)
    instance.set(COMMAND, dive)
    instance.step(60.0, expected=DISCARD)
    terminated, time = instance.terminated()
    assert terminated and instance.ended() == 3
    assert time == pytest.approx(aircraft.time_s, abs=0.021)
    last = instance.get(names)
    np.testing.assert_array_equal(last[:3], numbers_of(aircraft, names)[:3])
    assert "so low that the ground may touch it" in instance.messages[-1]
    instance.step(now=time, expected=DISCARD)
    np.testing.assert_array_equal(instance.get(names), last)


@pytest.mark.skipif(MAC, reason="nm of macOS has other options")
def test_library_needs_c_and_mathematics_alone(written, archive):
    """No symbol of Python or numba, and at most 100 kB in the archive."""
    sizes = written[1]["libraries_bytes"]
    assert list(sizes.values()) and max(sizes.values()) < MOST_BYTES
    done = subprocess.run(
        ["nm", "-D", str(archive.path)], capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    needed = {row[-1].partition("@")[0] for row in rows if row[-2] == "U"}
    assert needed <= LIBC | LIBM and {"atan2", "memcpy"} <= needed
    defined = {row[-1] for row in rows if row[-2] == "T"}
    assert {name for name in defined if not name.startswith("fmi2")} == set()
    assert len(defined) == 34  # of the standard
    content = archive.path.read_bytes()
    assert not re.search(rb"Py[A-Z_]\w+|numba|NRT_", content)


def test_model_description_has_units_and_starts(archive, tmp_path, written):
    root = archive.root
    units = {each.get("name") for each in root.findall("UnitDefinitions/Unit")}
    assert {"m", "m/s", "m/s2", "rad", "rad/s", "1/s"} == units
    rows = root.findall("ModelVariables/ScalarVariable")
    for each in rows:
        (kind,) = each
        assert (kind.get("start") is None) == (each.get("causality") == "output")
        assert kind.get("unit") in units | {None} and each.get("description")
    outputs = [k + 1 for k, each in enumerate(rows) if each.get("causality") == "output"]
    for part in ("Outputs", "InitialUnknowns"):
        found = root.findall(f"ModelStructure/{part}/Unknown")
        assert [int(each.get("index")) for each in found] == outputs
    instance = Instance(archive)
    named = {each.get("name"): each[0].get("start") for each in rows if each[0].get("start")}
    np.testing.assert_array_equal(
        instance.get(list(named)), [float(value) for value in named.values()]
    )


def test_documentation_has_licences_and_digests(archive):
    folder = archive.folder / "documentation"
    page = (folder / "index.html").read_text("utf-8")
    for name in ("rascal110.xml", "Engines/rascal110_motor.xml", "autopilot.param"):
        assert re.search(rf"<td>{name}</td><td><code>[0-9a-f]{{64}}</code></td>", page)
    licence = (ROOT / "LICENSE").read_bytes()
    assert (folder / "licenses/testbed.txt").read_bytes() == licence
    own = folder / "licenses/rascal110/SOURCE.md"
    assert own.read_bytes() == (RASCAL / "SOURCE.md").read_bytes()


def test_fmpy_finds_no_problem(written, tmp_path):
    """FMPy requires much, so it is in an environment of its own."""
    program = shutil.which("fmpy")
    if program is None:
        pytest.skip("there is no fmpy on PATH")
    (tmp_path / "rascal110.fmu").write_bytes(written[0])
    done = subprocess.run(
        [program, "validate", "rascal110.fmu"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout.strip() == "No problems found.", done.stdout + done.stderr


def test_another_importer_flies_the_same_numbers(written, tmp_path):
    """Ecos, in C++: TESTBED_ECOS is a Python that has its package ecospy."""
    python = os.environ.get("TESTBED_ECOS")
    if python is None:
        pytest.skip("TESTBED_ECOS is not set to a Python with ecospy")
    (tmp_path / "rascal110.fmu").write_bytes(written[0])
    (tmp_path / "fly.py").write_text(ECOS)
    names = [f"position_ned[{k}]" for k in (1, 2, 3)]
    words = [python, "fly.py", *names]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=22.0)
    for _ in range(500):
        aircraft.step(0.02, 0.3, 0.6)
    assert json.loads(done.stdout.splitlines()[-1]) == aircraft.truth.position_ned.tolist()


def test_aircraft_that_only_jsbsim_flies_is_refused(tmp_path):
    part = '<function name="made/f"><random/></function><axis name="DRAG">'
    folder = changed(RASCAL, tmp_path, ('<axis name="DRAG">', part))
    wanted = AircraftFmu(folder, folder / "autopilot.param", [20.0])
    with pytest.raises(InputError, match="only JSBSim flies this aircraft") as error:
        make_fmu(wanted)
    assert "<random>" in str(error.value)


def test_names_of_libraries_are_those_of_c():
    names = {"rascal110": "rascal110", "my own-kite": "my_own_kite", "2much": "_2much", "é": "_"}
    assert {name: identifier(name) for name in names} == names


def test_archive_is_plain(written, tmp_path):
    (tmp_path / "it.zip").write_bytes(written[0])
    with zipfile.ZipFile(tmp_path / "it.zip") as archive:
        names = archive.namelist()
    assert names[0] == "modelDescription.xml"
    assert all(re.fullmatch(r"[\w./-]+", each) and ".." not in each for each in names)


@pytest.mark.skipif(not ALL, reason="TESTBED_FMUS=1: each is another FMU")
@pytest.mark.parametrize(("name", "hz"), [("skywalker_x8", 100), ("rascal110", 200), ("own", 100)])
def test_other_aircraft_and_rates_are_the_same(tmp_path, name, hz):
    """Also one of the user's, which is heavier; the same FMU twice."""
    folder = library() / "aircraft" / name
    if name == "own":
        copy = changed(RASCAL, tmp_path, (r">\s*[\d.]+\s*</emptywt>", ">14.5</emptywt>"))
        folder = copy.rename(tmp_path / "my own-kite")
        (folder / "rascal110.xml").rename(folder / "my own-kite.xml")
    wanted = AircraftFmu(folder, folder / "autopilot.param", [18.0], physics_hz=hz)
    made = make_fmu(wanted)
    assert made.data == make_fmu(wanted).data
    (tmp_path / "unpacked").mkdir()
    archive = Archive(made.data, tmp_path / "unpacked")
    for air in (None, COHERENT):
        aircraft = testbed.Aircraft(str(folder), airspeed_mps=18.0, physics_hz=hz, air=air)
        for ours, theirs in fly_beside(Instance(archive).begin(), aircraft, SECONDS):
            np.testing.assert_array_equal(ours, theirs)
