"""The action for other repositories: its steps as scripts, on a repository with its own files."""

import json
import os
import re
import shutil
import sys
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree

import pytest
import yaml
from cases import ALL
from commands import call_command, environment
from places import ROOT
from shells import run_shell, write_program
from small_study import in_this_process

from testbed.core.compile import cache_folder
from testbed.reports import figures
from testbed.scenario import library

ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
BAD_INPUT, DIFFERENT = 2, 3
SCENARIO = """\
extends: simulation-3
scenario:
  name: pursuit
  duration_s: 8
  windows: {rectangles: null, circles: null, settled: [4, 8]}
  published: null
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]}
  - {name: uav3, aircraft: rascal110, start_m: [-5, -5, 4]}
controller: {law: pursuit:LeaderFollower, options: {closing: 0.3}}
expect:
  min_separation_m: {min: 5}
  rms_m: {max: 1.5}
"""
# what a script of a step may use of its runner
WORDS = re.compile(r"\$\{\{ *([a-z_.-]+) *\}\}")


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """A repository with a scenario, a law and a golden table of its own."""
    folder = tmp_path_factory.mktemp("repository")
    (folder / "flights").mkdir()
    (folder / "flights" / "pursuit.yaml").write_text(SCENARIO)
    shutil.copy(library() / "scenarios" / "leader_follower.py", folder / "flights" / "pursuit.py")
    options = ("--update", "--reason", "First flights of our law.", "--jobs", 1)
    options += () if ALL else ("--seeds", 5)
    with in_this_process():
        call_command("check", "flights/pursuit.yaml", *options, cwd=folder, code=0, columns=100)
    return folder


class Runner:
    """Runs the scripts of the action as a runner of GitHub does.

    The command runs in this process, or in one of its own, as an installed one does.
    """

    def __init__(self, repository, temporary, *, installed=False, **inputs):
        self.repository, self.temporary = repository, temporary
        defaults = {name: each.get("default", "") for name, each in ACTION["inputs"].items()}
        self.inputs = {f"inputs.{name}": value for name, value in (defaults | inputs).items()}
        self.inputs["github.action_path"] = str(ROOT)
        temporary.mkdir()
        programs = temporary / "testbed" / "bin"
        if installed:
            programs.parent.mkdir()
            programs.symlink_to(Path(sys.executable).parent)
        else:
            programs.mkdir(parents=True)
            write_program(programs / "testbed")
        cache = temporary / ".cache" / "testbed-check"
        cache.mkdir(parents=True)
        (cache / "kernels").symlink_to(cache_folder().parent)  # as restored from an earlier job

    def run(self, name):
        """Run the script of a step, and return its exit code and what it printed."""
        (step,) = [each for each in ACTION["runs"]["steps"] if each.get("name") == name]
        assert "${{" not in step["run"]  # values come by the environment, never into the script
        variables = {key: self.expand(value) for key, value in step["env"].items()}
        files = {
            f"GITHUB_{key}": str(self.temporary / key.lower()) for key in ("STEP_SUMMARY", "OUTPUT")
        }
        script = self.temporary / "step.sh"
        script.write_text(step["run"])
        outside = {"GITHUB_WORKSPACE": str(self.repository)}
        with in_this_process(), patch.dict(os.environ, outside):
            return run_shell(
                ["bash", "--noprofile", "--norc", "-eo", "pipefail", script],
                cwd=self.repository / self.expand(step.get("working-directory", ".")),
                env={
                    **environment(100),
                    "HOME": str(self.temporary),
                    "RUNNER_TEMP": str(self.temporary),
                    **outside,
                    **files,
                    **variables,
                },
                columns=100,
            )

    def expand(self, text):
        return WORDS.sub(lambda found: self.inputs[found[1]], text)

    def read(self, name):
        return (self.temporary / name).read_text(encoding="utf-8")

    def folders(self):
        """Folders of the checks so far, as the action puts them out."""
        return [Path(each) for each in re.findall(r"^folder=(.*)$", self.read("output"), re.M)]


def test_action_passes_with_a_summary(repository, tmp_path):
    inputs = {"scenarios": "flights/*.yaml", "options": "--jobs 1"}
    # by the tests of cli, the command in its process is that of a process of its own
    runner = Runner(repository, tmp_path / "runner", installed=ALL, **inputs)
    code, printed = runner.run("Check")
    assert code == 0, printed
    assert "1 passed" in printed and "::error" not in printed
    assert "exit-code=0\n" in runner.read("output")
    summary = runner.read("step_summary")
    assert summary.startswith("## testbed check: 1 passed\n")
    assert "| settled uav1 RMS error, m |" in summary and "█" in summary
    root = ElementTree.parse(runner.folders()[-1] / "golden.xml").getroot()
    assert root.get("failures") == "0" and int(root.get("tests")) > 10
    names = {case.get("name") for case in root.iter("testcase")}
    assert {"expect.rms_m.max", "expect.min_separation_m.min"} <= names


