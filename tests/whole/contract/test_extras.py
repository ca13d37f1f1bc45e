"""An installation without the extras: it flies, records and checks, and names what is missing."""

import re
import tomllib
from pathlib import Path

import golden_scenarios
import pytest
from commands import SEVERAL, environment
from flight_logs import recorded
from fresh import run_fresh
from places import ROOT
from px4_logs import write_ulog

import testbed
from testbed.core.errors import DISTRIBUTION, MissingExtraError, needs_extra

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
# Imported at the start of each Python process, also of those that fly for `check`.
SITE = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {libraries}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""
LIBRARIES = (
    *("rerun", "rerun_bindings", "matplotlib", "mpl_toolkits", "pyarrow", "cma", "pymavlink"),
    "pyulog",
    *("pandas", "xarray", "distributed", "dask", "gymnasium", "pettingzoo", "rosbags"),
)
WORKS = (
    "run own.yaml --quiet --out run --duration 1",
    "export run --format npz",
    "export run --format csv",
    "export run --format foxglove",
    "compare run run --numbers",
    "check own.yaml --update --reason first --seeds 3 --jobs 1",
    "check own.yaml --jobs 1",
)
NEEDS = {
    "view run --rrd run.rrd": "view",
    "report run": "report",
    "demo": "report",
    "export run --format parquet": "study",
    "export run --format ros2": "ros2",
    "sweep radio-and-wind": "study",
    "tune x8-middle-loop": "study",
    "run simulation-3 --quiet --out other --mavlink 14777": "mavlink",
    "link pty: pty: --duration 1": "mavlink",
    "import flight.ulg --out flight.csv": "px4",
    "sweep radio-and-wind --backend dask --scheduler tcp://127.0.0.1:1": "study",
}


@pytest.fixture(scope="module")
def without_extras(tmp_path_factory):
    """Run all commands in one process without the extras: (folder, output by command)."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "sitecustomize.py").write_text(SITE.format(libraries=LIBRARIES))
    work = folder / "work"
    work.mkdir()
    golden_scenarios.write(work, "own")
    write_ulog(work / "flight.ulg", recorded()[:50])
    site = (folder / "sitecustomize.py").read_text()
    code = f"{site}\nsys.argv[1:] = {[*WORKS, *NEEDS]}\n{SEVERAL}"
    # variables of processes that it starts
    options = {"folder": work, "paths": [ROOT, folder], "env": environment(120, folder)}
    _, _, errors = run_fresh(code, **options)
    parts = re.split(r"^exit (\d+) (.*)\n", errors, flags=re.M)
    endings = {
        words: (int(code), text)
        for text, code, words in zip(parts[::3], parts[1::3], parts[2::3], strict=False)
    }
    assert list(endings) == [*WORKS, *NEEDS], errors
    return work, endings


def test_commands_work_without_extras(without_extras):
    work, endings = without_extras
    for words in WORKS:
        code, text = endings[words]
        assert code == 0, (words, text)
    assert (work / "golden" / "own.json").is_file()
    assert not (work / "other").exists() and not (work / "logs").exists()


@pytest.mark.parametrize(("words", "extra"), NEEDS.items(), ids=NEEDS)
def test_missing_extra_is_one_error_line(without_extras, words, extra):
    code, text = without_extras[1][words]
    errors = [line for line in text.splitlines() if "14777" not in line]
    assert code == 2 and len(errors) == 1, text
    assert errors[0].startswith("error: ")
    assert errors[0].endswith(f'; write pip install "formation-testbed[{extra}]"')


def test_missing_library_in_python_is_an_import_error():
    with pytest.raises(ImportError, match=r"tables: no_such is not installed; write pip"):
        with needs_extra("study", "tables"):
            import no_such.thing  # noqa: F401
    assert issubclass(MissingExtraError, ValueError)


def test_every_named_extra_exists():
    """The extras of pyproject.toml and those that modules name are the same."""
    named = set()
    for path in Path(testbed.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        named |= set(re.findall(r"(?:needs_extra|install_command)\([\"'](\w+)", text))
    assert PROJECT["name"] == DISTRIBUTION
    assert named <= set(EXTRAS) - {"all", "dev", "docs"}
    assert {"view", "report", "study", "mavlink", "notebook", "dask", "rl"} <= named
    assert {DISTRIBUTION, "testbed"} <= set(PROJECT["scripts"])
    assert set(PROJECT["scripts"].values()) == {"testbed.cli.entry:main"}
