"""`testbed new aircraft` with aircraft of JSBSim's own collection."""

import json
import re
import shutil
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from cases import ALL
from commands import call_command
from figure_texts import write_texts

import testbed
from testbed.airframes.powerplant import AircraftError
from testbed.autopilot.parameters import read_params
from testbed.commissioning import check_flight, step_responses
from testbed.commissioning.airframe_import import copy_aircraft
from testbed.commissioning.check_flight import DURATION_S, check_and_soften
from testbed.commissioning.first_gains import softened
from testbed.commissioning.step_responses import ResponseError, measure_steps, start_of
from testbed.scenario import find_aircraft, load_middle_loop, load_scenario, loads
from testbed.vehicle.jsbsim_adapter import SHARED_FILES, linearize_aircraft, trim_aircraft
from testbed.vehicle.trim import TrimPoint

COLLECTION = SHARED_FILES / "aircraft"
FORMATION = """
scenario: {{schema: 2, name: two, duration_s: 80, windows: {{straight: [60, 80]}}}}
leader:
  aircraft: {folder}
  start: {{altitude_m: 400}}
  path: {{kind: virtual, speed_mps: {speed}, curve: {{kind: straight}}}}
fleet:
  - {{name: uav1, aircraft: {folder}, start_m: [-50, 25, 0]}}
  - {{name: uav2, aircraft: {folder}, start_m: [-50, -25, 0]}}
formation:
  offsets_m: {{uav1: [-30, 25, 0], uav2: [-30, -25, 0]}}
  leader_gains: {{uav1: 1, uav2: 1}}
  speed_mps: {speeds}
"""


class Kind(NamedTuple):
    """An aircraft of the collection.

    Attributes:
        file: its name.
        engines: files of its engine and thruster.
        speed: of its cruise, m/s.
        slowest: m/s, above that of its slowest level flight.
        fastest: (low, high), m/s, about that of its fastest level flight.
        circle_s: when its formation of three is on the circle.
    """

    file: str
    engines: tuple[str, str]
    speed: float
    slowest: float
    fastest: tuple[float, float]
    circle_s: float


TURBOPROP = Kind("t6texan2", ("PT6A-68", "direct"), 85.0, 50.0, (140.0, 160.0), 90.0)
# a fixed propeller, which settles after each change of the throttle: ten times as slow
PISTON = Kind("c172p", ("eng_io320", "prop_75in2f"), 55.0, 30.0, (60.0, 75.0), 70.0)


def file_of(name):
    return COLLECTION / name / f"{name}.xml"


def new_aircraft(cwd, file, *options, code=0):
    arguments = "new", "aircraft", file_of(file) if isinstance(file, str) else file, *options
    return call_command(*arguments, cwd=cwd, code=code, columns=100)


@pytest.fixture(scope="module", params=[TURBOPROP, *[PISTON] * ALL], ids=lambda each: each.file)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def kite(kind, tmp_path_factory):
    """Folder, document and output of a new aircraft."""
    cwd = tmp_path_factory.mktemp("new")
    options = "--speed", kind.speed, "--into", cwd / "kite", "--json", cwd / "found.json"
    options += "--plot", cwd / "printed.png", "--width", 3.5, "--no-title"
    with pytest.MonkeyPatch.context() as patch:
        write_texts(patch)
        done = new_aircraft(cwd, kind.file, *options)
    return cwd / "kite", json.loads((cwd / "found.json").read_text()), done


