"""Container, devcontainer and workflow of other systems fit the project; no engine is needed."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
SYSTEMS = yaml.safe_load((ROOT / ".github/workflows/systems.yml").read_text(encoding="utf-8"))
PYTHONS = {
    each.rpartition(" ")[2]
    for each in PROJECT["classifiers"]
    if each.startswith("Programming Language :: Python :: 3.")
}


def instructions():
    lines = DOCKERFILE.replace("\\\n", " ").splitlines()
    return [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]


def test_container_installs_the_lock_file_of_a_release():
    """Supported Python, wheels with hashes, and the command as a user without rights."""
    found = dict(instructions())
    assert re.fullmatch(r"python:(3\.\d+)-slim-\w+", found["FROM"])[1] in PYTHONS
    assert "--require-hashes" in found["RUN"] and "--only-binary :all:" in found["RUN"]
    assert f"{PROJECT['name']}-*[0-9]${{EXTRAS}}.lock" in found["RUN"]
    assert json.loads(found["ENTRYPOINT"])[0] in PROJECT["scripts"]
    names = [name for name, _ in instructions()]
    assert found["USER"] != "root" and names.index("USER") < names.index("ENTRYPOINT")
    assert not {"COPY", "ADD"} & set(names)
    assert (ROOT / ".dockerignore").read_text().split() == ["*", "!dist"]


def test_container_finds_one_lock_file(tmp_path):
    for name in ("formation-testbed-0.1.0.lock", "formation-testbed-0.1.0-all.lock"):
        (tmp_path / name).touch()
    pattern = re.search(r'"\$\((ls [^)]+)\)"', DOCKERFILE)[1]
    for extras in ("", "-all"):
        shell = ["sh", "-c", f"EXTRAS={extras}; {pattern}"]
        done = subprocess.run(shell, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert done.stdout.split() == [f"formation-testbed-0.1.0{extras}.lock"]


def test_devcontainer_uses_the_checkout():
    path = ROOT / ".devcontainer" / "devcontainer.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    assert re.search(r":\d+-(3\.\d+)-", document["image"])[1] in PYTHONS
    assert document["postCreateCommand"] == "make setup"
    assert document["remoteUser"] != "root"
    assert "/.venv/bin" in document["remoteEnv"]["PATH"]


def test_workflow_flies_on_each_system_and_python():
    matrix = SYSTEMS["jobs"]["fly"]["strategy"]["matrix"]
    assert set(matrix["python"]) == PYTHONS
    assert {each.partition("-")[0] for each in matrix["system"]} == {"ubuntu", "macos"}
    runs = [step["run"] for job in SYSTEMS["jobs"].values() for step in job["steps"][2:]]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = [run.split()[1] for run in runs if run.startswith("make ")]
    assert targets == ["fly", "tests", "release"]
    assert all(re.search(rf"^{each}:", makefile, re.M) for each in targets)
    assert [run.split()[1] for run in runs if run.startswith("docker ")] == ["build", "run"]


def test_command_on_windows_is_one_error_line():
    """As seen from Linux: the platform's name decides, before any library is imported."""
    code = "import sys; sys.platform = 'win32'; import testbed.cli.main"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2 and done.stdout == ""
    assert re.fullmatch(r"error: testbed needs Linux or macOS; on Windows .*\n", done.stderr)
