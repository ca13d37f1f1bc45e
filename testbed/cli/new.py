"""The commands that make files of a user's own: an aircraft, a law, a study."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Mapping, Sequence
from json import dumps as json_text
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import JsonFile, figure_option, require_finite, value_option
from testbed.cli.output import (
    MISSING,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError
from testbed.core.files import create_file, new_folder, report_write_errors, write_text_file
from testbed.scenario import find_law, load_scenario
from testbed.scenario.control import BUILT_IN

if TYPE_CHECKING:
    from rich.table import Table

    from testbed.commissioning.airframe_import import CopiedAircraft
    from testbed.commissioning.new_aircraft import DerivedAircraft
    from testbed.vehicle.trim import TrimResult
    from testbed.views.panels import PanelGrid

PICTURE = "envelope.png"
_TEMPLATES = Path(__file__).parent / "new_files"
_OPTIONS = "  options: {closing_per_s: 0.3}\n"  # of the law that is made without --from
SPEEDS = (1.0, 340.0)  # m/s, as of a scenario


def _check_speed(parameter: typer.CallbackParam, speed: float | None) -> float | None:
    """Check --speed; a typer callback.

    Raises:
        InputError: it is out of range.
    """
    require_finite(parameter, speed)
    low, high = SPEEDS
    if speed is not None and not low <= speed <= high:
        raise InputError(f"{parameter.opts[0]} {speed:g}: write {low:g} to {high:g} (m/s)")
    return speed


def new_command() -> None:
    """Make files of your own: an aircraft from its JSBSim file, a law, a study."""


def new_law_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the law, as of a function.")],
    into: Annotated[
        Path | None, value_option("FOLDER", "Folder to make.  \\[default: the law's name, here]")
    ] = None,
    begin_with: Annotated[
        str | None,
        value_option(
            "LAW", "Law of the library to begin with.  \\[default: one of 20 lines]", "--from"
        ),
    ] = None,
    fmu: Annotated[
        bool,
        typer.Option("--fmu", help="Make the sources of an FMU in C in place of the kernel."),
    ] = False,
) -> None:
    """Make a law of your own that flies: a kernel, a scenario, a study, an entry and a notebook.

    The kernel is a leader-follower law of 20 lines, or a law of the library, to be changed. The
    scenario flies it on Simulation 3, the study compares it with the paper's law over 20 seeds, the
    entry has what `testbed benchmark` tunes, and the notebook goes from the flight to a figure and
    margins.

    With --fmu the law is the same in C, for the standard FMI 2.0: source, modelDescription.xml and
    a table of its variables. Nothing is built; the commands that build it are printed.
    """
    check_law_name(name)
    target = Path(name) if into is None else into
    if fmu:
        _write_fmu_law(name, target, begin_with, named=into is not None)
        return
    templates = {
        f"{name}.py": "law.py",
        f"{name}.yaml": "law.yaml",
        f"{name}-study.yaml": "law-study.yaml",
        f"{name}-entry.yaml": "law-entry.yaml",
        f"{name}.ipynb": "law.ipynb",
    }
    texts = {file: filled_template(each, {"NAME": name}) for file, each in templates.items()}
    if begin_with is not None:
        texts[f"{name}.py"] = _renamed_law(begin_with, name)
        texts[f"{name}.yaml"] = texts[f"{name}.yaml"].replace(_OPTIONS, "")
        texts[f"{name}-entry.yaml"] = _renamed_entry(begin_with, name)
    with report_write_errors(f"--into {target}" if into else target), new_folder(target) as folder:
        folder.mkdir()
        for file, text in texts.items():
            with write_text_file(folder / file) as written:
                written.write(text)
    console = result_console(None)
    console.write_line(f" written: {', '.join(str(target / file) for file in texts)}")
    console.write_line(f" next: testbed validate {target / name}.yaml")
    console.write_line(f"       testbed run {target / name}.yaml")
    console.write_line(f"       testbed margins {target / name}.yaml")
    console.write_line(f"       testbed sweep {target / name}-study.yaml")
    entered = f"{target / name}.py:{name} --entry {target / name}-entry.yaml"
    console.write_line(f"       testbed benchmark {entered} hbh23")


def _write_fmu_law(name: str, target: Path, begin_with: str | None, *, named: bool) -> None:
    """Write the sources of a law that is an FMU, with a scenario and a study.

    Raises:
        InputError: a file cannot be written, or the law begins with one of the library.
    """
    from testbed.cli.new_fmu import build_commands, c_words, description, table

    if begin_with is not None:
        raise InputError(f"--from {begin_with}: is a kernel in Python (leave out --from or --fmu)")
    texts = {
        f"{name}-fmu/modelDescription.xml": description(name),
        f"{name}-fmu/sources/{name}.c": filled_template("fmu-law.c", c_words(name)),
        f"{name}-variables.csv": table(),
        f"{name}.yaml": filled_template("fmu-law.yaml", {"NAME": name}),
        f"{name}-study.yaml": filled_template("law-study.yaml", {"NAME": name}),
    }
    texts[f"{name}-study.yaml"] = texts[f"{name}-study.yaml"].replace(f"{name}.py", f"{name}.fmu")
    with report_write_errors(f"--into {target}" if named else target), new_folder(target) as folder:
        for file, text in texts.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            with write_text_file(folder / file) as written:
                written.write(text)
    console = result_console(None)
    console.write_line(f" written: {', '.join(str(target / file) for file in texts)}")
    console.write_line(f" next: cd {target / name}-fmu")
    for each in (*build_commands(name), "cd -"):
        console.write_line(f"       {each}")
    console.write_line(f"       testbed validate {target / name}.yaml")
    console.write_line(f"       testbed run {target / name}.yaml")
    console.write_line(f"       testbed sweep {target / name}-study.yaml")


def _renamed_entry(law: str, name: str) -> str:
    """Return what of a law of the library is tuned in the benchmark, for a law of another name."""
    from testbed.benchmark.entry import ENTRIES

    _, text = (ENTRIES / f"{law}.yaml").read_text("utf-8").split("\n\n", 1)
    return text.replace(f"name: {law}}}", f"name: {name}}}").replace(f"law: {law}\n", "")


def _renamed_law(law: str, name: str) -> str:
    """Return the file of a law of the library with another name of the law.

    Raises:
        InputError: there is no such law, or its file has a word like the name.
    """
    file = find_law(law)
    text = file.read_text("utf-8")
    if re.search(rf"\b{name}\b", text):
        raise InputError(f"the name {name!r} is one in the file of {law} (write another)")
    return re.sub(rf"\b{file.stem}\b", name, text)


def filled_template(name: str, words: Mapping[str, str]) -> str:
    """Return the text of a file that is made for users.

    Args:
        name: of the template; its file has one more suffix, so that no tool takes it for code.
        words: in capitals, with what stands in their places.
    """
    text = (_TEMPLATES / f"{name}.txt").read_text("utf-8")
    pattern = r"\b(" + "|".join(words) + r")(?=\b|_)"
    return re.sub(pattern, lambda found: words[found[1]], text)


def check_law_name(name: str) -> None:
    """Check the name of a new law, which is that of its function and its module.

    Raises:
        InputError: it is no such name, or that of the built-in law.
    """
    if not (name.isascii() and name.isidentifier()) or keyword.iskeyword(name) or len(name) > 60:
        raise InputError(
            f"the name {name[:40]!r} is no name of a function (write letters, digits and _)"
        )
    if name in (BUILT_IN, "testbed", "np", "length", "command_from_velocity"):
        raise InputError(f"the name {name!r} is taken (write another)")


def new_study_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the study and its file.")],
    scenario: Annotated[
        str, value_option("SCENARIO", "The scenario that it flies, a name or a path.")
    ] = "simulation-3",
) -> None:
    """Make a study of a scenario: lost messages and wind, with five seeds, to be changed.

    Its numbers are the mean RMS error in the scenario's first window and the smallest separation.
    """
    from pydantic import TypeAdapter, ValidationError

    from testbed.scenario.fields import Name

    try:
        TypeAdapter(Name).validate_python(name)
    except ValidationError:
        raise InputError(
            f"the name {name[:40]!r}: write letters, digits and _ . - behind a letter or digit"
        ) from None
    target = Path(f"{name}.yaml")
    flown = load_scenario(scenario)
    section, follower = flown.scenario, flown.aircraft_names[1]
    window = next(iter(section.windows), None)
    words = {
        "NAME": name,
        "SCENARIO": scenario if re.fullmatch(r"[\w./-]+", scenario) else json_text(scenario),
        "DURATION": f"{section.windows[window][1] if window else section.duration_s:g}",
        "METRIC": f"windows.{window}.mean_rms_m" if window else f"max_error_m.{follower}",
    }
    text = filled_template("study.yaml", words).encode()
    with report_write_errors(target):
        try:
            create_file(target, text)
        except FileExistsError:
            raise InputError(f"{target} exists: remove it or write another name") from None
    result_console(None).write_line(f" written: {target}; next: testbed sweep {target}")


@draws_figures("plot")
def new_aircraft_command(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.xml", help="The JSBSim file of the aircraft.")
    ],
    speed: Annotated[
        float | None,
        value_option(
            "M/S",
            "True airspeed of cruise, for which all gains are derived.  "
            "\\[default: that of a lift coefficient of 0.4, or near it]",
            check=_check_speed,
        ),
    ] = None,
    into: Annotated[
        Path | None,
        value_option(
            "FOLDER",
            "Folder to make; its name is the aircraft's.  \\[default: the file's name, here]",
        ),
    ] = None,
    json: JsonFile = None,
    plot: Annotated[
        Path | None,
        figure_option(
            "Draw the picture of the folder, level flight, here too: .png, .pdf or .svg."
        ),
    ] = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Make an aircraft that flies from its JSBSim file: copy, trim, derive gains, fly it.

    All files that the aircraft names are copied, from its own folder and from the engines and
    systems that come with JSBSim. Elements that open sockets or write files are cut out, properties
    that no file sets are declared, and each is reported.

    The aircraft is trimmed over its speed range. Gains of autopilot, middle loop and guidance, and
    the speed model of the formation law, follow by rule from its responses to steps. It then flies
    a minute of fly-by-wire A with banks of 30°; gains with which it rings are softened.

    An aircraft that cannot be flown is refused with the reason, and nothing is written.
    """
    from testbed.commissioning.aircraft_files import write_aircraft_files
    from testbed.commissioning.airframe_import import (
        check_folder_name,
        copy_aircraft,
        declare_missing,
    )
    from testbed.commissioning.new_aircraft import derive
    from testbed.commissioning.replay_commands import BASE_RATE_HZ
    from testbed.compiled.compiled_fleet import untranslated
    from testbed.vehicle.jsbsim_adapter import SHARED_FILES, airframe
    from testbed.views.matplotlib_backend import save_figure

    target = Path(file.stem) if into is None else into
    check_folder_name(target.name)
    messages = message_console()

    def report(text: str) -> None:
        messages.write_line(f" {text} …", "dim")

    with report_write_errors(f"--into {target}" if into else target), new_folder(target) as folder:
        report("copy")
        copied = copy_aircraft(file, folder, SHARED_FILES)
        try:
            declare_missing(copied, lambda: airframe(folder))
            found = derive(folder, speed, report)
        except InputError as error:
            error.args = (copied.in_originals(str(error)), *error.args[1:])
            raise
        write_aircraft_files(copied, found)
        reasons = [copied.in_originals(each) for each in untranslated(folder, BASE_RATE_HZ)]
        picture = _picture(target.name, found)
        save_figure(picture, folder / PICTURE)
    if plot is not None:
        look.save(picture, plot)
    write_json_output(json, _document(target, copied, found, reasons))
    console = result_console(json)
    console.write_heading(target.name, f" · from {file}")
    for line in _changes(copied):
        console.write_line(f" {line}")
    for table in (_level_table(found), _flight_table(found)):
        console.print_table(table)
        console.write_line()
    for line in (*describe_engine(reasons), *_ending(target, found)):
        console.write_line(f" {line}")