def test_new_aircraft_has_all_its_files(kite, kind):
    folder, document, done = kite
    files = {str(each.relative_to(folder)) for each in folder.rglob("*") if each.is_file()}
    assert files == {
        *("kite.xml", *(f"Engines/{each}.xml" for each in kind.engines), "autopilot.param"),
        *("middle_loop.yaml", "guidance.yaml", "envelope.png", "SOURCE.md"),
        "formation-of-three.yaml",
    }
    assert (folder / "kite.xml").read_bytes() == file_of(kind.file).read_bytes()
    assert [each.name for each in folder.parent.iterdir() if each.is_dir()] == ["kite"]
    assert document["aircraft"] == "kite" and document["cut"] == document["declared"] == []
    for text in ("level flight", "fly-by-wire A", "testbed trim", "formation.speed_pole_per_s"):
        assert text in done.stdout
    kept, printed = (
        (folder.parent / name).read_text("utf-8").splitlines()
        for name in ("kite/envelope.png", "printed.png")
    )
    assert printed[0] == "png 1050" != kept[0]  # 3.5 inches of 300 dots
    titles = [each for each in kept[1:] if each not in printed]
    assert titles[0] == "Level flight of kite" and len(titles) == 2
    for text in ("trim …", "step responses …", "60 s of fly-by-wire A …"):
        assert text in done.stderr


def test_new_aircraft_follows_its_autopilot(kite, kind):
    _, document, _ = kite
    level, last = document["level_flight"], document["flights"][-1]
    low, high = kind.fastest
    assert level["lowest"] < kind.slowest < kind.speed < low < level["highest"] < high
    assert last["problem"] == "" and last["flown_s"] == DURATION_S
    assert last["roll_rise_s"] < 1.2 and abs(last["roll_overshoot"]) < 0.05
    assert last["pitch_rise_s"] < 0.6 and abs(last["pitch_overshoot"]) < 0.1


def test_written_gains_are_those_of_the_document(kite, kind):
    folder, document, _ = kite
    params = read_params(folder / "autopilot.param")
    assert params.airspeed_stall < params.airspeed_min < params.airspeed_cruise
    assert params.airspeed_cruise < params.airspeed_max
    gains = load_middle_loop(folder, "tuned")
    assert gains.course.p == document["middle_loop"]["course"]["p"]
    assert gains.trim_airspeed_mps == kind.speed
    source = (folder / "SOURCE.md").read_text(encoding="utf-8")
    assert "no number was measured on a real aircraft" in source
    assert f"{document['speed_pole_per_s']:.2f} 1/s" in source


def test_formation_of_new_aircraft_flies(kite, kind, tmp_path):
    """In its own folder: three behind a fourth, within the speeds of the autopilot, on a climb."""
    folder, document, _ = kite
    file = folder / "formation-of-three.yaml"
    flown = testbed.run(file, duration_s=kind.circle_s, out=tmp_path / "run")
    errors = flown.metrics["windows"]["circle"]["rms_m"]
    assert set(errors) == {"uav1", "uav2", "uav3"} and max(errors.values()) < 1.0
    assert flown.outcome == "completed"
    pole = load_scenario(str(file)).formation.speed_pole_per_s
    assert pole == pytest.approx(document["speed_pole_per_s"], abs=0.01)


