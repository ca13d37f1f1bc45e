"""The virtual autopilot against a flight of the real ArduPlane on the same airframe."""

import importlib
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from cases import ALL
from places import ROOT

from testbed.autopilot.parameters import AutopilotTiming, ParamError, read_params
from testbed.commissioning.command_files import CommandsError, read_commands, rows_flown
from testbed.commissioning.replay_commands import (
    AircraftLost,
    ReplayedAircraft,
    ReplaySetup,
    respond,
)
from testbed.commissioning.replay_commands import replay as fly_replay
from testbed.vehicle.environment import JSBSIM_DEFAULT_INTEGRATORS

RASCAL = ROOT / "aircraft" / "rascal110"
RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
WHOLE = os.environ.get("TESTBED_ARDUPLANE_WHOLE")
PERIOD_S = 0.02  # of the autopilot
SHORT_S = 150.0 if ALL or WHOLE else 80.0  # of flights with bounds that hold for its part, too
fly_recorded = partial(respond, integrators=JSBSIM_DEFAULT_INTEGRATORS)  # as the recording was


# The recording is of SITL with physics at 200 Hz, which has a gyro filter of 4 Hz.
SITL = AutopilotTiming(sitl_physics_hz=200.0)


@cache
def _table(path: Path) -> np.ndarray:
    """Read a table, whose file does not change any more."""
    table: np.ndarray = np.genfromtxt(path, delimiter=",", names=True)
    return table


def _difference(out: Path, column: str, start: float = 2.0) -> np.ndarray:
    flown = _table(out)
    recorded = _table(RECORDING)[: len(flown)]
    assert flown["t_s"][-1] >= SHORT_S - 0.1
    assert flown.dtype.names == recorded.dtype.names
    assert np.array_equal(flown["t_s"], recorded["t_s"])
    window = (recorded["t_s"] >= start) & (recorded["t_s"] <= 150.0)
    return (flown[column] - recorded[column])[window]


def _rms(out: Path, column: str, start: float = 2.0) -> float:
    return float(np.sqrt(np.mean(_difference(out, column, start) ** 2)))


def _rms_deg(out: Path, column: str, start: float = 2.0) -> float:
    return float(np.degrees(_rms(out, column, start)))


@pytest.fixture(scope="module")
def recorded_arduplane() -> Iterator[ModuleType]:
    """Provide the module that writes the tables of this recording."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    yield importlib.import_module("recorded_arduplane")
    del sys.path[0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Provide the first part of the recording."""
    path = tmp_path_factory.mktemp("recording") / "recording.csv"
    head, *rows = RECORDING.read_text().splitlines(keepends=True)
    path.write_text(head + "".join(r for r in rows if float(r.partition(",")[0]) <= SHORT_S))
    return path


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("respond") / "out.csv"
    fly_recorded(RASCAL, RECORDING, out, timing=SITL)
    return out


def test_roll_and_pitch_follow_the_recording(replay: Path) -> None:
    # Measured: 0.23° and 0.39°; the airframes differ in the elevator's drag (ORIGIN.md). The
    # requirement is 1.0° and 0.5°; the closer bound of roll detects a missing latency.
    assert _rms_deg(replay, "phi_rad") < 0.5
    assert _rms_deg(replay, "theta_rad") < 0.5


@pytest.fixture(scope="module")
def recorded_airframe(
    tmp_path_factory: pytest.TempPathFactory, recorded_arduplane: ModuleType
) -> Path:
    """Make the airframe of the recording, by the four changes that ORIGIN.md names."""
    folder: Path = recorded_arduplane.make_recorded_airframe(tmp_path_factory.mktemp("recorded"))
    return folder


def test_docs_have_the_measured_responses(replay: Path, recorded_arduplane: ModuleType) -> None:
    """The rows of our airframe in docs/autopilot.md, which `make arduplane` writes."""
    page = (ROOT / "docs" / "autopilot.md").read_text(encoding="utf-8")
    recorded, ours = map(recorded_arduplane.read, (RECORDING, replay))
    rows = [recorded_arduplane.rms_row(ours, recorded)]
    for _, begin_s, end_s in recorded_arduplane.TURNS:
        rows.append(recorded_arduplane.turn_row("", "ours", ours, begin_s, end_s))
    assert [line for line in rows if line not in page] == []
    pitch = recorded_arduplane.rms_deg(ours, recorded, "theta_rad")
    source = (RASCAL / "SOURCE.md").read_text(encoding="utf-8")
    assert f"with the square {pitch:.2f}°" in source