def _picture(name: str, found: DerivedAircraft) -> PanelGrid:
    import numpy as np

    from testbed.views.envelope_figure import EnvelopeFigureData, envelope_figure

    trims, level = found.envelope.trims, found.level
    params, steps = found.check.params, found.steps
    eas2tas = steps.airspeed / steps.equivalent_airspeed
    speeds = np.array([each.point.airspeed for each in trims])
    data = EnvelopeFigureData(
        title=f"{'Glide' if found.envelope.glides else 'Level flight'} of {name}",
        subtitle=f"{level.lowest:.1f} to {level.highest:.1f} m/s; line: cruise, {level.airspeed:g} "
        "m/s; shaded: speeds of the autopilot",
        airspeed=speeds,
        throttle=np.array([each.controls.throttle for each in trims]),
        sink=np.array([_sink(each) for each in trims]) if found.envelope.glides else None,
        alpha_deg=np.degrees([each.alpha for each in trims]),
        elevator=np.array([each.controls.elevator for each in trims]),
        cruise=level.airspeed,
        autopilot=(params.airspeed_min * eas2tas, params.airspeed_max * eas2tas),
    )
    return envelope_figure(data)


def _sink(trim: TrimResult) -> float:
    """Return the rate of descent of a trim, m/s."""
    return -trim.point.airspeed * math.sin(trim.flight_path_angle)