def test_two_new_aircraft_hold_their_slots(kite, kind):
    """The aim is 0.1 m RMS straight; measured 0.03 of the turboprop, 0.04 of the piston."""
    folder, _, _ = kite
    speeds = [kind.speed - 15.0, kind.speed + 15.0]
    text = FORMATION.format(folder=folder, speed=kind.speed, speeds=speeds)
    flown = testbed.run(loads(text), write=False)
    errors = flown.metrics["windows"]["straight"]["rms_m"]
    assert set(errors) == {"uav1", "uav2"} and max(errors.values()) < 0.1


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("ball", "that is no aeroplane"),
        ("J246", "has a rocket engine"),
        ("ah1s", "has a rotor"),
        ("C130", "a turbine on a propeller"),
        ("ZLT-NT", "is carried by a gas cell"),
        ("blank", "begins with <FDM_CONFIG>"),
    ],
)
def test_what_is_no_aeroplane_is_refused(tmp_path, name, reason):
    done = new_aircraft(tmp_path, name, code=2)
    assert reason in done.stderr and str(tmp_path) not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_existing_folder_is_refused(tmp_path):
    (tmp_path / "c172p").mkdir()
    done = new_aircraft(tmp_path, "c172p", code=2)
    assert "c172p: it exists; remove it or write another name" in done.stderr
    done = new_aircraft(tmp_path, "c172p", "--into", "a b", code=2)
    assert "--into" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["c172p"]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("nothing.xml",), "nothing.xml: cannot be read"),
        ((".",), "the name '': an aircraft has letters"),
        (("/dev/zero",), "it is a device"),
        (("x.xml", "--into", "nowhere/kite"), "--into nowhere/kite: there is no folder"),
        (("x.xml", "--speed", "nan"), "--speed nan: write a finite number"),
        (("x.xml", "--speed", "0"), "--speed 0: write 1 to 340 (m/s)"),
        (("x.xml", "--speed", "1e300"), "--speed 1e+300: write 1 to 340 (m/s)"),
    ],
)
def test_wrong_arguments_are_refused(tmp_path, arguments, error):
    done = call_command("new", "aircraft", *arguments, cwd=tmp_path, code=2, columns=100)
    assert error in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_speed_without_level_flight_is_refused(tmp_path):
    """The residual has its axis, and the suggested speed is one of level flight."""
    done = new_aircraft(tmp_path, RASCAL / "rascal110.xml", "--speed", "40", code=2)
    assert "trim at 40 m/s" in done.stderr
    found = re.search(
        r"an acceleration of -1.\d m/s² forward remains at throttle 1.00, elevator -0.08, angle of "
        r"attack -2.1° \(it trims at (\S+) m/s\)$",
        " ".join(done.stderr.split()),
    )
    assert trim_aircraft(RASCAL, replace(CRUISE, airspeed=float(found[1]))).residual < 1e-4
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def brief_check(monkeypatch):
    """Fly a step of each angle and back; the whole flight is that of the kite."""
    if not ALL:
        steps = (0.0, 0.0, 0.0), (2.0, 30.0, 0.0), (12.0, 0.0, 0.0), (20.0, 0.0, 4.0)
        monkeypatch.setattr(check_flight, "_COMMANDS", (*steps, (26.0, 0.0, 0.0)))
        monkeypatch.setattr(check_flight, "DURATION_S", 32.0)


@pytest.fixture
def brief_steps(monkeypatch):
    """Fly as long as signs need; slow responses of the throttle are those of the kite."""
    if not ALL:
        monkeypatch.setattr(step_responses, "THROTTLE_S", step_responses.PITCH_S)