def test_law_alone_follows_the_recording(
    recorded_airframe: Path, recording: Path, tmp_path: Path
) -> None:
    """On the airframe of the recording servo outputs agree to the last µs.

    The first row with a command was written within one period after ArduPlane had read it.
    """
    out = tmp_path / "out.csv"
    fly_recorded(recorded_airframe, recording, out, timing=replace(SITL, command_latency=0.0))
    # The propeller's start is not that of the recording; it has decayed after 20 s.
    assert _rms_deg(out, "phi_rad", 20.0) < 0.1  # measured: 0.076
    assert _rms_deg(out, "theta_rad", 20.0) < 0.1  # 0.058
    assert _rms(out, "airspeed_mps", 20.0) < 0.1  # m/s; 0.05
    for surface in ("ail", "ele"):
        assert _rms(out, f"pwm_{surface}", 20.0) < 1.0  # µs; 0.56 and 0.62


def test_aircrafts_gyro_filter_misses_the_recording(
    recorded_airframe: Path, recording: Path, tmp_path: Path
) -> None:
    """Negative control: 20 Hz in place of SITL's 4 Hz; measured: 1.53 µs of aileron."""
    out = tmp_path / "out.csv"
    fly_recorded(recorded_airframe, recording, out, timing=AutopilotTiming(command_latency=0.0))
    assert _rms(out, "pwm_ail", 20.0) > 1.2


def test_latency_of_one_period_is_found(
    recorded_airframe: Path, recording: Path, tmp_path: Path
) -> None:
    """Roll is 0.13° from the recording and the aileron 2.7 µs; pitch hardly changes."""
    out = tmp_path / "out.csv"
    fly_recorded(recorded_airframe, recording, out, timing=replace(SITL, command_latency=PERIOD_S))
    assert _rms_deg(out, "phi_rad", 20.0) > 0.1
    assert _rms(out, "pwm_ail", 20.0) > 1.0