def _changes(copied: CopiedAircraft) -> list[str]:
    lines = [f"cut out: {each.place}: {each.element}" for each in copied.cuts]
    if copied.declared:
        lines.append(
            "declared with the value 0, because no file sets them: " + ", ".join(copied.declared)
        )
    return [*lines, ""] if lines else []


def _level_table(found: DerivedAircraft) -> Table:
    glides = found.envelope.glides
    kind, power = ("glide", "sink\nm/s") if glides else ("level flight", "throttle\n")
    table = ruled_table(f"\n{kind}", "airspeed\nm/s", power, "alpha\n°", "elevator\n")
    trims = found.envelope.trims
    rows = {"slowest": trims[0], "cruise": found.envelope.cruise, "fastest": trims[-1]}
    for name, each in rows.items():
        table.add_row(
            name,
            f"{each.point.airspeed:.1f}",
            f"{_sink(each):.2f}" if glides else f"{each.controls.throttle:.3f}",
            f"{math.degrees(each.alpha):.1f}",
            f"{each.controls.elevator:+.3f}",
        )
    return table


def _flight_table(found: DerivedAircraft) -> Table:
    titles = ("to 63 %\ns", "overshoot\n%", "ripple\n°", "gains\nsoftened")
    table = ruled_table("60 s of\nfly-by-wire A", *titles)
    for each in found.flights:
        for axis, response in (("bank", each.roll), ("pitch", each.pitch)):
            table.add_row(
                axis,
                MISSING if math.isnan(response.rise_s) else f"{response.rise_s:.2f}",
                f"{100.0 * response.overshoot:.1f}",
                f"{response.ripple_deg:.2f}",
                f"{each.softenings}",
                end_section=axis == "pitch",
            )
    return table


