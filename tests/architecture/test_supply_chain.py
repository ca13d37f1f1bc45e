"""Packages are pinned, releases are checked, workflows have minimal permissions."""

import hashlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import venv
import zipfile
from functools import cache
from importlib.metadata import distribution, distributions, version
from pathlib import Path

import pytest
import yaml
from cases import in_full
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import testbed

ROOT = Path(__file__).parents[2]
LOCKS = (
    "requirements.lock",
    "release/requirements.lock",
    "release/installer.lock",
    "tests/clients/requirements.lock",
    "examples/training.lock",
)
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
# Steps that install nothing themselves; the Makefile is checked below.
HARMLESS = re.compile(
    r"make |docker |python -m testbed |\.ci/run$|\.venv/bin/testbed |"
    r"\(cd dist && sha256sum |gh release create"
)
WHEEL = "a" * 64
BIN = Path(sys.executable).parent


@pytest.fixture
def release(monkeypatch):
    """Import a module of release/."""
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    return importlib.import_module


def jobs():
    for path in WORKFLOWS:
        for name, job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].items():
            yield path.name, name, job


@pytest.mark.parametrize("name", LOCKS)
def test_every_pin_is_one_version_with_hashes(release, name):
    text = (ROOT / name).read_text(encoding="utf-8")
    found = release("locked").pins(text)
    least = 1 if name == "release/installer.lock" else 6
    assert len(found) == len(re.findall(r"^[A-Za-z0-9]", text, re.M)) >= least
    assert "://" not in text and "--index-url" not in text  # independent of the index


@pytest.mark.parametrize("text", ("numpy>=2 --hash=sha256:" + WHEEL, "numpy==2.3.0"))
def test_pin_without_version_or_hash_raises(release, text):
    with pytest.raises(ValueError, match="one version with its hashes"):
        release("locked").pins(text)


def test_pip_installs_require_hashes():
    for name in ("Makefile", ".ci/run", "Dockerfile", "release/make_release.py"):
        text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"^.*\bpip\b.*\binstall\b.*$|^.*\"install\".*$", text, re.M):
            ours = "--no-deps --no-build-isolation --editable ." in line
            assert "--require-hashes" in line or ours, (name, line)
    for file, name, job in jobs():
        for step in job["steps"]:
            first = step.get("run", "make ").splitlines()[0]
            assert HARMLESS.match(first), (file, name, first)
            assert not re.search(r"\b(pip|uv|npm|curl|wget)\b", step.get("run", "")), (file, name)


@pytest.mark.parametrize("uv", ("false", "uv"))
def test_pip_installs_what_uv_cannot(uv, tmp_path):
    """The program `false` fails, as uv does behind an index that only pip knows."""
    uv = shutil.which(uv, path=f"{BIN}:{os.environ['PATH']}")
    if uv is None:
        pytest.skip("make setup installs uv")
    wheel = tmp_path / "some_package-1.0-py3-none-any.whl"
    about = "some_package-1.0.dist-info"
    with zipfile.ZipFile(wheel, "w") as made:
        made.writestr("some_package.py", "")
        made.writestr(
            f"{about}/METADATA", "Metadata-Version: 2.1\nName: some-package\nVersion: 1.0\n"
        )
        made.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        made.writestr(f"{about}/RECORD", "")
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    lock, wrong = tmp_path / "some.lock", tmp_path / "wrong.lock"
    lock.write_text(f"some-package==1.0 --hash=sha256:{digest}\n")
    wrong.write_text(f"some-package==1.0 --hash=sha256:{WHEEL}\n")
    into = tmp_path / "environment"
    venv.create(into, symlinks=True)
    (tmp_path / "Makefile").write_text(
        f"include {ROOT}/Makefile\ntry:\n\t$(call install,{into},$(LOCK))\n"
    )
    local = {
        **{"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(tmp_path), "PIP_CONFIG_FILE": os.devnull},
        **{"UV_NO_INDEX": "1", "UV_FIND_LINKS": str(tmp_path)},
    }

    def install(lock):
        return subprocess.run(
            ["make", "-C", tmp_path, "try", f"LOCK={lock}", f"UV={uv}", f"BIN={BIN}", "-I", ROOT],
            env=os.environ | local,
            capture_output=True,
            text=True,
        )

    if Path(uv).name == "uv":  # which refuses it, and then pip
        assert install(wrong).returncode
        assert not list(into.glob("lib/*/site-packages/some_package*"))
    done = install(lock)
    assert not done.returncode, done.stderr
    assert list(into.glob("lib/*/site-packages/some_package.py")) and not (into / ".cache").exists()
    assert ("pip does" in done.stderr) == (Path(uv).name == "false")


def test_docs_do_not_install_testbed_from_pypi():
    """The project `testbed` on PyPI is another one."""
    pages = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "paper").rglob("*.md")]
    files = [ROOT / "README.md", *pages, *(ROOT / "testbed").rglob("*.py")]
    wrong = [
        path.relative_to(ROOT).as_posix()
        for path in files
        if re.search(r"pip install ['\"]?testbed(?![\w.-])", path.read_text(encoding="utf-8"))
    ]
    assert not wrong


