"""`testbed air`: what its probes feel against closed forms, its files, its figure, its errors."""

import json
import math
import re
import struct
from functools import cache

import numpy as np
import pytest
from cases import ALL, in_full
from commands import ROOT, call_command, environment, refuse_all
from forked import Forked
from snapshot import check_snapshot
from typer.testing import CliRunner
from waiting import TIMEOUT_S

from testbed.atmosphere.turbulence_field import make_field
from testbed.cli.main import app
from testbed.core.errors import InputError
from testbed.probes.air_probe import (
    ProbePath,
    aliased,
    closed_form,
    coherence_band,
    estimate,
    fly_probes,
    psd_band,
    unresolved_waves,
)
from testbed.scenario import json_schema, load_scenario, loads

WIND = ("air.wind.speed_mps=8", "air.wind.from_deg=240")
WIND_NED = 8.0 * np.array([math.cos(math.radians(60.0)), math.sin(math.radians(60.0)), 0.0])
START = np.array([640.0, -80.0])  # of the leader of simulation-3
MODEL = "air.turbulence.model"


@cache
def made_small(seed, sigma, length):
    return make_field(seed, np.array(sigma), np.array(length), path_m=1000.0)


def make_small_field(seed, sigma, length, **_):
    """Make a field for a short flight, of 4 km at most, once."""
    return made_small(seed, tuple(sigma), tuple(length))


def air(*arguments, sets=()):
    words = [word for each in sets for word in ("--set", each)]
    return CliRunner().invoke(app, ["air", "simulation-3", *map(str, arguments), *words])


def probed(tmp_path, *arguments, sets=()):
    """Arrays that the command writes."""
    path = tmp_path / "probes.npz"
    done = air("--out", path, *arguments, sets=sets)
    assert done.exit_code == 0, done.output
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def record_probe(
    *sets, duration=400.0, course=0.0, separation=None, height=100.0, airspeed=22.0, rate=50
):
    course = ProbePath(rate, duration, airspeed, math.radians(course), height, separation)
    scenario = load_scenario("simulation-3", sets)
    return scenario, course, fly_probes(scenario, course)


def test_probe_flies_straight_and_drifts_with_wind(tmp_path):
    record = probed(tmp_path, "--course", 30, "--duration", 20, "--height", 150, sets=WIND)
    t = record["t"]
    assert t.shape == (1000,) and t[1] == pytest.approx(0.02) and t[0] == 0.0
    ahead = np.array([math.cos(math.radians(30.0)), 0.5, 0.0])
    path = np.array([*START, -150.0]) + t[:, np.newaxis] * (22.0 * ahead + WIND_NED)
    assert np.allclose(record["position_ned"][0], path, atol=1e-8)
    assert np.allclose(record["mean_wind_ned"][0], WIND_NED, atol=1e-12)
    assert np.allclose(record["wind_ned"], record["mean_wind_ned"], atol=1e-12)
    assert not record["wind_gradient_rates"].any()
    assert np.isnan(record["sigma"]).all() and np.isnan(record["length"]).all()


def test_file_describes_its_arrays(tmp_path):
    sets = (f"{MODEL}=dryden",)
    record = probed(tmp_path, "--duration", 2, "--separation", 40, "--course", 90, sets=sets)
    assert all(name in str(record["schema"]) for name in record if name != "schema")
    assert record["names"].tolist() == ["leader", "uav1"]
    assert record["wind_ned"].shape == record["wind_gradient_rates"].shape == (2, 100, 3)
    assert (
        str(record["model"]) == "dryden"
        and record["airspeed"] == 22.0
        and record["height"] == 100.0
    )
    assert record["course_rad"] == pytest.approx(math.pi / 2)
    assert record["span"] == pytest.approx(2.795, abs=1e-3)
    # to the right of east is south
    apart = record["position_ned"][1] - record["position_ned"][0]
    assert np.allclose(apart, [-40.0, 0.0, 0.0], atol=1e-9)
    # MIL-F-8785C at 100 m, by hand: h = 328.08 ft, 0.177 + 0.000823 h = 0.44701
    assert record["length"] == pytest.approx([262.7, 262.7, 100.0], abs=0.1)
    assert record["sigma"] == pytest.approx([2.130, 2.130, 1.543], abs=1e-3)
    assert "model: dryden" in str(record["scenario"])


def test_file_depends_only_on_the_seed(tmp_path):
    words = ("--duration", 4, "--separation", 5)
    files = [tmp_path / name for name in ("one", "two", "other")]
    for path, seed in zip(files, (7, 7, 8), strict=True):
        done = air(*words, "--out", path, "--seed", seed, sets=(f"{MODEL}=von-karman",))
        assert done.exit_code == 0
    one, two, other = (path.read_bytes() for path in files)
    assert one == two != other


