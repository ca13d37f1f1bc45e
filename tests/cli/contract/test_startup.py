"""Modules that commands load; `benchmarks/startup.py` measures how long that takes."""

import inspect
import json
import subprocess
import sys

import pytest
import typer
from commands import environment
from fresh import run_fresh
from places import ROOT

from testbed.cli.exit_codes import EXIT_CODES_HELP
from testbed.cli.main import app, help_text
from testbed.pool.flight_code import FLIGHT_PACKAGES
from testbed.scenario.fields import Section

ENV = environment(120)
UNUSED = {
    "scipy.integrate",
    "scipy.optimize",
    "scipy.special",
    "matplotlib",
    "pyarrow",
    "pandas",
    "rerun",
    "joblib",
    "cma",
    "typer.rich_utils",
    "testbed.mavlink.server",
    "testbed.mavlink.codec",
    "testbed.ardupilot.ardupilot_sitl",
    "testbed.reports",
    "testbed.studies",
    "testbed.views",
}


def loaded_by(code, folder):
    """Names of the modules that a process has loaded at its end."""
    report = "import json, sys; print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; {report}"],
        cwd=folder,
        env=ENV,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stderr.splitlines()[-1]))


# Names of the modules that a flight has loaded, and after it the start of a study.
FLIGHT = """
import json, sys
for parent, _, name in (each.rpartition(".") for each in {unused}):  # what `fresh` has loaded
    sys.modules.pop(f"{{parent}}.{{name}}".lstrip("."), None)
    vars(sys.modules.get(parent, sys)).pop(name, None)
from testbed.cli.main import app
app(["run", "simulation-3", "--duration", "0.2", "-q"], standalone_mode=False)
loaded = list(sys.modules)
import testbed.studies.sweep
print(json.dumps([loaded, list(sys.modules)]))
"""


@pytest.fixture(scope="module")
def after_flight(tmp_path_factory):
    code, folder = FLIGHT.format(unused=sorted(UNUSED)), tmp_path_factory.mktemp("flight")
    code, output, errors = run_fresh(code, folder=folder, paths=[ROOT], env=ENV)
    assert code == 0, errors
    return [set(each) for each in json.loads(output)]


def test_run_loads_only_the_libraries_it_uses(after_flight):
    loaded, _ = after_flight
    assert {"testbed.flight.loop", "numba", "jsbsim", "foxglove"} <= loaded
    assert not any(name.startswith("pymavlink") for name in loaded)
    assert not UNUSED & loaded


def test_flight_packages_are_all_that_are_imported(after_flight):
    """A resumed study compares the code of every package that its flights import."""
    names = {each.split(".")[1] for each in after_flight[1] if each.startswith("testbed.")}
    assert names - {"cli"} == set(FLIGHT_PACKAGES)


def test_margins_load_no_signal_processing(tmp_path):
    """`scipy.signal` takes as long to load as all else that the command loads."""
    code = "import sys, testbed.linear.linear_system; sys.exit('scipy.signal' in sys.modules)"
    assert run_fresh(code, folder=tmp_path, paths=[ROOT], env=ENV)[0] == 0


LIST = """
import sys
sys.modules.update(dict.fromkeys(("numba", "jsbsim", "pyarrow", "matplotlib")))  # not installed
import testbed.scenario
from testbed.cli.main import app
testbed.scenario.list_scenarios = lambda: ("simulation-3",)  # whatever there is
for words in (["list"], ["list", "--json"]):
    app(words, standalone_mode=False)
"""


def test_list_loads_no_compiler(tmp_path):
    code, output, errors = run_fresh(LIST, folder=tmp_path, paths=[ROOT], env=ENV)
    assert code == 0, errors
    assert output.count("simulation-3") >= 2


def test_command_options_are_built_when_called():
    group = typer.main.get_command(app)
    context = group.make_context("testbed", ["run"])
    assert all(not command.params for command in group.commands.values())
    for name, listed in group.commands.items():
        named, command, rest = group.resolve_command(context, [name, "--rest"])
        assert (named, command.name, rest) == (name, name, ["--rest"])
        assert command.help == listed.help == help_text(name)
        if command.callback is None:  # a group
            continue
        # read from the code of the module, and as Python has it
        paragraphs = inspect.getdoc(command.callback).split("\n\n")
        assert command.help.split("\n\n") == [" ".join(each.split()) for each in paragraphs]
        assert command.epilog in (None, EXIT_CODES_HELP)


def test_help_imports_no_module_of_a_command(tmp_path):
    loaded = loaded_by(
        "from testbed.cli.main import app; app(['--help'], standalone_mode=False)", tmp_path
    )
    assert {"testbed.cli.main", "typer.rich_utils"} <= loaded
    assert {each for each in loaded if each.startswith("testbed.cli.")} == {
        "testbed.cli.exit_codes", "testbed.cli.main", "testbed.cli.output",
    }  # fmt: skip
    assert not loaded & {"rich.markdown", "rich.traceback", "pygments", "markdown_it"}
    assert not loaded & {"jsbsim", "numba", "rerun", "numpy", "scipy", "yaml", "mcap", "pydantic"}
    assert not any(name.startswith("pymavlink") for name in loaded)


def sections(of=Section):
    for each in of.__subclasses__():
        yield each
        yield from sections(each)


def test_scenario_annotations_are_objects():
    """Pydantic would evaluate strings, which takes a tenth of the loading of the sections."""
    classes = [each for each in sections() if each.__module__.startswith("testbed.scenario.")]
    assert len(classes) > 50
    strings = {
        each.__module__
        for each in classes
        if any(isinstance(note, str) for note in each.__dict__.get("__annotations__", {}).values())
    }
    assert not strings
