"""FMUs of C sources, built with the compiler of this machine."""

import io
import shutil
import subprocess
import zipfile
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from places import TESTS

from testbed.fmi.archive import platform_of

SOURCE = TESTS / "data" / "fmu" / "leader_follower.c"
TOKEN = "{1b0e6c1e-leader-follower}"
# name, numbers of one aircraft, of each aircraft, unit, causality
REALS = {
    1: ("now", 0, False, "s", "input"),
    2: ("own.position_ned", 3, False, "m", "input"),
    3: ("own.velocity_ned", 3, False, "m/s", "input"),
    4: ("inbox.received_s", 0, True, "s", "input"),
    5: ("inbox.position_ned", 3, True, "m", "input"),
    6: ("inbox.velocity_ned", 3, True, "m/s", "input"),
    7: ("inbox.euler_rates", 3, True, "rad/s", "input"),
    8: ("config.slot", 3, False, "m", "parameter"),
    9: ("config.ground_speed_min", 0, False, "m/s", "parameter"),
    10: ("config.ground_speed_max", 0, False, "m/s", "parameter"),
    11: ("config.trim_throttle", 0, False, "1", "parameter"),
    12: ("config.leader_timeout_s", 0, False, "s", "parameter"),
    13: ("config.dt", 0, False, "s", "parameter"),
    14: ("closing", 0, False, "1/s", "parameter"),
    15: ("field_per_m", 0, False, "", "parameter"),
    16: ("pitch", 0, False, "rad", "output"),
    17: ("roll", 0, False, "rad", "output"),
    18: ("throttle", 0, False, "1", "output"),
}
STARTS = {14: "0.3", 15: "0.03"}


def need_compiler():
    """Skip a test where there is no C compiler."""
    if shutil.which("cc") is None:
        pytest.skip("there is no cc, which builds the FMUs of this test")


def description(version=2, *, state=True, text=lambda each: each, aircraft=1):
    """modelDescription.xml of the leader-follower law, with messages of some aircraft."""
    return text((_description_2 if version == 2 else _description_3)(state, aircraft))


def _flags(kind, state):
    yes = "true" if state else "false"
    return f'canGetAndSetFMU{kind}="{yes}" canSerializeFMU{kind}="{yes}"'


def _description_2(state, aircraft):
    lines = [
        f'<fmiModelDescription fmiVersion="2.0" modelName="law" guid="{TOKEN}">',
        f'<CoSimulation modelIdentifier="law" {_flags("state", state)}/>',
        '<DefaultExperiment stepSize="0.02"/><ModelVariables>',
    ]
    for r, (name, size, of_each, unit, causality) in REALS.items():
        start = STARTS.get(r, "0") if causality != "output" else None
        for k in range(aircraft if of_each else 1):
            for axis in range(max(size, 1)):
                indices = [k + 1] * of_each + [axis + 1] * bool(size)
                index = f"[{','.join(map(str, indices))}]" if indices else ""
                place = 100 * r + max(size, 1) * k + axis
                lines.append(_variable_2(f"{name}{index}", place, causality, unit, start))
    lines += [
        f'<ScalarVariable name="inbox.failed[{k + 1}]" valueReference="{1900 + k}" '
        'causality="input"><Boolean start="false"/></ScalarVariable>'
        for k in range(aircraft)
    ]
    return "\n".join([*lines, "</ModelVariables></fmiModelDescription>"])


def _variable_2(name, place, causality, unit, start):
    start = "" if start is None else f' start="{start}"'
    unit = f' unit="{unit}"' if unit else ""
    fixed = ' variability="fixed"' if causality == "parameter" else ""
    return (
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}"{fixed}>'
        f"<Real{unit}{start}/></ScalarVariable>"
    )


def _description_3(state, aircraft):
    lines = [
        f'<fmiModelDescription fmiVersion="3.0" modelName="law" instantiationToken="{TOKEN}">',
        f'<CoSimulation modelIdentifier="law" {_flags("State", state)}/>',
        '<DefaultExperiment stepSize="0.04"/><ModelVariables>',
        '<UInt64 name="N" valueReference="20" causality="structuralParameter" '
        f'variability="fixed" start="{4 * aircraft}" min="1" max="16"/>',
        '<Boolean name="inbox.failed" valueReference="19" causality="input" start="false">'
        '<Dimension valueReference="20"/></Boolean>',
    ]
    for r, (name, size, of_each, unit, causality) in REALS.items():
        start = f' start="{STARTS.get(r, "0")}"' if causality != "output" else ""
        unit_text = f' unit="{unit}"' if unit else ""
        fixed = ' variability="fixed"' if causality == "parameter" else ""
        sizes = '<Dimension valueReference="20"/>' * of_each
        sizes += f'<Dimension start="{size}"/>' if size else ""
        lines.append(
            f'<Float64 name="{name}" valueReference="{r}" causality="{causality}"'
            f"{fixed}{unit_text}{start}>{sizes}</Float64>"
        )
    return "\n".join([*lines, "</ModelVariables></fmiModelDescription>"])


@cache
def binary(*flags):
    """Shared library of the leader-follower law with these definitions."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "law.so"
        warnings = "-Wall", "-Wextra", "-Werror"
        subprocess.run(
            ["cc", "-O0", "-ffp-contract=off", "-fPIC", "-shared", *warnings, *flags]
            + ["-o", str(library), str(SOURCE), "-lm"],
            check=True,
        )
        return library.read_bytes()


def archive(entries):
    """Bytes of a ZIP file of these entries."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in entries.items():
            file.writestr(name, data)
    return out.getvalue()


def law_fmu(file, *definitions, version=2, state=True, text=lambda each: each, aircraft=1):
    """Write the FMU of the leader-follower law to a file, and return it."""
    flags = [f"-D{each}" for each in (*definitions, *(["FMI3"] if version == 3 else []))]
    folder, suffix = platform_of(version)
    file.write_bytes(
        archive(
            {
                "modelDescription.xml": description(
                    version, state=state, text=text, aircraft=aircraft
                ),
                f"binaries/{folder}/law{suffix}": binary(*flags),
            }
        )
    )
    return file