@pytest.mark.parametrize("course", [90.0, 210.0])
def test_turbulence_turns_with_the_course(course):
    _, straight, independent = record_probe(f"{MODEL}=von-karman", *WIND, duration=20.0)
    _, turned, pair = record_probe(
        f"{MODEL}=von-karman", *WIND, duration=20.0, course=course, separation=500.0
    )
    along, turned_along = independent.about_mean(straight.course), pair.about_mean(turned.course)
    assert np.allclose(along[0], turned_along[0], atol=1e-9)
    assert np.allclose(independent.wind_gradient_rates[0], pair.wind_gradient_rates[0], atol=1e-12)
    assert not np.allclose(turned_along[0], turned_along[1], atol=0.1)


def test_wind_profile_is_taken_at_probe_height(tmp_path):
    profile = "air.wind.profile={kind: log, height_m: 10, roughness_m: 0.03}"
    record = probed(tmp_path, "--duration", 3, "--height", 60, sets=(*WIND, profile))
    factor = math.log(60.0 / 0.03) / math.log(10.0 / 0.03)
    assert np.allclose(record["mean_wind_ned"][0], factor * WIND_NED, atol=1e-9)
    moved = np.diff(record["position_ned"][0], axis=0) / 0.02
    assert np.allclose(moved, factor * WIND_NED + [22.0, 0.0, 0.0], atol=1e-6)


def test_gust_in_time_has_its_written_shape(tmp_path):
    gust = "air.gusts=[{kind: time, name: up, velocity_mps: [0, 1, -3], at_s: 2, ramp_s: 1.5}]"
    record = probed(tmp_path, "--duration", 8, sets=(*WIND, gust))
    x = np.clip((record["t"] - 2.0) / 1.5, 0.0, 2.0)
    shape = 0.5 * (1.0 - np.cos(np.pi * x))
    extra = record["wind_ned"][0] - record["mean_wind_ned"][0]
    assert np.allclose(extra, np.outer(shape, [0.0, 1.0, -3.0]), atol=1e-9)
    assert np.allclose(record["wind_gradient_rates"], 0.0, atol=1e-12)


def test_wakes_do_not_change_probes():
    words = (f"{MODEL}=dryden", *WIND)
    _, _, with_wakes = record_probe(*words, "air.wake={}", duration=4.0, separation=2.0)
    _, _, without = record_probe(*words, duration=4.0, separation=2.0)
    assert np.array_equal(with_wakes.wind_ned, without.wind_ned)


def test_recorded_wind_moves_probes(tmp_path):
    (tmp_path / "wind.csv").write_text("t_s,north_mps,east_mps\n0,0,0\n10,0,5\n1080,0,5\n")
    scenario = (
        "extends: simulation-3\n"
        "scenario: {schema: 2, name: windy}\n"
        "air: {wind: {file: wind.csv, max_gap_s: 1070}}\n"
    )
    (tmp_path / "windy.yaml").write_text(scenario)
    out = tmp_path / "probes.npz"
    words = ["air", str(tmp_path / "windy.yaml"), "--out", str(out), "--duration"]
    assert CliRunner().invoke(app, [*words, "20"]).exit_code == 0
    with np.load(out) as record:
        t, drift = record["t"], record["position_ned"][0, :, 1] - START[1]
    assert np.allclose(drift, np.where(t < 10.0, 0.25 * t**2, 25.0 + 5.0 * (t - 10.0)), atol=1e-6)
    late = CliRunner().invoke(app, [*words, "1081"])
    assert isinstance(late.exception, InputError)
    assert "--duration 1081: the recorded wind ends after 1080 s" in str(late.exception)


def share_inside(values, low, high):
    """Share of the known estimates that lie inside, and their number."""
    known = np.isfinite(values) & np.isfinite(np.broadcast_to(low, values.shape))
    inside = (values >= low) & (values <= high)
    return inside[known].mean(), known.sum()


def least_share(count):
    """Share of independent estimates in 95 % bands, exceeded in all but 1 of 10,000 cases."""
    return 0.95 - 3.72 * math.sqrt(0.95 * 0.05 / count)


@pytest.mark.parametrize("correlation", [0.0, 0.7])
def test_bands_hold_95_percent_for_white_noise(correlation):
    rng = np.random.default_rng(3)
    shared, own = rng.standard_normal((20_000, 3)), rng.standard_normal((2, 20_000, 3))
    noise = math.sqrt(correlation) * shared + math.sqrt(1.0 - correlation) * own
    found = estimate(noise, 50.0)
    level = np.full((3, len(found.freedom)), 1.0 / 25.0)  # variance 1 over 0 to 25 Hz
    share, count = share_inside(found.psd, *psd_band(level, found.freedom))
    assert count > 300
    assert share > least_share(count)
    expected_coherence = np.full_like(level, correlation)
    share, count = share_inside(found.coherence, *coherence_band(expected_coherence, found.freedom))
    assert count > 100
    assert share > least_share(count)


