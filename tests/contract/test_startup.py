"""What a command loads before it does what it is asked for: nothing it has no use for.

`benchmarks/startup.py` measures how long that takes; here is what does not depend on the machine.
"""

import inspect
import json
import subprocess
import sys

import pytest
import typer
from commands import environment
from rich.markdown import Markdown

import testbed
from testbed.cli import app
from testbed.scenario import load, shorten
from testbed.scenario.fields import Section
from testbed.standing_in import standing_in

ENV = environment(120)


def loaded_by(code, folder):
    """Names of the modules that a process has loaded in the end."""
    tell = "import json, sys; print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; {tell}"],
        cwd=folder,
        env=ENV,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stderr.splitlines()[-1]))


def test_a_plain_run_loads_no_room_that_it_does_not_enter(tmp_path):
    code = (
        "from testbed.cli import app;"
        "app(['run', 'simulation-3', '--duration', '0.2', '-q'], standalone_mode=False)"
    )
    page = shorten(load("simulation-3"), 0.2)
    testbed.run(page, out=tmp_path / "run")  # compiles what is not yet
    loaded = loaded_by(code, tmp_path)
    assert {"testbed.sim.loop", "numba", "jsbsim", "foxglove"} <= loaded
    strangers = {
        "scipy.integrate",
        "scipy.linalg",
        "scipy.optimize",
        "scipy.special",
        "matplotlib",
        "pyarrow",
        "pandas",
        "rerun",
        "joblib",
        "cma",
        "typer.rich_utils",
        "numba.typed.typedlist",  # of all that numba loads only to compile
        "testbed.links.station",
        "testbed.mavlink.door",
        "testbed.ardupilot.link",
        "testbed.report",
        "testbed.study",
        "testbed.views",
    }
    assert not any(name.startswith("pymavlink") for name in loaded)
    assert not strangers & loaded


def test_a_command_is_built_when_it_is_called_and_is_the_one_that_is_listed():
    group = typer.main.get_command(app)
    context = group.make_context("testbed", ["run"])
    assert all(not command.params for command in group.commands.values())
    for name, listed in group.commands.items():
        named, command, rest = group.resolve_command(context, [name, "--rest"])
        assert (named, command.name, rest) == (name, name, ["--rest"])
        assert command.help == listed.help == inspect.getdoc(group.functions[name])
        assert command.epilog == group.epilogs.get(name)
    assert set(group.epilogs) < set(group.commands)


def test_a_stand_in_is_there_for_the_block_alone():
    missing = "html.nobody_has_this"
    with standing_in("rich.markdown", missing):
        import html.nobody_has_this as stranger

        from rich.markdown import Markdown as known  # there already: not stood in for

        assert isinstance(stranger.Anything, type)
        assert stranger.Anything | int
        with pytest.raises(AttributeError):
            stranger.__path__  # noqa: B018 - looking is the point
    assert known is Markdown
    assert missing not in sys.modules
    with pytest.raises(ModuleNotFoundError), standing_in(missing):
        raise ModuleNotFoundError
    assert missing not in sys.modules


def test_help_leaves_the_real_modules_to_who_wants_them(tmp_path):
    code = (
        "from testbed.cli import app; app(['--help'], standalone_mode=False);"
        "from rich.markdown import Markdown; from rich.traceback import Traceback;"
        "from rich.console import Console; Console().print(Markdown('*so*'))"
    )
    assert {"rich.markdown", "markdown_it", "rich.traceback"} <= loaded_by(code, tmp_path)


def test_after_a_flight_numba_compiles_whatever_it_could(tmp_path):
    """Twins are loaded without what compiling needs, scipy's linear algebra among it."""
    code = (
        "import numba, numpy as np, testbed;"
        "testbed.run('simulation-3', ['log.mcap=false', 'scenario.duration_s=0.2',"
        " 'scenario.portions=null', 'scenario.published=null'], write=False);"
        "times = numba.njit(lambda a, b: a @ b);"
        "one = times(2.0 * np.eye(3), np.ones((3, 3)));"
        "assert (one == 2.0).all(), one"
    )
    assert {"scipy.linalg.cython_blas", "numba.typed.typedlist"} <= loaded_by(code, tmp_path)


def sections(of=Section):
    for each in of.__subclasses__():
        yield each
        yield from sections(each)


def test_annotations_of_a_page_are_objects():
    """Text would be evaluated by pydantic, which is a tenth of loading the page's sections."""
    ours = [each for each in sections() if each.__module__.startswith("testbed.scenario.")]
    assert len(ours) > 50
    as_text = {
        each.__module__
        for each in ours
        if any(isinstance(note, str) for note in each.__dict__.get("__annotations__", {}).values())
    }
    assert not as_text
