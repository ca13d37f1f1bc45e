"""The command that samples the wind of a scenario: air."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Table
from rich.text import Text

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import (
    JsonFile,
    Overrides,
    ScenarioName,
    Seed,
    figure_option,
    finite_option,
    load_scenario,
    output_option,
    positive_option,
    read_time,
    value_option,
)
from testbed.cli.output import (
    MISSING,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_file

if TYPE_CHECKING:
    from testbed.core.records import Array
    from testbed.probes.air_probe import ProbePath, ProbeRecord
    from testbed.scenario import Scenario

DEFAULT_AIRSPEED = 20.0  # m/s, where the leader flies no mission
MAX_SAMPLES = 20_000_000  # of all probes: more than a gigabyte
MIN_SPECTRUM_SAMPLES = 100
MODELS = {
    "none": "no turbulence",
    "dryden": "Dryden turbulence, independent at each probe",
    "von-karman": "von Kármán turbulence, independent at each probe",
    "coherent": "one von Kármán field for all probes",
}


@draws_figures("plot")
def air_command(
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        output_option(
            metavar="FILE.npz", help="Write the wind at the probes to this file, as NumPy arrays."
        ),
    ] = None,
    rate: Annotated[float, positive_option("HZ", "Samples per second.")] = 50.0,
    duration: Annotated[
        str, value_option("TIME", "Length of the flight: 600, 90s or 10m.")
    ] = "600",
    airspeed: Annotated[
        float | None,
        positive_option("M/S", "True airspeed.  \\[default: that of the leader's mission, or 20]"),
    ] = None,
    course: Annotated[
        float,
        finite_option(
            "DEG", "Direction of flight relative to the air, degrees clockwise from north."
        ),
    ] = 0.0,
    height: Annotated[
        float | None,
        positive_option("M", "Height above the ground.  \\[default: that of the leader's start]"),
    ] = None,
    separation: Annotated[
        float | None,
        positive_option("M", "Fly a second probe at this distance to the right of the first."),
    ] = None,
    overrides: Overrides = None,
    seed: Seed = None,
    plot: Annotated[
        Path | None,
        figure_option(
            "Plot records, spectra and coherence with the closed forms of the model, as .png, "
            ".pdf or .svg."
        ),
    ] = None,
    json: JsonFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Sample a scenario's wind along a straight flight, without simulating aircraft.

    A probe holds height, airspeed and course with wings level and drifts with the mean wind. The
    wind is averaged over the leader's wing span. The first probe starts where the leader does and
    has the leader's turbulence; the second has that of the first follower. Gusts are included,
    wakes are not.
    """
    from testbed.probes.air_probe import fly_probes, to_arrays

    duration_s = read_time("--duration", duration)
    _check_samples(rate * duration_s, probes=1 if separation is None else 2, plot=plot is not None)
    loaded = load_scenario(scenario, overrides, seed)
    path = _probe_path(loaded, rate, duration_s, airspeed, course, height, separation)
    record = fly_probes(loaded, path)
    document = _document(loaded, path, record)
    if out:
        _save(out, to_arrays(loaded, path, record))
    if plot:
        _plot(plot, loaded, path, record, look)
    write_json_output(json, document)
    console = result_console(json)
    console.print(_headline(loaded, path))
    console.write_line()
    console.print_table(_table(document))
    for name, file in (("arrays", out), ("figure", plot)):
        if file:
            console.write_line(f" {name}  {file}")


def _check_samples(samples: float, *, probes: int, plot: bool) -> None:
    if samples < 1.5:
        raise InputError("--duration × --rate: fewer than two samples; write a larger one")
    most = MAX_SAMPLES // probes
    if samples > most:
        raise InputError(
            f"--duration × --rate: {samples:.3g} samples; write smaller ones, for at most "
            f"{most:.3g} samples"
        )
    if plot and round(samples) < MIN_SPECTRUM_SAMPLES:
        raise InputError(
            f"--plot: spectra need {MIN_SPECTRUM_SAMPLES} samples, and there are {round(samples)}; "
            "write a longer --duration"
        )


def _probe_path(
    scenario: Scenario,
    rate: float,
    duration_s: float,
    airspeed: float | None,
    course: float,
    height: float | None,
    separation: float | None,
) -> ProbePath:
    from testbed.probes.air_probe import ProbePath
    from testbed.scenario.aircraft import Mission

    path = scenario.leader.path
    if airspeed is None:
        airspeed = path.airspeed_mps if isinstance(path, Mission) else DEFAULT_AIRSPEED
    if height is None:
        height = scenario.leader.start.altitude_m
        if height <= 0.0:
            raise InputError(f"the leader starts {height:g} m above the ground: write a --height")
    return ProbePath(
        rate_hz=rate,
        duration_s=duration_s,
        airspeed=airspeed,
        course=math.radians(course),
        height=height,
        separation=separation,
    )