def test_folded_spectrum_is_that_of_samples():
    # dx = −x/τ dt + noise, of unit variance: sampled it is an autoregression with φ = exp(−dt/τ)
    rate, tau = 50.0, 2.0
    frequency = np.geomspace(0.01, 25.0, 40)
    phi = math.exp(-1.0 / rate / tau)
    sampled = (
        2.0 / rate * (1.0 - phi**2) / np.abs(1.0 - phi * np.exp(2j * np.pi * frequency / rate)) ** 2
    )
    density = aliased(lambda f: 4.0 * tau / (1.0 + (2.0 * np.pi * f * tau) ** 2), frequency, rate)
    assert np.allclose(density, sampled, rtol=1e-3)


@pytest.fixture(scope="module")
def recorded():
    """A function of a model: what two probes near each other record, once."""

    @cache
    def record(model):
        pair = {"course": 40.0, "separation": 10.0, "duration": 400.0 if ALL else 120.0}
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("testbed.plan.air.make_field", make_small_field)
            return record_probe(f"{MODEL}={model}", *WIND, **pair)

    return record


@pytest.mark.parametrize("model", ["dryden", pytest.param("von-karman", marks=in_full), "coherent"])
def test_spectra_and_coherence_match_closed_forms(model, recorded):
    scenario, course, record = recorded(model)
    found = estimate(record.about_mean(course.course), course.rate_hz)
    closed = closed_form(scenario, course, record, found)
    # the field has no waves shorter than some cells of its finest grid, which pass at 8 Hz
    low = found.frequency_hz < (3.0 if model == "coherent" else 25.0)
    psd = psd_band(closed.psd, found.freedom)
    share, count = share_inside(found.psd[..., low], *(each[:, low] for each in psd))
    # probes 10 m apart in one field are nearly equal: count them once
    assert share > least_share(count / 2)
    coherence = coherence_band(closed.coherence, found.freedom)
    share, count = share_inside(found.coherence[:, low], *(each[:, low] for each in coherence))
    assert share > least_share(count)
    assert (closed.coherence[:, 0] > 0.9).all() == (model == "coherent")


def test_closed_form_of_small_wing_is_that_of_point(recorded):
    scenario, course, record = recorded("coherent")
    found = estimate(record.about_mean(course.course), course.rate_hz)
    closed = closed_form(scenario, course, record._replace(span=1e-6), found).psd
    independent = scenario.model_copy(
        update={"air": load_scenario("simulation-3", (f"{MODEL}=von-karman",)).air}
    )
    assert np.allclose(closed, closed_form(independent, course, record, found).psd, rtol=5e-3)


def test_table_has_the_statistics_of_the_arrays(tmp_path):
    out = tmp_path / "probes.npz"
    words = ("--duration", 30, "--separation", 5, "--out", out, "--json", "-")
    done = air(*words, sets=(*WIND, f"{MODEL}=von-karman"))
    table = json.loads(done.stdout)
    with np.load(out) as record:
        moving = record["wind_ned"] - record["mean_wind_ned"]
        rates, sigma = record["wind_gradient_rates"], record["sigma"]
    assert table["model"] == {
        "name": "von-karman",
        "sigma_mps": pytest.approx(sigma.tolist()),
        "length_m": pytest.approx([262.7, 262.7, 100.0], abs=0.1),
    }
    for k, probe in enumerate(table["probes"]):
        assert probe["mean_wind_mps"] == pytest.approx(8.0)
        assert probe["mean_wind_from_deg"] == pytest.approx(240.0)
        assert probe["rms_mps"] == pytest.approx(np.sqrt((moving[k] ** 2).mean(axis=0)).tolist())
        rms = np.degrees(np.sqrt((rates[k] ** 2).mean(axis=0)))
        assert probe["rms_rates_deg_s"] == pytest.approx(rms.tolist())
    assert f"{table['probes'][1]['rms_mps'][2]:.2f}" in done.stderr


