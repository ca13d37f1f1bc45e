"""Process that draws aircraft from JSBSim's grammar and validates a scenario with each.

Its last arguments are COUNT and FOLDER, which is empty. It answers with one line of JSON: how many
were good and refused, and the faults. Each aircraft is validated in a copy of this process, so that
a crash ends only the copy. Files written, programs, sockets, tracebacks and other exit codes than 0
and 2 are faults.
"""

import json
import os
import random
import shutil
import signal
import sys
from collections import Counter
from pathlib import Path

from testbed.airframes.airframe_grammar import GRAMMAR
from testbed.cli.main import main
from testbed.scenario import library

SEED = 20261126
LONGEST_S = 60  # of one aircraft
PROGRAMS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "socket.bind")
WRITE = "simulation/write-state-file"
# Properties, most of which act, in the spellings that reach them.
ACTING = (
    WRITE,
    "simulation/terminate",
    "simulation/reset",
    "simulation/pause",
    "simulation/force-output",
    "simulation/do_simple_trim",
    "simulation/do_linearization",
    "simulation/randomseed",
    "simulation/integrator/rate/rotational",
    "inertia/print-mass-properties",
    "forces/hold-down",
    "position/h-sl-ft",
    "atmosphere/wind-north-fps",
)
OWN = ("own/x", "fcs/own", "aero/own", "propulsion/engine[0]/own", "/controls/own", "systems/a/b")
SPELLINGS = (
    "{0}",
    "/fdm/jsbsim/{0}",
    "fcs/../{0}",
    "./{0}",
    "fcs//../{0}",
    " {0} ",
    "own/x&#10;{0}",
    "{0}[0]",
    "<![CDATA[{0}]]>",
    "own<!-- -->/{0}",
)
WRITERS = (
    '<system name="s"><property value="1">{0}</property></system>',
    '<system name="s"><channel name="c"><fcs_function name="own/f"><function><value>1</value>'
    "</function><output>{0}</output></fcs_function></channel></system>",
    '<system name="s"><channel name="c"><summer name="own/s"><input>simulation/sim-time-sec</input>'
    "<bias>1</bias><output>{0}</output></summer></channel></system>",
    '<system name="s"><channel name="c"><pure_gain name="{1}"><input>simulation/sim-time-sec'
    "</input><gain>1</gain></pure_gain></channel></system>",
    '<system name="s"><channel name="c"><distributor name="own/d" type="inclusive"><case>'
    '<property value="1">{0}</property></case></distributor></channel></system>',
    '<system name="s"><function name="{1}"><value>1</value></function></system>',
    '<system name="s"><property>own/y</property><function name="own/g" copyto="{1}"><value>1'
    "</value></function></system>",
    '<external_reactions><force name="{1}" frame="BODY"><location unit="M"><x>0</x><y>0</y><z>0</z>'
    "</location><direction><x>1</x><y>0</y><z>0</z></direction></force></external_reactions>",
    "<external_reactions><property>{0}</property></external_reactions>",
)
ACTORS = (
    '<child name="evil"/>',
    '<child name="evil"><location unit="IN"><x>0</x><y>0</y><z>0</z></location></child>',
    '<output name="out.csv" type="CSV" rate="100"><rates>ON</rates></output>',
    '<output name="../out.csv" type="TABULAR" rate="100"><rates>ON</rates></output>',
    '<output name="localhost" type="SOCKET" port="41235" protocol="UDP" rate="9"/>',
    '<output file="Systems/more"/>',
    '<input port="41234" type="SOCKET"/>',
    '<planet file="evil"/>',
    '<initialize file="evil"/>',
    '<!DOCTYPE fdm_config [<!ENTITY a SYSTEM "evil.xml">]>',
)
FILES = (
    "more",
    "Systems/more",
    "more.xml",
    "../evil/evil",
    "..\\evil\\evil",
    "linked",
    "evil",
    "./more",
    "{0}/evil/evil",
    "{0}/evil/evil.xml",
    "no/such",
    "own motor",
)
USERS = (
    '<system file="{0}"/>',
    '<autopilot file="{0}"/>',
    '<flight_control file="{0}"/>',
    '<aerodynamics file="{0}"/>',
    '<propulsion file="{0}"/>',
    '<metrics file="{0}"/>',
    '<external_reactions file="{0}"/>',
    '<propulsion><engine file="{0}"><thruster file="{0}"/></engine></propulsion>',
    '<system name="t"><channel name="c"><pure_gain name="own/z" file="{0}"/></channel></system>',
)


def draw_tree(rng, depth=0):
    """Draw an element of the grammar with children that need not belong there."""
    name = rng.choice(sorted(GRAMMAR))
    inside = (
        "".join(draw_tree(rng, depth + 1) for _ in range(rng.randrange(3))) if depth < 3 else ""
    )
    text = rng.choice(("", "1", "-1", rng.choice(OWN), rng.choice(ACTING)))
    given = rng.choice(("", ' name="own/t"', f' name="{WRITE}"', ' file="more"', ' value="1"'))
    return f"<{name}{given}>{text}{inside}</{name}>"


def draw_property(rng):
    name = rng.choice(OWN) if rng.random() < 0.3 else rng.choice((WRITE, *ACTING))
    return rng.choice(SPELLINGS).format(name) if rng.random() < 0.5 else name


