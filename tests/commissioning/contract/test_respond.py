"""The command respond: its table, what it points to, its files, and a fit that is written."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import ALL, some
from figure_texts import write_texts
from places import ROOT
from typer.testing import CliRunner

from testbed.airframes.powerplant import AircraftError
from testbed.autopilot.parameters import AutopilotTiming, read_params
from testbed.cli.main import app
from testbed.commissioning.airframe_variant import copy_with_factors
from testbed.commissioning.command_files import (
    RESPONSES,
    Commands,
    read_commands,
    sources_file,
    write_response,
    write_sources,
)
from testbed.commissioning.replay_commands import ReplaySetup, replay_one
from testbed.commissioning.response_comparison import best_shift, compare_response
from testbed.core.errors import InputError
from testbed.vehicle import jsbsim_adapter
from testbed.vehicle.jsbsim_adapter import airframe, trim_aircraft
from testbed.vehicle.trim import TrimPoint

RASCAL = ROOT / "aircraft" / "rascal110"
X8 = ROOT / "aircraft" / "skywalker_x8"
RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
ROWS = slice(50, 950)  # 36 s with turns to both sides


def call(*arguments):
    return CliRunner().invoke(app, ["respond", *map(str, arguments)])


@pytest.fixture(scope="module")
def setup():
    return ReplaySetup(read_params(RASCAL / "recorded.param"))


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    path = tmp_path_factory.mktemp("commands") / "commands.csv"
    lines = RECORDING.read_text().splitlines()
    path.write_text("\n".join((lines[0], *lines[1:][ROWS])) + "\n")
    return read_commands(path)


def fly(folder, commands, setup):
    return replay_one(folder, replace(commands, later_airspeed=None), setup)


def recorded_as(commands, response):
    """Take a response for the recording."""
    return replace(commands, recorded=dict(zip(RESPONSES, response.T, strict=True)))


@pytest.fixture(scope="module")
def model(commands, setup):
    return fly(RASCAL, commands, setup)


def findings(commands, recorded, model):
    return compare_response(recorded_as(commands, recorded), model).findings


def test_equal_responses_point_to_nothing(commands, model):
    found = compare_response(recorded_as(commands, model), model)
    assert found.findings == ()
    assert {each.rms for each in found.quantities.values()} == {0.0}


def test_late_commands_point_to_latency(commands, setup, model):
    late = replace(setup, timing=AutopilotTiming(command_latency=0.1))
    first, *others = findings(commands, fly(RASCAL, commands, late), model)
    assert first.startswith("latency: the recorded aileron is 80 ms behind the model's")
    assert others == []


def test_slow_commands_do_not_point_to_latency(commands, setup, model):
    """Roll commands of twice a second are late; only the rates of the log tell that from a lag."""
    sent = np.floor(2.0 * (commands.time_s - 0.25)) / 2.0 + 0.25
    last = np.maximum(np.searchsorted(commands.time_s, sent, side="right") - 1, 0)
    held = replace(commands, values=np.column_stack([commands.time_s, commands.values[last, 1:]]))
    replayed = fly(RASCAL, held, setup)
    known = replace(held, rates_hz={"phi_cmd_rad": 2.0, "theta_cmd_rad": 2.0})
    found = findings(known, model, replayed)
    text = "latency: cannot be found, as phi_cmd_rad came 2 times a second and its steps may be 500"
    assert found[0].startswith(text)
    assert not any("the recorded" in each or "mass" in each for each in found), found
    found = findings(held, model, replayed)
    ahead = re.match(r"latency: the recorded aileron is (\d+) ms ahead of the model's", found[0])
    assert int(ahead[1]) == pytest.approx(240, abs=10)
    fast = replace(held, rates_hz={"phi_cmd_rad": 25.0})
    assert findings(fast, model, replayed)[0] == found[0]


def test_gusts_share_the_blame_for_mean_differences():
    """A mean that gusts of the log may give is no fault of the aircraft; a larger one is."""
    time = np.arange(0.0, 150.0, 0.2)
    zeros = np.zeros((len(time), len(RESPONSES)))
    wind = np.sqrt(2.0) * np.column_stack([np.sin(0.7 * time), np.cos(0.7 * time)])

    def trim_findings(climb_mps, **known):
        recorded, model = zeros.copy(), zeros.copy()
        model[:, RESPONSES.index("v_down_mps")] = -climb_mps
        values = np.column_stack([time, np.zeros((len(time), 3))])
        flight = Commands(Path("c.csv"), (), values, {}, {}, None, **known)
        return compare_response(recorded_as(flight, recorded), model).findings

    (still,) = trim_findings(0.45)
    assert "climbs more, by 0.45 m/s on average: mass, drag, thrust" in still
    (gusty,) = trim_findings(0.45, wind_mps=wind)
    assert "mass" not in gusty and "climb rate +0.45 m/s may have other causes" in gusty
    assert "the wind varied by 1 m/s, and the model flies in still air" in gusty
    assert trim_findings(0.45, wind_mps=0.2 * wind) == (still,)  # hardly any gusts
    (large,) = trim_findings(2.0, wind_mps=wind)
    assert "by 2.00 m/s on average: mass, drag, thrust" in large
    (slow,) = trim_findings(0.45, rates_hz={"throttle_cmd": 4.0})
    assert "mass, drag" in slow  # steady


def test_rates_are_kept_beside_a_recording(commands, tmp_path):
    """What `write_sources` writes is read with the commands; an unusable file is refused."""
    path = tmp_path / "flight.csv"
    path.write_bytes(commands.path.read_bytes())
    assert read_commands(path).rates_hz == {}
    sources = {"phi_cmd_rad": "NAV_CONTROLLER_OUTPUT.nav_roll", "throttle": "0: not recorded"}
    write_sources(path, "flight.tlog", sources, {"phi_cmd_rad": 2.0})
    assert read_commands(path).rates_hz == {"phi_cmd_rad": 2.0}
    for text in ("[]", "{", '{"columns": {"a": {"rate_hz": "x"}}}', '{"columns": {"a": 3}}'):
        sources_file(path).write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="flight.sources.json: .*import the log again, or rem"):
            read_commands(path)
    sources_file(path).write_text('{"columns": {"a": {"rate_hz": 0}}}', encoding="utf-8")
    with pytest.raises(InputError, match="rate_hz must be above 0"):
        read_commands(path)
    sources_file(path).unlink()  # the remedy
    assert len(read_commands(path).values) == len(commands.values)


@pytest.mark.parametrize(
    ("factors", "text"),
    [
        ({"aileron": 0.8}, "airframe: the recorded aileron moves 1.17"),
        ({"drag": 1.3}, "m/s faster on average with the same throttle and pitch commands: drag"),
    ],
)
def test_changed_aircraft_points_to_its_change(commands, setup, model, factors, text, tmp_path):
    copy_with_factors(RASCAL, tmp_path / "changed", factors)
    found = findings(commands, fly(tmp_path / "changed", commands, setup), model)
    assert any(text in each for each in found), found
    assert not any("latency" in each for each in found), found


def test_shift_of_a_known_delay_is_found():
    time = np.arange(0.0, 20.0, 0.04)
    assert best_shift(time, np.sin(time - 0.13), np.sin(time)) == pytest.approx(0.13)


def test_heading_differences_are_wrapped(commands, model):
    turned = model.copy()
    turned[:, RESPONSES.index("psi_rad")] += 2.0 * math.pi - 0.01
    found = compare_response(recorded_as(commands, model), turned).quantities["heading"]
    assert found.rms == pytest.approx(math.degrees(0.01))


@pytest.mark.parametrize("folder", some([RASCAL, X8], 1), ids=lambda each: each.name)
def test_factors_change_what_they_name(folder, tmp_path):
    """Mass and drag by the trim; aileron and elevator by the deflection that they need."""
    point = TrimPoint(22.0)
    before, mass = trim_aircraft(folder, point), airframe(folder).mass
    trims = {}
    for name in ("mass", "drag", "aileron", "elevator"):
        copy_with_factors(folder, tmp_path / name, {name: 1.1})
        trims[name] = trim_aircraft(tmp_path / name, point)
    assert airframe(tmp_path / "mass").mass == pytest.approx(1.1 * mass, rel=1e-5)
    assert airframe(tmp_path / "drag").mass == pytest.approx(mass)
    assert trims["mass"].alpha > before.alpha + 0.002
    assert trims["drag"].controls.throttle > before.controls.throttle * 1.01
    for name in ("aileron", "elevator"):
        needed, then = (getattr(each.controls, name) for each in (trims[name], before))
        assert needed == pytest.approx(then / 1.1, rel=0.02)
    copy_with_factors(tmp_path / "drag", tmp_path / "back", {"drag": 1.0 / 1.1})
    assert trim_aircraft(tmp_path / "back", point).controls == before.controls


def test_factor_without_a_place_names_the_file(tmp_path):
    copy_with_factors(RASCAL, tmp_path / "bare", {})
    page = tmp_path / "bare" / "bare.xml"
    text = page.read_text().replace('name="DRAG"', 'name="X"')
    page.write_text(text.replace("13 </emptywt>", "0.2 </emptywt>"))
    with pytest.raises(AircraftError, match=r"bare.xml: has no .*DRAG.* \(leave drag out\)"):
        copy_with_factors(tmp_path / "bare", tmp_path / "a", {"drag": 1.1})
    with pytest.raises(AircraftError, match=r"bare.xml:\d+: <emptywt>: 0.5 times the mass is less"):
        copy_with_factors(tmp_path / "bare", tmp_path / "a", {"mass": 0.5})
    assert not (tmp_path / "a").exists()


def test_respond_prints_and_writes_what_is_asked(commands, model, tmp_path, monkeypatch):
    write_texts(monkeypatch)
    options = ("--plot", tmp_path / "p.svg", "--json", tmp_path / "r.json")
    done = call("rascal110", commands.path, tmp_path / "out.csv", *options)
    assert done.exit_code == 0
    assert "tune recorded" in done.stdout and "energy height" in done.stdout
    found = json.loads((tmp_path / "r.json").read_text())
    rms = compare_response(commands, model).quantities["roll"].rms
    assert found["quantities"]["roll"]["rms"] == pytest.approx(rms)
    assert "elevator" in (tmp_path / "p.svg").read_text()
    assert len(read_commands(tmp_path / "out.csv").values) == len(commands.values)


def test_respond_without_recorded_tune_says_so(commands, tmp_path):
    """And writes nothing that is not asked."""
    copy_with_factors(RASCAL, tmp_path / "other", {})
    (tmp_path / "other" / "recorded.param").unlink()
    before = sorted(tmp_path.rglob("*"))
    done = call(tmp_path / "other", commands.path)
    assert done.exit_code == 0 and sorted(tmp_path.rglob("*")) == before
    assert "tune: autopilot, as other has no recorded.param" in done.stderr
    assert "tune autopilot" in done.stdout


def test_fit_is_written_as_an_aircraft(commands, setup, tmp_path, monkeypatch):
    """An aircraft with 1.2 times the mass and 60 ms, found again without noise.

    The traits of the candidates are those of the Rascal, as in `test_fit_finds_planted_values`.
    """
    if not ALL:
        traits = jsbsim_adapter._find_traits(RASCAL)
        monkeypatch.setattr(jsbsim_adapter._find_traits, "_function", lambda folder: traits)
    copy_with_factors(RASCAL, tmp_path / "true", {"mass": 1.2})
    late = replace(setup, timing=AutopilotTiming(command_latency=0.06))
    commands = replace(commands, values=commands.values[:750])  # 30 s
    write_response(tmp_path / "flight.csv", commands, fly(tmp_path / "true", commands, late))
    options = ("--fit", "mass,latency", "--write", tmp_path / "fitted")
    done = call(RASCAL, tmp_path / "flight.csv", *options, "--json", tmp_path / "fit.json")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "fit.json").read_text())["fit"]["parameters"]
    assert found["mass"]["value"] == pytest.approx(1.2, abs=0.005)
    assert found["latency"]["value"] == pytest.approx(0.06, abs=0.002)
    source = (tmp_path / "fitted" / "SOURCE.md").read_text()
    assert re.search(r"^\| mass \| 1\.(19\d|2) \|", source, re.M)
    assert "command_latency_s: 0.04" in source
    again = call(tmp_path / "fitted", tmp_path / "flight.csv", "--latency", "0.06")
    assert "no difference that points to" in again.stdout
    unfitted = call(RASCAL, tmp_path / "flight.csv")  # negative control
    assert "m/s on average: mass" in " ".join(unfitted.stdout.split())


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--fit", "mass,lift"), "--fit: 'lift' cannot be fitted (write some of mass, drag"),
        (("--fit", "mass,mass"), "--fit: 'mass' is there twice"),
        (("--write", "new"), "--write: what is written is fitted (add --fit"),
        (("--fit", "mass", "--write", "."), "it exists; remove it or write another name"),
        (("--latency", "2"), "--latency 2: write 0 to 1 (s)"),
        (("--skip", "-1"), "--skip -1: write 0 or more"),
        (("--skip", "30", "--fit", "mass"), "6.0 s are left to fit to; at least 20 s"),
        (("--plot", "p.bmp"), "--plot p.bmp: write a name that ends in .png, .pdf, .svg"),
    ],
)
def test_respond_bad_options_are_errors(commands, options, text):
    error = call("rascal110", commands.path, *options).exception
    assert isinstance(error, InputError) and text in str(error)


def test_recorded_cell_must_be_a_number(tmp_path):
    path = tmp_path / "c.csv"
    path.write_text("t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd,phi_rad\n0,0,0,0.3,x\n")
    with pytest.raises(InputError, match=r"c.csv:2: column phi_rad: .* is not a finite number"):
        read_commands(path)