def test_actions_are_pinned_by_commit():
    for path in WORKFLOWS:
        lines = re.findall(r"uses: (.*)$", path.read_text(encoding="utf-8"), re.M)
        assert lines
        for line in lines:
            assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line), line
    pins = {}
    for path in WORKFLOWS:  # one commit for one version everywhere
        for action, commit in re.findall(r"uses: (\S+)@(\S+)", path.read_text(encoding="utf-8")):
            assert pins.setdefault(action, commit) == commit, action


def test_jobs_that_write_run_no_repository_code():
    writing = set()
    for path in WORKFLOWS:
        workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert workflow["permissions"] in ({}, {"contents": "read"}), path.name
        assert "pull_request_target" not in workflow[True]  # YAML reads `on` as true
    for file, name, job in jobs():
        uses = [step["uses"].split("@")[0] for step in job["steps"] if "uses" in step]
        if "write" in job.get("permissions", {}).values():
            writing.add((file, name))
            assert "actions/checkout" not in uses, (file, name)
        for step in job["steps"]:
            assert "${{" not in step.get("run", ""), (file, name)  # no text becomes a command
            if step.get("uses", "").startswith("actions/checkout@"):
                assert step["with"]["persist-credentials"] is False, (file, name)
    assert writing == {("release.yml", each) for each in ("attest", "draft", "publish")}


def test_release_jobs_run_in_order():
    workflow = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    assert workflow[True] == {"push": {"tags": ["v*"]}}
    jobs = workflow["jobs"]
    runs = [step["run"] for step in jobs["build"]["steps"] if "run" in step]
    assert runs == [".ci/run", "make audit", "make release"]
    assert [jobs[name]["needs"] for name in ("attest", "draft", "publish")] == [
        "build",
        "attest",
        "draft",
    ]
    assert "--draft" in jobs["draft"]["steps"][-1]["run"]
    assert jobs["publish"]["environment"] == "pypi"
    assert jobs["publish"]["permissions"] == {"id-token": "write"}