def draw_fragment(rng, folder):
    kind = rng.randrange(20)
    if kind < 8:
        return rng.choice(WRITERS[:6]).format(*[rng.choice(OWN)] * 2)
    if kind < 9:
        return '<system file="more"/>'
    kind -= 10
    if kind < 4:
        name = draw_property(rng)
        plain = name.replace("<![CDATA[", "").replace("]]>", "").replace("<!-- -->", "")
        return rng.choice(WRITERS).format(name, plain)
    if kind < 6:
        return rng.choice(ACTORS)
    if kind < 9:
        return rng.choice(USERS).format(rng.choice(FILES).format(folder))
    return draw_tree(rng)


def draw_aircraft(rng, folder):
    """Write an aircraft, one beside it that acts, and files that it may name."""
    home, evil = folder / "plane", folder / "evil"
    for each in (home, evil):
        shutil.copytree(library() / "aircraft" / "rascal110", each)
        (each / "rascal110.xml").rename(each / f"{each.name}.xml")
    acting = WRITERS[1].format(WRITE, WRITE) + ACTORS[2]
    insert(evil / "evil.xml", acting, rng)
    (home / "Systems").mkdir()
    places = [home / "Systems" / "more.xml", home / "more.xml", home / "evil.xml"]
    for file in rng.sample(places, rng.randrange(1, 4)):
        inside = draw_fragment(rng, folder)
        root = rng.choice(("system", "system", "propulsion", "electric_engine", "fdm_config"))
        if inside.startswith("<system ") and inside.endswith("</system>"):
            inside = inside[inside.index(">") + 1 : -len("</system>")]  # its content
        file.write_text(f'<{root} name="more">{inside}</{root}>')
    for name in rng.sample(("engines", "Engine", "engine", "systems"), rng.randrange(2)):
        (home / name).mkdir()
        motor = f"<electric_engine>{draw_fragment(rng, folder)}</electric_engine>"
        (home / name / "rascal110_motor.xml").write_text(motor)
    if rng.random() < 0.3:
        (home / "linked.xml").symlink_to(evil / "evil.xml")
    if rng.random() < 0.2:
        (home / "..\\evil\\evil.xml").write_text("<system name='x'/>")
    for _ in range(rng.randrange(1, 3)):
        insert(home / "plane.xml", draw_fragment(rng, folder), rng)
    return home


def insert(file, fragment, rng):
    """Put a fragment before a random section of an aircraft."""
    text = file.read_text()
    sections = ["<metrics>", "<propulsion>", "<flight_control", "<aerodynamics>", "</fdm_config>"]
    found = [each for each in sections if each in text]
    at = text.index(rng.choice(found)) if found else len(text)
    file.write_text(f"{text[:at]}{fragment}{text[at:]}")


def listing(folder):
    return {str(each.relative_to(folder)): each.lstat().st_mtime_ns for each in folder.rglob("*")}


def validate(home):
    sys.argv = ["testbed", "validate", "simulation-3", "--set", f"fleet.*.aircraft={home}"]
    try:
        main()
    except SystemExit as end:
        return end.code or 0
    return 0


def validate_in_copy(home, here, errors):
    """Return the exit code of `testbed validate` in a copy of this process; below 0: a signal."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        signal.alarm(LONGEST_S)
        os.chdir(here)
        output = os.open(errors, os.O_WRONLY | os.O_CREAT)
        os.dup2(output, 1)
        os.dup2(output, 2)

        def audit(event, args):
            if event in PROGRAMS:
                os.write(2, f"\nFAULT {event} {args!r:.200}\n".encode())

        sys.addaudithook(audit)
        code = validate(home)
        links = [f"/proc/self/fd/{each}" for each in os.listdir("/proc/self/fd")]
        for link in filter(os.path.islink, links):
            if "socket:" in os.readlink(link):
                os.write(2, b"\nFAULT a socket is open\n")
        sys.stdout.flush()
        os._exit(code)
    finally:
        os._exit(99)


def try_aircraft(number, folder):
    """Return the exit code, and the fault of an aircraft or ""."""
    folder, here = folder / str(number), folder / "here"
    folder.mkdir()
    here.mkdir(exist_ok=True)
    home = draw_aircraft(random.Random(f"{SEED}/{number}"), folder)
    errors = folder.parent / "errors"
    errors.unlink(missing_ok=True)
    before = listing(folder), listing(here)
    code = validate_in_copy(home, here, errors)
    text = errors.read_text(errors="replace")
    fault = ""
    if (listing(folder), listing(here)) != before:
        new = {*listing(folder), *listing(here)} - {*before[0], *before[1]}
        fault = f"wrote {sorted(new)[:3]}"
    elif code not in (0, 2):
        fault = f"exit code {code}: {text[-500:]}"
    elif "Traceback" in text or "FAULT" in text:
        fault = text[-500:]
    shutil.rmtree(folder)
    return code, fault


def count_faults(count, folder):
    seen, faults = Counter(), []
    folder.joinpath("whole").mkdir()
    shutil.copytree(library() / "aircraft" / "rascal110", folder / "whole" / "rascal110")
    code = validate(folder / "whole" / "rascal110")  # imports everything, for all copies
    seen[str(code)] += 1
    for number in range(count):
        code, fault = try_aircraft(number, folder)
        seen[str(code)] += 1
        if fault:
            faults.append(f"{number}: {fault}")
    return {"seen": seen, "faults": faults}


def answer():
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    json.dump(count_faults(int(sys.argv[-2]), Path(sys.argv[-1]).resolve()), answers)
    answers.close()
