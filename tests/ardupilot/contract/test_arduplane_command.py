"""`testbed arduplane`: tries an ArduPlane, played by a stand-in, and explains a parameter file."""

import json
import re

import pytest
from arduplanes import binary
from commands import call_command

assert binary  # a fixture
LOST, BAD_INPUT, EXTERNAL_PROGRAM_LOST = 1, 2, 5


def check(folder, code, *arguments):
    return call_command("arduplane", "check", *arguments, cwd=folder, code=code, columns=100)


def test_check_flies_and_says_what_it_found(binary, tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.cli.arduplane.FLOWN_S", 8.0)
    done = check(tmp_path, 0, "--json", "check.json")
    document = json.loads((tmp_path / "check.json").read_text())
    assert (document["ok"], document["version"]) == (True, "4.7.1 (stand-in)")
    assert document["flown_s"] == 8.0 and document["real_time_factor"] > 0.5
    assert document["difference"]["track_m"] < 2.0
    for words in ("4.7.1 (stand-in)", str(binary), "44 of the file", "× real time: completed"):
        assert words in done.stdout
    assert "flies like the virtual autopilot" in done.stdout
    said = " ".join(done.stderr.split())
    assert "/udp and" in said
    assert re.search(r"warning: ArduPlane itself listens on .* plus ten times \d+, of every", said)


def test_check_fails_if_it_disarms(binary, tmp_path, monkeypatch):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "disarm@600")
    monkeypatch.setattr("testbed.cli.arduplane.FLOWN_S", 6.0)
    done = check(tmp_path, LOST)
    assert "ArduPlane has disarmed: motor off" in done.stdout
    assert "does not fly like the virtual autopilot" in done.stdout


def test_check_names_an_unusable_program(binary, tmp_path, monkeypatch):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "exit@450")
    assert "stand-in: PANIC" in check(tmp_path, EXTERNAL_PROGRAM_LOST).stderr
    assert "no such program" in check(tmp_path, BAD_INPUT, "--arduplane", "nothing").stderr


@pytest.mark.parametrize("as_json", [False, True])
def test_params_lists_uses_and_differences(tmp_path, as_json):
    (tmp_path / "plane.param").write_text(
        "LIM_ROLL_CD,5500\nCOMPASS_OFS_X,31\nTECS_CLMB_MAX,4\nYAW2SRV_DAMP,0.2\nAHRS_EKF_TYPE,3\n"
        "THR_SLEWRATE,20\nTHR_SLEWRATE,30\n"
    )
    arguments = ("--json", "-") if as_json else ()
    done = call_command(
        *("arduplane", "params", "plane.param", *arguments), cwd=tmp_path, code=0, columns=100
    )
    if as_json:
        document = json.loads(done.stdout)
        assert document["unknown"] == ["THR_SLEWRATE"]
        assert document["hardware"] == ["COMPASS_OFS_X"]
        assert document["renamed"] == {"LIM_ROLL_CD": "ROLL_LIMIT_DEG 55"}
    lines = (done.stderr if as_json else done.stdout).splitlines()[1:]
    assert [line.split(maxsplit=1)[0] for line in lines] == [
        *("older", "both", "ArduPlane", "set", "left", "difference", "difference", "not", "note")
    ]


@pytest.mark.parametrize("line", ["INS_GYRO_FILTER 5000", "PTCH_RATE_P -1", "RLL2SRV_P 1"])
def test_params_refuses_what_a_flight_refuses(tmp_path, line):
    (tmp_path / "plane.param").write_text(f"STAB_PITCH_DOWN 2\n{line}\nPTCH2SRV_TCONST 0.5\n")
    arguments = ("arduplane", "params", "plane.param")
    done = call_command(*arguments, cwd=tmp_path, code=BAD_INPUT, columns=200)
    assert f"plane.param:2: {line.split()[0]} is " in done.stderr
    assert not done.stdout