@pytest.mark.usefixtures("brief_check", "brief_steps")
def test_glider_descends_at_each_speed(tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.views.matplotlib_backend.save_figure", lambda *_: None)
    done = new_aircraft(tmp_path, "SGS", "--json", "-")
    document = json.loads(done.stdout)
    assert len(document["trims"]) >= 3 and document["speed_pole_per_s"] is None
    assert all(-3.0 < each["climb_mps"] < -0.5 for each in document["trims"])
    assert document["flights"][-1]["problem"] == ""
    assert " glide " in done.stderr and "sink" in done.stderr


RASCAL, CRUISE = find_aircraft("rascal110"), TrimPoint(22.0, altitude=400.0)


def test_steps_agree_with_the_linearised_aircraft():
    """Rates per full command: −L_δa / L_p, and M_δe for the first acceleration of the pitch."""
    steps = measure_steps(RASCAL, CRUISE)
    linear = linearize_aircraft(RASCAL, CRUISE, start_of(CRUISE)[1])
    roll, pitch = 6, 2  # rows of p and q
    assert steps.roll_rate == pytest.approx(-linear.b[roll, 0] / linear.a[roll, roll], rel=0.15)
    assert steps.pitch_acceleration == pytest.approx(linear.b[pitch, 1], rel=0.4)
    assert steps.pitch_acceleration < linear.b[pitch, 1]


@pytest.mark.usefixtures("brief_check")
def test_ringing_gains_are_softened():
    """A large integral and no time constant ring, which is found, and ended by softening."""
    good = read_params(RASCAL / "autopilot.param")
    wild = replace(good, rll_rate_p=0.19, rll_rate_i=4.1, rll2srv_tconst=0.05, rll2srv_rmax=0.0)
    flown = []
    last = check_and_soften(RASCAL, CRUISE, wild, flown.append)
    assert flown[0].ringing == ("roll",) and "roll rings" in flown[0].problem
    assert last.problem == "" and 1 <= last.softenings <= 4
    assert len(flown) == last.softenings + 1
    expected = wild
    for _ in range(last.softenings):
        expected = softened(expected, "roll")
    assert last.params == expected
    assert np.isclose(expected.rll_rate_p, wild.rll_rate_p / 2**last.softenings, rtol=0.01)
    assert expected.ptch_rate_p == wild.ptch_rate_p


def changed_rascal(folder, old, new):
    """Copy the Rascal with another text in place of the first one of its flight control."""
    shutil.copytree(RASCAL, folder)
    file = folder / f"{folder.name}.xml"
    (folder / "rascal110.xml").rename(file)
    before, found, after = file.read_text(encoding="utf-8").partition(old)
    assert found
    file.write_text(before + new + after, encoding="utf-8")
    return folder


SIGNS = {
    "aileron": ("rolls the aircraft to the right", 90.5),
    "elevator": ("pitches the aircraft up", 52.2),
    "rudder": ("yaws the aircraft to the right", 27.4),
}


@pytest.mark.usefixtures("brief_steps")
@pytest.mark.parametrize("control", SIGNS)
def test_reversed_control_has_its_measured_sign(control, tmp_path):
    """The rate is that of the right sign, which no error has (the test above)."""
    name = f"fcs/{control}-cmd-norm"
    folder = changed_rascal(tmp_path / "reversed", f"<input> {name}", f"<input> -{name}")
    way, rate = SIGNS[control]
    text = rf"the {control} acts the wrong way: a command that {way} gives -(\d+\.\d)°/s"
    with pytest.raises(ResponseError) as caught:
        measure_steps(folder, CRUISE)
    assert float(re.match(text, str(caught.value))[1]) == pytest.approx(rate, abs=0.2)
    assert "change the sign in the flight control" in str(caught.value)


THROTTLE = """</channel><channel name="throttle"><fcs_function name="fcs/throttle"><function>
<difference><value>1</value><property>fcs/throttle-cmd-norm[0]</property></difference>
</function><output>fcs/throttle-pos-norm[0]</output></fcs_function></channel>"""


@pytest.mark.usefixtures("brief_steps")
def test_reversed_throttle_is_named(tmp_path):
    folder = changed_rascal(tmp_path / "slow", "</channel>", THROTTLE)
    text = "the throttle acts the wrong way: within the first 2 s a full one makes the aircraft 4"
    with pytest.raises(ResponseError, match=text):
        measure_steps(folder, CRUISE)


def test_aircraft_with_engines_beside_it_flies(tmp_path):
    """Files beside the aircraft are copied to where JSBSim looks; there they are found."""
    folder = changed_rascal(tmp_path / "flat", "<propulsion>", "<propulsion>")
    names = {each.name for each in (folder / "Engines").iterdir()}
    for name in names:
        (folder / "Engines" / name).rename(folder / name)
    copied = copy_aircraft(folder / "flat.xml", tmp_path / "new", SHARED_FILES)
    assert {each.name for each in (copied.main.parent / "Engines").iterdir()} == names
    assert trim_aircraft(copied.main.parent, CRUISE).residual < 1e-4
    text = r"there is no propeller_18in.xml in the aircraft's folder Engines \(move the one beside"
    with pytest.raises(AircraftError, match=text):
        trim_aircraft(folder, CRUISE)
    for name in names:  # the remedy
        (folder / name).rename(folder / "Engines" / name)
    assert trim_aircraft(folder, CRUISE).residual < 1e-4