@pytest.mark.parametrize("model", ["none", "coherent"])
def test_table_fits_80_columns(model, tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.plan.air.make_field", make_small_field)
    words = ("air", "simulation-3", "--duration", "2", "--separation", "5", "--set")
    done = call_command(
        *words, f"{MODEL}={model}", "--json", "table.json", cwd=tmp_path, code=0, columns=80
    )
    check_snapshot(f"air_{model}", done.stdout)
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert json.loads((tmp_path / "table.json").read_text())["separation_m"] == 5.0
    narrow = call_command(*words, f"{MODEL}={model}", cwd=tmp_path, code=0, columns=60)
    assert "…" not in narrow.stdout


PLOTS = (("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.SVG", b"<?xml"))


@in_full
@pytest.mark.parametrize(("name", "start"), PLOTS)
def test_plot_is_reproducible(name, start, tmp_path):
    """`make test` draws the plot of the network, whose SVG has a date and ids."""
    drawn = []
    for _ in range(2 if name == "a.png" else 1):
        done = air("--duration", 4, "--plot", tmp_path / name, sets=(f"{MODEL}=von-karman",))
        assert done.exit_code == 0, done.exception
        drawn.append((tmp_path / name).read_bytes())
    assert drawn[0].startswith(start) and drawn[0] == drawn[-1]
    if name == "a.png":
        assert struct.unpack(">II", drawn[0][16:24]) == (3200, 2000)


def test_shaded_frequencies_lack_short_waves(recorded):
    scenario, course, record = recorded("coherent")
    found = estimate(record.about_mean(course.course), course.rate_hz)
    share = found.psd[0] / closed_form(scenario, course, record, found).psd
    begin, shortest = unresolved_waves(scenario, course)
    assert shortest == pytest.approx(2.0)
    shaded = found.frequency_hz > begin
    near = (found.frequency_hz > 0.3 * begin) & (found.frequency_hz < 0.5 * begin)
    assert share[:, near].mean() > 0.75
    assert share[:, shaded].mean() < 0.35 and share[:, shaded][:, -1].max() < 1e-3


@pytest.mark.parametrize("model", ["none", "coherent"])
def test_plot_of_two_probes_has_coherence(model, tmp_path, monkeypatch):
    sheets = []
    monkeypatch.setattr(
        "testbed.views.matplotlib_backend.save_figure", lambda sheet, *_: sheets.append(sheet)
    )
    monkeypatch.setattr("testbed.plan.air.make_field", make_small_field)
    words = ("--duration", 20, "--separation", 50, "--plot", tmp_path / "a.png")
    assert air(*words, sets=(f"{MODEL}={model}",)).exit_code == 0
    rows = sheets[0].rows
    assert [len(row) for row in rows] == [3, 3, 3]
    for record, spectrum, coherence in rows:
        assert record.drawn  # without turbulence, a line at zero
        assert spectrum.drawn == coherence.drawn == (model != "none")
        assert len(spectrum.bands) == len(coherence.bands) == (model != "none")
        assert coherence.lines[0].label == "between the probes, 50 m apart"
        # V / (2 m + 2.9 m)
        assert [span.start for span in spectrum.spans] == pytest.approx(
            [22.0 / 4.909] if model == "coherent" else [], rel=1e-3
        )


def test_bad_input_error_has_the_remedy(tmp_path):
    refuse_all("air", tmp_path)


def test_only_plot_loads_matplotlib(tmp_path):
    code = (
        "from testbed.cli.main import app;"
        "app(['air', 'simulation-3', '--duration', '1'], standalone_mode=False);"
        "sys.exit('matplotlib' in sys.modules)"
    )
    code = f"import sys; assert 'matplotlib' not in sys.modules; {code}"
    with (tmp_path / "errors").open("w+b") as errors:
        done = Forked("forked:execute", code, cwd=tmp_path, env=environment(80), stderr=errors)
        assert done.wait(TIMEOUT_S) == 0, (tmp_path / "errors").read_text()


BLOCKS = re.findall(r"^```yaml\n(.*?)^```$", (ROOT / "docs/air.md").read_text(), re.M | re.S)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_examples_of_the_docs_are_valid(block):
    scenario = loads(f"extends: simulation-3\n{block}")
    assert scenario.air != load_scenario("simulation-3").air


def test_docs_name_every_key_of_air():
    text = (ROOT / "docs/air.md").read_text()

    def keys(section):
        for name, child in section.get("properties", {}).items():
            yield name
            yield from keys(child)
        for each in (*section.get("oneOf", ()), *section.get("anyOf", ())):
            yield from keys(each)
        yield from keys(section.get("items", {})) if "items" in section else ()

    tree = json_schema()
    named = set(keys(resolved(tree["properties"]["air"], tree)))
    assert {"from_deg", "towards_deg", "memory_s", "exponent"} < named
    assert not {name for name in named if name not in text}


def resolved(section, tree):
    """A part of a JSON schema with its references put in."""
    if isinstance(section, list):
        return [resolved(each, tree) for each in section]
    if not isinstance(section, dict):
        return section
    section = dict(section)
    if "$ref" in section:
        section = tree["$defs"][section["$ref"].split("/")[-1]] | section
        section.pop("$ref")
    return {name: resolved(each, tree) for name, each in section.items()}
