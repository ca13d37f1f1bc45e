"""What `testbed air` prints, writes and draws: the air of a scenario by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.frames import wind_from_deg
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.scenario import Scenario, load
from testbed.scenario.aircraft import Mission
from testbed.sim.probe_models import expected
from testbed.sim.probe_spectra import coherence_band, estimate, psd_band
from testbed.sim.probes import Course, Felt, fly_probes, to_arrays
from testbed.state import Array
from testbed.views.air_figure import ENDINGS, AirPicture, draw_air

NOTHING = "–"
AIRSPEED = 20.0  # m/s, where the leader has no mission that says
MOST_SAMPLES = 20_000_000  # of all probes: more than a gigabyte
FEWEST_DRAWN = 100  # samples: fewer have no spectrum
MODELS = {
    "none": "no turbulence",
    "dryden": "Dryden turbulence of each one's own",
    "von-karman": "von Kármán turbulence of each one's own",
    "coherent": "one von Kármán field for all",
}


class Asked(NamedTuple):
    """The options of the command that say how the probes fly."""

    rate: float  # Hz
    duration: float  # s
    airspeed: float | None  # m/s
    course: float  # degrees
    height: float | None  # m
    separation: float | None  # m


def probe_and_show(
    scenario: str,
    overrides: tuple[str, ...],
    asked: Asked,
    *,
    seed: int | None,
    out: Path | None,
    plot: Path | None,
    json: Path | None,
) -> None:
    """Fly the probes, print their table, and write what was asked for."""
    _refuse_numbers(asked)
    if plot and plot.suffix.lower() not in ENDINGS:
        raise InputError(f"--plot {plot}: write a name that ends in {', '.join(ENDINGS)}")
    refuse_files(out=out, plot=plot, json=json)
    count = round(asked.rate * asked.duration)
    if plot and count < FEWEST_DRAWN:
        raise InputError(
            f"--plot needs {FEWEST_DRAWN} samples and there are {count}: write a longer --duration"
        )
    if seed is not None:
        overrides = (*overrides, f"scenario.seed={seed}")
    page = load(scenario, overrides)
    course = _course(page, asked)
    felt = fly_probes(page, course)
    document = _document(page, course, felt)
    if out:
        _save(out, to_arrays(page, course, felt))
    if plot:
        _draw(plot, page, course, felt)
    console = Console(stderr=is_stdout(json), highlight=False)
    console.print(_headline(page, course))
    console.print()
    console.print(_table(document))
    for name, path in (("arrays", out), ("figure", plot)):
        if path:
            console.print(f" {name}  {path}", soft_wrap=True)
    put_json(json, document)


def _refuse_numbers(asked: Asked) -> None:
    for name, value in asked._asdict().items():
        if value is not None and not math.isfinite(value):
            raise InputError(f"--{name} {value}: write a number")
        if name != "course" and value is not None and value <= 0.0:
            raise InputError(f"--{name} {value:g}: write a number above 0")
    probes = 1 if asked.separation is None else 2
    most = MOST_SAMPLES // probes
    if asked.rate * asked.duration < 1.5:
        raise InputError("--duration times --rate makes fewer than two samples: write a longer one")
    if asked.rate * asked.duration > most:
        raise InputError(
            f"--duration times --rate makes {asked.rate * asked.duration:.3g} samples: write less, "
            f"at most {most:.3g}"
        )


def _course(page: Scenario, asked: Asked) -> Course:
    path = page.leader.path
    airspeed = path.airspeed_mps if isinstance(path, Mission) else AIRSPEED
    height = page.leader.start.altitude_m if asked.height is None else asked.height
    if height <= 0.0:
        raise InputError(f"the leader starts {height:g} m above the ground: write a --height")
    return Course(
        rate_hz=asked.rate,
        duration_s=asked.duration,
        airspeed=airspeed if asked.airspeed is None else asked.airspeed,
        course=math.radians(asked.course),
        height=height,
        separation=asked.separation,
    )


def _save(path: Path, arrays: Mapping[str, Any]) -> None:
    try:
        with path.open("wb") as file:  # given a name, NumPy would write to another one
            np.savez(file, **arrays)
    except OSError as error:
        raise InputError(f"--out {path}: cannot write it: {error.strerror}") from error


def _draw(path: Path, page: Scenario, course: Course, felt: Felt) -> None:
    velocity = felt.about_mean(course.course)
    found = estimate(velocity, course.rate_hz)
    closed = expected(page, course, felt, found)
    picture = AirPicture(
        title=f"{page.name} · {_model(page)}",
        subtitle=_flight(course),
        names=felt.names,
        time=felt.time,
        velocity=velocity,
        frequency_hz=found.frequency_hz,
        psd=found.psd,
        psd_expected=closed and (closed.psd, *psd_band(closed.psd, found.freedom)),
        separation=course.separation,
        coherence=found.coherence,
        coherence_expected=closed
        and (closed.coherence, *coherence_band(closed.coherence, found.freedom)),
    )
    try:
        draw_air(picture, path)
    except OSError as error:
        raise InputError(f"--plot {path}: cannot write it: {error.strerror}") from error


def _document(page: Scenario, course: Course, felt: Felt) -> dict[str, Any]:
    """The table for JSON."""
    moving = felt.about_mean(course.course)
    mean = felt.mean_wind_ned.mean(axis=1)
    return {
        "scenario": page.name,
        "seed": page.scenario.seed,
        "rate_hz": course.rate_hz,
        "duration_s": course.duration_s,
        "airspeed_mps": course.airspeed,
        "course_deg": math.degrees(course.course),
        "height_m": course.height,
        "separation_m": course.separation,
        "model": {
            "name": page.air.turbulence.model,
            "sigma_mps": _numbers(felt.sigma),
            "length_m": _numbers(felt.length),
        },
        "probes": [
            {
                "name": name,
                "mean_wind_mps": math.hypot(*mean[k, :2]),
                "mean_wind_from_deg": _from_deg(mean[k]),
                "mean_wind_down_mps": float(mean[k, 2]),
                "rms_mps": _rms(moving[k]),
                "rms_rates_deg_s": _rms(np.degrees(felt.rates_body[k])),
            }
            for k, name in enumerate(felt.names)
        ],
    }


def _rms(values: Array) -> list[float]:
    rms: list[float] = np.sqrt(np.square(values).mean(axis=0)).tolist()
    return rms


def _numbers(values: Array) -> list[float] | None:
    known: list[float] = values.tolist()
    return None if np.isnan(values).any() else known


def _model(page: Scenario) -> str:
    return MODELS[page.air.turbulence.model]


def _flight(course: Course) -> str:
    line = f"{course.airspeed:g} m/s through the air, course {math.degrees(course.course):g}°"
    line += f" · {course.height:g} m above the ground"
    return f"{line} · {course.duration_s:g} s at {course.rate_hz:g} Hz"


def _headline(page: Scenario, course: Course) -> Text:
    return Text.assemble(" ", (page.name, "bold"), f" · {_model(page)}\n {_flight(course)}")


def _from_deg(wind: Array) -> float | None:
    """Where a wind (3,) comes from; nowhere if it does not blow."""
    return float(wind_from_deg(wind)) if wind[:2].any() else None


def _table(document: Mapping[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")
    table.add_column(Text("\nprobe", style="bold"), no_wrap=True)
    for name in (
        "wind\nm/s",
        "\nfrom",
        "rms, m/s\nu ahead",
        "\nv right",
        "\nw down",
        "rms, °/s\np roll",
        "\nq pitch",
        "\nr yaw",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for probe in document["probes"]:
        blowing, blows_from = probe["mean_wind_mps"], probe["mean_wind_from_deg"]
        table.add_row(
            probe["name"],
            f"{blowing:.2f}",
            NOTHING if blows_from is None else f"{round(blows_from) % 360}°",
            *(f"{rms:.2f}" for rms in (*probe["rms_mps"], *probe["rms_rates_deg_s"])),
        )
    sigma = document["model"]["sigma_mps"]
    if sigma:
        cells = ["model, σ", "", "", *(f"{each:.2f}" for each in sigma), *[NOTHING] * 3]
        table.add_row(*(Text(cell, style="dim") for cell in cells))
    return table