def describe_engine(reasons: Sequence[str]) -> list[str]:
    """Return what steps the aircraft, and why."""
    if not reasons:
        return ["engine: compiled, if it equals JSBSim when testbed validate or a flight proves it"]
    return ["engine: JSBSim, as parts of the aircraft are not compiled:", *reasons]


def _ending(folder: Path, found: DerivedAircraft) -> list[str]:
    from testbed.commissioning.first_formation import NAME as FORMATION

    lines = []
    if found.speed is not None:
        model = found.speed.model
        lines += [
            f"speed model: pole {model.pole:.2f} 1/s (formation.speed_pole_per_s), delay "
            f"{model.delay:.2f} s",
            "",
        ]
    speed = f"{found.level.airspeed:g}"
    path = folder if folder.parts[:-1] else f"./{folder}"
    return [
        *lines,
        f"written: {path}; SOURCE.md says what was derived, {PICTURE} shows level flight",
        f"next: testbed trim {path} --airspeed {speed}",
        f"      testbed linearize {path} --airspeed {speed}",
        f"      aircraft: {path} in a scenario",
        *([] if found.speed is None else [f"      testbed run {path}/{FORMATION}"]),
    ]


def _document(
    folder: Path, copied: CopiedAircraft, found: DerivedAircraft, reasons: Sequence[str]
) -> dict[str, Any]:
    from dataclasses import asdict

    from testbed.commissioning.aircraft_files import check_document

    return {
        "aircraft": folder.name,
        "folder": str(folder),
        "copied": {
            str(copy.relative_to(copied.main.parent)): str(source)
            for copy, source in copied.sources.items()
        },
        "cut": [{"place": str(each.place), "element": each.element} for each in copied.cuts],
        "declared": copied.declared,
        "not_compiled": list(reasons),
        "level_flight": asdict(found.level),
        "trims": [
            {
                "airspeed_mps": each.point.airspeed,
                "throttle": each.controls.throttle,
                "climb_mps": -_sink(each),
                "alpha_deg": math.degrees(each.alpha),
                "elevator": each.controls.elevator,
            }
            for each in found.envelope.trims
        ],
        "steps": asdict(found.steps),
        "flights": [check_document(each) for each in found.flights],
        "middle_loop": found.middle_loop,
        "guidance": found.guidance,
        "speed_pole_per_s": None if found.speed is None else found.speed.model.pole,
    }
