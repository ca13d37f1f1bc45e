"""Arguments of `testbed.run`, the data of a run, its progress, and short flights."""

import io
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import testbed
from testbed.cli.options import read_time
from testbed.cli.run import next_commands
from testbed.core.errors import InputError
from testbed.runs import flight_progress as progress
from testbed.scenario import load_scenario, set_duration

NO_LOG = ["log.mcap=false"]
NOISY = [*NO_LOG, "fleet.*.sensors=gps-ins"]


def test_run_takes_duration_and_seed():
    runs = [testbed.run("simulation-3", NOISY, duration_s=1, seed=s, write=False) for s in (7, 8)]
    assert [each.metrics["seed"] for each in runs] == [7, 8]
    assert [each.metrics["simulated_s"] for each in runs] == [1.0, 1.0]
    errors = [each.metrics["estimate_error"]["uav1"]["horizontal_m"] for each in runs]
    assert errors[0] != errors[1]
    whole = set_duration(load_scenario("simulation-3", [*NOISY, "scenario.seed=7"]), 1)
    assert (
        testbed.run(whole, write=False).metrics["estimate_error"]
        == runs[0].metrics["estimate_error"]
    )
    batch = testbed.Batch("simulation-3", NOISY, seeds=[7], duration_s=1, threads=1)
    assert batch.run()[0]["estimate_error"] == runs[0].metrics["estimate_error"]
    with testbed.Simulation("simulation-3", NOISY, seed=7, duration_s=1) as simulation:
        simulation.step(until=2.0)
        assert (simulation.outcome, simulation.time_s) == ("completed", 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration_s": 0}, r"duration_s: is 0 \(write a number above 0\)"),
        ({"duration_s": float("nan")}, r"duration_s: is nan \(write a finite number\)"),
        ({"duration_s": 1e6}, r"duration_s: is 1000000 \(write a number at most 86400\)"),
        ({"seed": -1}, r"seed: is -1 \(write a number at least 0\)"),
        ({"seed": 2**63}, r"seed: is "),
        ({"progress": 3}, r"progress: is 3 \(write a function\)"),
        ({"overrides": "network.delay_s=0.1"}, r"write a list: \['network.delay_s=0.1'\]"),
    ],
    ids=str,
)
def test_run_arguments_are_checked(arguments, message):
    with pytest.raises(InputError, match=message):
        testbed.run("simulation-3", write=False, **arguments)


def test_run_reads_its_data_when_it_is_used(tmp_path):
    flown = testbed.run("simulation-3", duration_s=0.4, out=tmp_path / "run")
    assert flown.data is flown.data
    errors = np.linalg.norm(flown.data.log.formation.error_ned, axis=2).max(axis=0)
    assert errors.tolist() == pytest.approx(list(flown.metrics["max_error_m"].values()), rel=1e-12)
    with pytest.raises(InputError, match="data: this run wrote no log .leave out write=False"):
        testbed.run("simulation-3", duration_s=0.4, write=False).data  # noqa: B018
    with pytest.raises(InputError, match="write log: {mcap: true}"):
        testbed.run("simulation-3", NO_LOG, duration_s=0.4, out=tmp_path / "other").data  # noqa: B018


def test_short_flight_has_errors_of_its_second_half():
    whole = load_scenario("simulation-3")
    assert set_duration(whole, 1080).scenario.windows == whole.scenario.windows
    assert dict(set_duration(whole, 96).scenario.windows) == {"rectangles": (95.0, 96.0)}
    assert dict(set_duration(whole, 95).scenario.windows) == {"second_half": (47.5, 95.0)}
    later = load_scenario("late-radio-loss")  # which begins at 300 s
    assert dict(set_duration(later, 310).scenario.windows) == {"second_half": (305.0, 310.0)}
    assert not set_duration(load_scenario("hold-slot"), 5).scenario.windows  # it has none
    flown = testbed.run("simulation-3", NO_LOG, duration_s=2, write=False)
    window = flown.metrics["windows"]["second_half"]
    assert window["window_s"] == [1.0, 2.0] and window["mean_rms_m"] > 1.0
    assert repr(flown).splitlines()[1:3] == [
        "RMS error, m  second_half",
        "                    1–2 s",
    ]


def test_progress_calls_a_function():
    calls = []
    testbed.run(
        "simulation-3", NO_LOG, duration_s=2, write=False, progress=lambda *a: calls.append(a)
    )
    flying = [call[1:] for call in calls if call[0] == "flying"]
    assert flying[0] == (0.0, 2.0) and flying[-1] == (2.0, 2.0)
    assert {call[0] for call in calls} <= {"compiling", "flying"}

    def stop(phase, done, total):
        if phase == "flying":
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        testbed.run("simulation-3", NO_LOG, duration_s=2, write=False, progress=stop)


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_is_shown_in_terminals_and_logs(terminal, monkeypatch):
    monkeypatch.setattr(progress, "_LOG_S", 0.0)
    file = io.StringIO()
    display = progress.make_display("mine", Console(file=file, force_terminal=terminal, width=80))
    for call in (
        ("compiling", 0, 17),
        ("compiling", 17, 17),
        ("flying", 0, 60),
        ("flying", 30, 60),
    ):
        display(*call)
    display.close()
    display.close()
    text = file.getvalue()
    assert text.count("compiling kernels; later runs load them") == 1
    assert "17 of 17 kernels" in text
    assert ("mine: 30 of 60 s simulated" in text) is not terminal
    assert text.endswith("\x1b[1A\x1b[2K") is terminal  # the bar is removed


def test_progress_in_a_notebook_is_one_line(monkeypatch):
    shown = []
    handle = SimpleNamespace(update=lambda content, raw: shown.append(content["text/plain"]))

    def display(content, raw, display_id):
        shown.append(content["text/plain"])
        return handle

    fakes = {
        "IPython": {"get_ipython": lambda: SimpleNamespace(kernel=object())},
        "IPython.display": {"display": display},
    }
    for name, content in fakes.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    testbed.run("simulation-3", NO_LOG, duration_s=2, write=False)
    assert "simulation-3: 2 s simulated in " in shown[-1]
    shown.clear()
    testbed.run("simulation-3", NO_LOG, duration_s=1, write=False, progress=False)
    assert shown == []


def test_scripts_show_no_progress_unless_asked(capfd):
    testbed.run("simulation-3", NO_LOG, duration_s=1, write=False)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("120", 120.0), ("90s", 90.0), ("2m", 120.0), ("1.5 h", 5400.0), ("1d", 86400.0)],
)
def test_time_of_an_option_is_read(text, seconds):
    assert read_time("--duration", text) == seconds


@pytest.mark.parametrize("text", ["2x", "", "nan", "-1", "0s", "1e-9", "1_0", "m"])
def test_wrong_time_of_an_option_is_refused(text):
    with pytest.raises(InputError, match="--duration .*: write a time "):
        read_time("--duration", text)


def test_next_commands_name_the_run(tmp_path):
    scenario = load_scenario("simulation-3")
    assert [line.split("testbed ")[1] for line in next_commands(tmp_path / "my run", scenario)] == [
        f"view '{tmp_path}/my run'",
        f"report '{tmp_path}/my run'",
        f"video '{tmp_path}/my run' --out simulation-3.mp4",
    ]
    assert next_commands(None, scenario) == []
    assert next_commands(tmp_path, load_scenario("simulation-3", NO_LOG)) == []