def _save(path: Path, arrays: Mapping[str, Any]) -> None:
    import numpy as np

    # np.savez adds .npz to a name, but not to an open file
    with report_write_errors(f"--out {path}"), write_file(path) as file:
        np.savez(file, **arrays)


def _plot(
    file: Path, scenario: Scenario, path: ProbePath, record: ProbeRecord, look: FigureLook
) -> None:
    from testbed.probes.air_probe import (
        closed_form,
        coherence_band,
        estimate,
        psd_band,
        unresolved_waves,
    )
    from testbed.views.air_figure import WindFigureData, wind_figure

    velocity = record.about_mean(path.course)
    found = estimate(velocity, path.rate_hz)
    closed = closed_form(scenario, path, record, found)
    picture = WindFigureData(
        title=f"{scenario.name} · {_model(scenario)}",
        subtitle=_flight(path),
        names=record.names,
        time=record.time,
        velocity=velocity,
        frequency_hz=found.frequency_hz,
        psd=found.psd,
        psd_expected=closed and (closed.psd, *psd_band(closed.psd, found.freedom)),
        separation=path.separation,
        coherence=found.coherence,
        coherence_expected=closed
        and (closed.coherence, *coherence_band(closed.coherence, found.freedom)),
        unresolved=unresolved_waves(scenario, path),
    )
    look.save(wind_figure(picture), file)


def _document(scenario: Scenario, path: ProbePath, record: ProbeRecord) -> dict[str, Any]:
    import numpy as np

    turbulence = record.about_mean(path.course)
    mean = record.mean_wind_ned.mean(axis=1)
    return {
        "scenario": scenario.name,
        "seed": scenario.scenario.seed,
        "rate_hz": path.rate_hz,
        "duration_s": path.duration_s,
        "airspeed_mps": path.airspeed,
        "course_deg": math.degrees(path.course),
        "height_m": path.height,
        "separation_m": path.separation,
        "model": {
            "name": scenario.air.turbulence.model,
            "sigma_mps": _known(record.sigma),
            "length_m": _known(record.length),
        },
        "probes": [
            {
                "name": name,
                "mean_wind_mps": math.hypot(*mean[k, :2]),
                "mean_wind_from_deg": _from_deg(mean[k]),
                "mean_wind_down_mps": float(mean[k, 2]),
                "rms_mps": _rms(turbulence[k]),
                "rms_rates_deg_s": _rms(np.degrees(record.wind_gradient_rates[k])),
            }
            for k, name in enumerate(record.names)
        ],
    }


def _rms(values: Array) -> list[float]:
    import numpy as np

    rms: list[float] = np.sqrt(np.square(values).mean(axis=0)).tolist()
    return rms


def _known(values: Array) -> list[float] | None:
    numbers: list[float] = values.tolist()
    return None if any(map(math.isnan, numbers)) else numbers


def _model(scenario: Scenario) -> str:
    return MODELS[scenario.air.turbulence.model]


def _flight(path: ProbePath) -> str:
    line = f"airspeed {path.airspeed:g} m/s, course {math.degrees(path.course):g}°"
    line += f" · {path.height:g} m above the ground"
    return f"{line} · {path.duration_s:g} s at {path.rate_hz:g} Hz"


def _headline(scenario: Scenario, path: ProbePath) -> Text:
    return Text.assemble(" ", (scenario.name, "bold"), f" · {_model(scenario)}\n {_flight(path)}")


def _from_deg(wind: Array) -> float | None:
    """Direction that a wind (3,) blows from; None in calm air."""
    from testbed.core.frames import wind_from_deg

    return float(wind_from_deg(wind)) if wind[:2].any() else None


def _table(document: Mapping[str, Any]) -> Table:
    turbulence = ("rms, m/s\nu forward", "\nv right", "\nw down")
    rates = ("rms, °/s\np roll", "\nq pitch", "\nr yaw")
    table = ruled_table("\nprobe", "wind\nm/s", "\nfrom", *turbulence, *rates)
    for probe in document["probes"]:
        from_deg = probe["mean_wind_from_deg"]
        table.add_row(
            probe["name"],
            f"{probe['mean_wind_mps']:.2f}",
            MISSING if from_deg is None else f"{round(from_deg) % 360}°",
            *(f"{rms:.2f}" for rms in (*probe["rms_mps"], *probe["rms_rates_deg_s"])),
        )
    sigma = document["model"]["sigma_mps"]
    if sigma:
        cells = ["model, σ", "", "", *(f"{each:.2f}" for each in sigma), *[MISSING] * 3]
        table.add_row(*(Text(cell, style="dim") for cell in cells))
    return table