def test_action_fails_with_lines_and_a_report(repository, tmp_path, monkeypatch):
    """A weaker law: exit code 3, annotations at file and line, the summary, a flight to look at."""
    monkeypatch.setattr(figures, "MAKERS", figures.MAKERS[:1])  # drawing all takes seconds
    changed = tmp_path / "changed"
    shutil.copytree(repository, changed)
    path = changed / "flights" / "pursuit.yaml"
    path.write_text(path.read_text().replace("closing: 0.3", "closing: 0.1").replace("1.5", "0.2"))
    runner = Runner(
        changed,
        tmp_path / "runner",
        scenarios="pursuit.yaml",
        options="--jobs 1 --seeds 1",
        **{"working-directory": "flights"},
    )
    code, printed = runner.run("Check")
    assert code == DIFFERENT, printed
    bound, row = [line for line in printed.splitlines() if line.startswith("::error ")]
    line = 1 + path.read_text().splitlines().index("  rms_m: {max: 0.2}")
    assert bound.startswith(
        f"::error file=flights/pursuit.yaml,title=pursuit.yaml%3A expect.rms_m.max,line={line},"
    )
    assert re.search(r"::seed 1, uav\d in settled: \S+ m, above 0\.2 m", bound)
    file, number = re.match(r"::error file=([^,]+),title=[^,]+,line=(\d+),", row).groups()
    assert file == "flights/golden/pursuit.json"
    place = (changed / file).read_text().splitlines()[int(number) - 1]
    assert place.lstrip().startswith(('"rms_m/settled/', '"mean_rms_m/settled"'))
    assert "controller.options.closing is now 0.1" in row
    assert "exit-code=3\n" in runner.read("output")

    summary = runner.read("step_summary")
    assert summary.startswith("## testbed check: 1 failed, 0 passed\n")
    assert "Golden table: First flights of our law." in summary
    assert "controller.options.closing is now 0.1" in summary
    assert "testbed run pursuit.yaml --seed 1" in summary

    found = runner.folders()[-1]
    (scenario,) = json.loads((found / "check.json").read_text())["scenarios"]
    assert {each["key"]: bool(each["violations"]) for each in scenario["bounds"]} == {
        "expect.min_separation_m.min": False,
        "expect.rms_m.max": True,
    }
    failures = list(ElementTree.parse(found / "golden.xml").getroot().iter("failure"))
    assert failures and all("testbed run pursuit.yaml --seed 1" in each.text for each in failures)
    assert {each.name for each in (found / "reports" / "pursuit").iterdir()} >= {
        "run.mcap",
        "report.html",
    }


def test_action_passes_the_tolerance(repository, tmp_path):
    """Each word is one; the weaker law of the test above is within the tolerance."""
    changed = tmp_path / "changed"
    shutil.copytree(repository, changed)
    path = changed / "flights" / "pursuit.yaml"
    path.write_text(path.read_text().replace("closing: 0.3", "closing: 0.1"))
    inputs = {"scenarios": "flights/pursuit.yaml", "options": "--jobs 1 --seeds 1"}
    runner = Runner(changed, tmp_path / "runner", **inputs, tolerance="rms_m=900% 1000%")
    code, printed = runner.run("Check")
    assert code == 0, printed
    runner.inputs["inputs.tolerance"] = "rms_m=5% 5"
    code, printed = runner.run("Check")
    assert code == BAD_INPUT and "--tolerance 5: write 5% for all numbers" in printed


def test_action_annotates_bad_input(repository, tmp_path):
    changed = tmp_path / "changed"
    shutil.copytree(repository, changed)
    path = changed / "flights" / "pursuit.yaml"
    path.write_text(path.read_text().replace("rms_m:", "rms:"))
    runner = Runner(changed, tmp_path / "runner", scenarios="flights/pursuit.yaml")
    code, printed = runner.run("Check")
    assert code == BAD_INPUT
    (error,) = [line for line in printed.splitlines() if line.startswith("::error ")]
    line = 1 + path.read_text().splitlines().index("  rms: {max: 1.5}")
    assert error.startswith("::error file=flights/pursuit.yaml,title=testbed check%3A bad input,")
    assert f"line={line},col=3::" in error and "did you mean 'rms_m'?" in error
    summary = runner.read("step_summary")
    assert summary.startswith("## testbed check: nothing flown\n")
    # a second check of the job has nothing of the first one, also if it writes nothing
    runner.inputs["inputs.options"] = "--no-such-option"
    assert runner.run("Check")[0] == BAD_INPUT
    first, second = runner.folders()
    assert runner.read("step_summary") == summary
    assert (first / "summary.md").is_file() and not list(second.iterdir())


def test_action_installs_itself_or_a_requirement():
    """The script that installs names no distribution: the default is the action's own code."""
    (step,) = [each for each in ACTION["runs"]["steps"] if each.get("name") == "Install"]
    assert ACTION["inputs"]["install"]["default"] == ""
    assert '"${INSTALL:-$ACTION[report]}"' in step["run"]
    for each in ACTION["runs"]["steps"]:
        assert re.search(r"@[0-9a-f]{40}$", each["uses"]) if "uses" in each else each["shell"]


def test_workflow_in_the_docs_uses_the_action():
    """It can be copied: inputs of the action, and versions of the testbed's own workflows."""
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.S)
    (text,) = [each for each in blocks if "runs-on:" in each]
    steps = yaml.safe_load(text)["jobs"]["check"]["steps"]
    assert steps[-1]["uses"] == "OWNER/REPOSITORY@TAG"
    assert set(steps[-1]["with"]) <= set(ACTION["inputs"])
    required = {name for name, each in ACTION["inputs"].items() if each.get("required")}
    assert required <= set(steps[-1]["with"])
    own = (ROOT / ".github/workflows/check.yml").read_text(encoding="utf-8")
    ours = [each["uses"] for each in ACTION["runs"]["steps"] if "uses" in each]
    for uses in [steps[0]["uses"], *ours]:
        assert uses in own or uses.startswith("actions/cache@"), uses
    for name in ACTION["inputs"]:
        assert f"| `{name}` |" in page