def test_descending_turns_follow_the_recorded_airframe(
    recorded_airframe: Path,
    recorded_arduplane: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Roll and pitch of fast descending turns; measured: 0.38° and 0.39°.

    A third of a flight of one seed of four; all of them, and the row in the docs, with
    TESTBED_ARDUPLANE_WHOLE=1.
    """
    if not WHOLE:
        monkeypatch.setattr(recorded_arduplane, "SEEDS", recorded_arduplane.SEEDS[:1])
        monkeypatch.setattr(recorded_arduplane, "END_S", 50.0)
        fly = recorded_arduplane.replay

        def replay(airframe: Path, *arguments: object, **others: object) -> object:
            """Fly no late commands with that airframe: a number of the docs alone."""
            late = airframe == recorded_airframe and not arguments
            return {} if late else fly(airframe, *arguments, **others)

        monkeypatch.setattr(recorded_arduplane, "replay", replay)
    each = recorded_arduplane.FAST[1]
    ours, real, late = recorded_arduplane.fly_manoeuvres(tmp_path, recorded_airframe, each)
    assert recorded_arduplane.rms_deg(ours, real, "phi_rad") < 0.5
    assert recorded_arduplane.rms_deg(ours, real, "theta_rad") < 0.5
    page = (ROOT / "docs" / "autopilot.md").read_text(encoding="utf-8")
    assert not WHOLE or recorded_arduplane.fast_row(each, ours, real, late) in page


def test_servo_travel_matters(recording: Path, tmp_path: Path) -> None:
    """With the total servo travel the gain of the roll loop is 25 % too large."""
    tune = tmp_path / "whole.param"
    lines = (RASCAL / "recorded.param").read_text()
    tune.write_text(lines.replace("_MIN 1100", "_MIN 1000").replace("_MAX 1900", "_MAX 2000"))
    fly_recorded(RASCAL, recording, tmp_path / "out.csv", param=tune, timing=SITL)
    assert _rms_deg(tmp_path / "out.csv", "phi_rad") > 0.8


def test_replay_needs_four_columns(recording: Path, tmp_path: Path) -> None:
    commands = tmp_path / "commands.csv"
    rows = [line.split(",")[:4] for line in recording.read_text().splitlines()]
    commands.write_text("\n".join(",".join(row) for row in rows) + "\n")
    fly_recorded(RASCAL, commands, tmp_path / "out.csv")
    # It starts 1.3 m/s slower than the recording, which affects the first seconds.
    assert _rms_deg(tmp_path / "out.csv", "phi_rad") < 0.5
    assert _rms_deg(tmp_path / "out.csv", "theta_rad") < 0.5


def test_unsteady_start_has_a_warning(tmp_path: Path) -> None:
    commands, lines = tmp_path / "commands.csv", []
    recording = RECORDING.read_text().splitlines(keepends=True)
    commands.write_text("".join(recording[:60]))
    respond(RASCAL, commands, tmp_path / "out.csv", warn=lines.append)
    (line,) = lines
    assert "airspeed_mps is 23.3 in the first row, where the replay starts in trim" in line
    assert "and 25.6 after 0.1 s" in line
    assert "write --airspeed" in line
    respond(RASCAL, commands, tmp_path / "out.csv", airspeed=24.6, warn=lines.append)
    commands.write_text("".join((recording[0], *recording[100:160])))
    respond(RASCAL, commands, tmp_path / "out.csv", warn=lines.append)
    assert len(lines) == 1


def test_replays_are_bit_identical(tmp_path: Path) -> None:
    commands = tmp_path / "commands.csv"
    commands.write_text("".join(RECORDING.read_text().splitlines(keepends=True)[:400]))
    respond(RASCAL, commands, tmp_path / "a.csv")
    respond(RASCAL, commands, tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


GOOD = "t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd\n0,0,0,0.3\n0.04,0,0,0.3\n"


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "column t_s"),
        ("t_s,theta_cmd_rad,phi_cmd_rad\n", ":1: column throttle_cmd"),
        (GOOD.replace("t_s", "t_s,t_s"), ":1: column t_s"),
        (GOOD.splitlines()[0], ":2: column t_s"),
        (GOOD + "0.08,0,x,0.3\n", ":4: column phi_cmd_rad"),
        (GOOD + "0.08,nan,0,0.3\n", ":4: column theta_cmd_rad"),
        (GOOD + "0.08,0,0,30\n", ":4: column throttle_cmd"),
        (GOOD + "0.08,0,45,0.3\n", ":4: column phi_cmd_rad"),
        (GOOD + "0.08,0,0\n", ":4: column 4"),
        (GOOD + "0.04,0,0,0.3\n", ":4: column t_s"),
        (GOOD + "1e9,0,0,0.3\n", ":4: column t_s"),
    ],
)
def test_replay_bad_commands_name_file_and_line(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "commands.csv"
    path.write_text(text)
    with pytest.raises(CommandsError) as error:
        read_commands(path)
    assert str(path) in str(error.value)
    assert where in str(error.value)


def test_replay_missing_files_are_errors(tmp_path: Path) -> None:
    with pytest.raises(CommandsError, match="nothing.csv"):
        read_commands(tmp_path / "nothing.csv")
    with pytest.raises(ParamError, match="nothing.param"):
        respond(RASCAL, RECORDING, tmp_path / "o.csv", param=tmp_path / "nothing.param")


def test_replay_lost_aircraft_keeps_its_rows(tmp_path: Path) -> None:
    commands = tmp_path / "dive.csv"
    rows = "".join(f"{0.1 * k:.1f},-0.3,0,0\n" for k in range(100))
    commands.write_text("t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd\n" + rows)
    with pytest.raises(AircraftLost, match="lost at"):
        respond(RASCAL, commands, tmp_path / "out.csv", altitude=10.0)
    flown = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)
    assert 5 < len(flown["t_s"]) < 100
    assert flown["altitude_m"][-1] < 4.0  # where the ground may touch it, and a sample earlier
    setup = ReplaySetup(read_params(RASCAL / "recorded.param"), altitude=10.0)
    both = [ReplayedAircraft(RASCAL, 0.02, speed) for speed in (20.0, 28.0)]
    flown = [rows_flown(each) for each in fly_replay(both, read_commands(commands), setup)]
    assert 5 < flown[1] < flown[0] < 100  # the first flies on beside the lost one
