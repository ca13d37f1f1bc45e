"""Each element that is translated, against JSBSim to the bit; faults, and what is refused."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from compiled_elements import BLADES, FAULTS, MADE, STICK, channel, functions, make
from places import SHARED

from testbed.compiled import NotTranslated
from testbed.compiled.translate import translate

SCRIPT = SHARED / "compiled_elements.py"


@pytest.fixture(scope="module")
def differences(tmp_path_factory):
    done = subprocess.run(
        [sys.executable, SCRIPT, tmp_path_factory.mktemp("made")],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", [*MADE, "twin", "elevons", "glider"])
def test_elements_equal_jsbsim(differences, name):
    assert differences[name] == ""


@pytest.mark.parametrize("name", FAULTS)
def test_the_proof_finds_a_planted_fault(differences, name):
    assert "a difference of" in differences[name]


FUNCTION = '<axis name="DRAG">'
CHANNEL = "</flight_control>"
REFUSED = {
    "random": (FUNCTION, functions({"x": "<random/>"}), "<random>"),
    "pid": (CHANNEL, channel({"pid": f"{STICK}<kp> 1 </kp>"}), "<pid>"),
    "delay": (CHANNEL, channel({"summer": f"{STICK}<delay> 3 </delay>"}), "<delay>"),
    "trigger": (CHANNEL, channel({"integrator": f"{STICK}<trigger> a </trigger>"}), "<trigger>"),
    "gauge": (
        CHANNEL,
        channel({"summer": "<input> simulation/sim-time-sec </input>"}),
        "<input> reads simulation/sim-time-sec",
    ),
    "shared": (
        CHANNEL,
        channel(
            {
                "lag_filter": f"{STICK}<c1> 9 </c1>",
                "summer": f"{STICK}<output> fcs/made-lag_filter </output>",
            }
        ),
        "<lag_filter> has the output fcs/made-lag_filter, which another component writes",
    ),
    "execrate": (CHANNEL, channel({}).replace("name=", 'execrate="2" name='), "execrate"),
    "frame": ('<axis name="ROLL">', '<axis name="ROLL" frame="STABILITY">', "frame"),
    "pitch": (
        BLADES,
        f"<minpitch> 10 </minpitch> <maxpitch> 30 </maxpitch> {BLADES}",
        "variable pitch",
    ),
    "tip": (BLADES, f'{BLADES} <table name="CT_MACH"/>', "CT_MACH"),
    "mixed": ('<axis name="DRAG">', '<axis name="X">', "<axis>"),
    "writes": (
        CHANNEL,
        channel({"summer": f"{STICK}<output> aero/alpha-rad </output>"}),
        "writes aero/alpha-rad",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_translated_is_refused(tmp_path, name):
    """The message has file, line and element."""
    old, new, words = REFUSED[name]
    folder = make(tmp_path, "made", [(old, new)])
    with pytest.raises(NotTranslated) as caught:
        translate(folder, lambda _: 1.0)
    message = str(caught.value)
    file, line, _ = message.split(":", 2)
    assert folder in Path(file).parents
    text = Path(file).read_text().splitlines()[int(line) - 1]
    assert message.split("<")[1].split(">")[0].split()[0] in text
    assert words in message