def test_audit_runs_weekly_on_every_lock_file():
    workflow = yaml.safe_load((ROOT / ".github/workflows/audit.yml").read_text(encoding="utf-8"))
    assert workflow[True]["schedule"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    (audit,) = re.findall(r"^audit:.*\n((?:\t.*\n)+)", makefile, re.M)
    assert "pip-audit --strict --require-hashes" in audit
    assert all(lock in audit for lock in LOCKS)


def test_newest_releases_are_tried_weekly(release):
    """No pull request waits for it, and the pinned environment stays as it is.

    Cases that `make test` leaves out run weekly, too.
    """
    workflow = yaml.safe_load((ROOT / ".github/workflows/weekly.yml").read_text(encoding="utf-8"))
    assert set(workflow[True]) == {"schedule", "workflow_dispatch"}
    jobs = workflow["jobs"]
    commands = [[each["run"] for each in job["steps"] if "run" in each] for job in jobs.values()]
    assert commands == [["make newest"], [".ci/run"]]
    assert jobs["cases"]["env"]["TESTBED_CASES"] == "all"
    newest = release("newest")
    assert newest.INTO.is_relative_to(ROOT / "build")
    assert all((ROOT / each).is_file() for each in newest.TESTS)


def test_newest_release_runs_the_tests_first(release, monkeypatch, tmp_path):
    newest, commands = release("newest"), []

    def run(command, **options):
        commands.append((command, options))
        if "install" in command:
            info = tmp_path / "jsbsim-9.9.dist-info"
            info.mkdir(exist_ok=True)
            (info / "METADATA").write_text(f"Name: jsbsim\nVersion: {found}\n")
        return subprocess.CompletedProcess(command, 0 if "install" in command else 1)

    monkeypatch.setattr(newest, "INTO", tmp_path)
    monkeypatch.setattr(newest.shutil, "rmtree", lambda *_, **__: None)
    monkeypatch.setattr(newest.subprocess, "run", run)
    found = "9.9"
    assert newest.main([]) == 1
    (pip, _), (_, options) = commands
    assert pip[-2:] == ["jsbsim", "rerun-sdk"] and str(tmp_path) in pip
    assert options["env"]["PYTHONPATH"].startswith(str(tmp_path))
    found = version("jsbsim")
    assert newest.main(["jsbsim"]) == 0 and len(commands) == 3


def test_release_pins_are_the_runtime_packages(release):
    locked = release("locked")
    everything = locked.pins((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    running = locked.running_lock()
    assert set(running) < set(everything)
    names = {pin.name for pin in running}
    assert {"jsbsim", "numpy", "pymavlink", "rerun-sdk"} <= names
    assert not names & {"pytest", "ruff", "zensical", "hatchling", "distributed"}
    assert locked.pins("\n".join(pin.text for pin in running)) == running
    plain = {pin.name for pin in locked.running_lock(())}
    assert {"jsbsim", "numpy", "scipy", "joblib", "foxglove-sdk"} <= plain < names
    assert not plain & {"rerun-sdk", "pyarrow", "matplotlib", "pymavlink", "cma", "pandas"}


@cache
def needed():
    """Packages of the lock that run here, and which needs which."""
    locked = importlib.import_module("locked")
    here = locked.here()
    return locked.running_pins(here), locked.needed(here)


def made(release, installed=None):
    bill, (pinned, graph) = release("bill"), needed()
    installed = [distribution(name) for name in pinned] if installed is None else installed
    wheel = bill.Wheel("1.2.3", WHEEL, 1_700_000_000)
    return bill.make_bill(wheel, installed, pinned, graph, ["numpy", "jsbsim"])


@pytest.fixture(scope="module")
def bill():
    """The bill of this environment, once: the metadata of all its packages are read for it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "release"))
        return made(importlib.import_module)


def test_bill_lists_the_locked_packages(bill):
    pinned, _ = needed()
    assert {each["name"] for each in bill["components"]} == set(pinned)
    for each in bill["components"]:
        pin = pinned[each["name"]]
        assert each["version"] == pin.version
        (files,) = each["externalReferences"]
        assert [(file["alg"], file["content"]) for file in files["hashes"]] == [
            ("SHA-256", sum_) for sum_ in pin.hashes
        ]
        assert each["purl"] == each["bom-ref"] == f"pkg:pypi/{pin.name}@{pin.version}"
        assert each["licenses"] and each["type"] == "library"
    page = (ROOT / "docs" / "contributing" / "licences.md").read_text(encoding="utf-8")
    for each in bill["components"]:
        (licence,) = each["licenses"]
        name = licence.get("expression") or next(iter(licence["license"].values()))
        assert f"| [{each['name']}](https://pypi.org/project/{each['name']}/) | {name} |" in page


def test_bill_has_the_required_fields(release, bill):
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", bill["serialNumber"])
    assert bill["metadata"]["timestamp"] == "2023-11-14T22:13:20+00:00"
    ours = bill["metadata"]["component"]
    assert (ours["name"], ours["version"], ours["type"]) == (
        "formation-testbed",
        "1.2.3",
        "application",
    )
    assert ours["hashes"] == [{"alg": "SHA-256", "content": WHEEL}]
    references = {ours["bom-ref"]} | {each["bom-ref"] for each in bill["components"]}
    assert len(references) == 1 + len(bill["components"])
    assert {each["ref"] for each in bill["dependencies"]} == references
    assert all(set(each["dependsOn"]) <= references for each in bill["dependencies"])
    assert json.dumps(made(release)) == json.dumps(bill)


def test_bill_of_another_environment_raises(release):
    with pytest.raises(ValueError, match="differ: .*mypy"):
        made(release, installed=distributions())
    names = needed()[0].keys() - {"numpy"}
    with pytest.raises(ValueError, match="differ: numpy"):
        made(release, installed=[distribution(name) for name in names])


def test_wheel_with_wrong_files_raises(release):
    packages = release("packages")
    files = ["testbed/a.py", "aircraft/x.xml", "scenarios/s.yaml", "tests/t.py", "logs/.gitkeep"]
    expected = packages.expected_in_wheel(files, "1.2.3")
    assert {"testbed/_data/aircraft/x.xml", "testbed/_data/scenarios/s.yaml"} < expected
    assert not [each for each in expected if "tests/" in each]
    packages.check_contents(set(expected), expected, "wheel")
    for there in (expected | {"tests/t.py"}, expected - {"testbed/_data/aircraft/x.xml"}):
        with pytest.raises(packages.UnfitError, match=r"tests/t\.py|aircraft/x\.xml"):
            packages.check_contents(there, expected, "wheel")


def test_tag_that_differs_from_version_raises(release):
    packages = release("packages")
    version = testbed.__version__
    packages.check_version(version, None)
    with pytest.raises(packages.UnfitError, match=r"the tag is v9\.9\.9"):
        packages.check_version(version, "v9.9.9")
    with pytest.raises(packages.UnfitError, match=r"CITATION\.cff"):
        packages.check_version("9.9.9", "v9.9.9")


@pytest.fixture
def checkout(tmp_path):
    """Folder with the committed files."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("no checkout of git")
    source = tmp_path / "source"
    source.mkdir()
    archive = subprocess.run(("git", "archive", "HEAD"), cwd=ROOT, check=True, capture_output=True)
    subprocess.run(("tar", "-x"), cwd=source, check=True, input=archive.stdout)
    return source


def test_packages_would_have_all_their_files(release, checkout):
    """As the backend lists them, which writes them in the next test."""
    packages, version = release("packages"), testbed.__version__
    files = packages.committed()
    made = [f"dist-info/{each}" for each in packages.MADE_WHEEL]
    expected = packages.expected_in_wheel(files, version)
    wheel = {each for each in expected if not each.endswith((*made,))}
    assert len(wheel) == len(expected) - len(made)
    prefix = f"{packages.FILES}-{version}/"
    sdist = {each.removeprefix(prefix) for each in packages.expected_in_sdist(files, version)}
    for kind, files in (
        (WheelBuilder, wheel),
        (SdistBuilder, sdist - {*packages.MADE_SDIST, *packages.ALWAYS_SDIST}),
    ):
        builder = kind(str(checkout))
        found = {each.distribution_path for each in builder.recurse_included_files()}
        packages.check_contents(found, files, kind.__name__)


@in_full
def test_two_builds_are_equal_and_complete(release, tmp_path):
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("no checkout of git")
    packages = release("packages")
    once = packages.build_twice(tmp_path, epoch_s=1_700_000_000)
    sdist, wheel = sorted(once, key=lambda path: path.suffix)
    files, version = packages.committed(), packages.version_of(wheel)
    packages.check_wheel(wheel, files, version)
    packages.check_sdist(sdist, files, version)
    with pytest.raises(packages.UnfitError, match="is not the wheel"):
        packages.check_wheel(wheel, files, "9.9.9")


def test_two_builds_that_differ_raise(release, tmp_path, monkeypatch):
    packages = release("packages")

    def build(folder, *, epoch_s, odd=False):
        folder.mkdir()
        (folder / "testbed.whl").write_text(f"{epoch_s} {odd}")
        return list(folder.iterdir())

    monkeypatch.setattr(packages, "build", build)
    with pytest.raises(packages.UnfitError, match="two builds of the same commit differ"):
        packages.build_twice(tmp_path, epoch_s=1)
