"""Modules that commands load; `benchmarks/startup.py` measures how long that takes."""

import inspect
import json
import subprocess
import sys

import typer
from commands import environment
from fresh import run_fresh
from places import ROOT

import testbed
from testbed.cli.exit_codes import EXIT_CODES_HELP
from testbed.cli.main import app, help_text
from testbed.scenario import load_scenario, set_duration
from testbed.scenario.fields import Section

ENV = environment(120)


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


def test_run_loads_only_the_libraries_it_uses(tmp_path):
    code = (
        "from testbed.cli.main import app;"
        "app(['run', 'simulation-3', '--duration', '0.2', '-q'], standalone_mode=False)"
    )
    # fill the cache of compiled code
    testbed.run(set_duration(load_scenario("simulation-3"), 0.2), out=tmp_path / "run")
    loaded = loaded_by(code, tmp_path)
    assert {"testbed.flight.loop", "numba", "jsbsim", "foxglove"} <= loaded
    unused = {
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
    assert not any(name.startswith("pymavlink") for name in loaded)
    assert not unused & loaded


def test_margins_load_no_signal_processing(tmp_path):
    """`scipy.signal` takes as long to load as all else that the command loads."""
    code = "import sys, testbed.linear.linear_system; sys.exit('scipy.signal' in sys.modules)"
    assert run_fresh(code, folder=tmp_path, paths=[ROOT], env=ENV)[0] == 0


def test_list_loads_no_compiler(tmp_path):
    code = "from testbed.cli.main import app"
    for words in (["list"], ["list", "--json"]):
        code += f"; app({words}, standalone_mode=False)"
    loaded = loaded_by(code, tmp_path)
    assert "testbed.scenario" in loaded
    assert not {"numba", "jsbsim", "pyarrow", "matplotlib"} & loaded


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
