"""The wheel and the sdist: built from what is committed, and held to what must be in them."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from email.message import Message
from email.parser import BytesParser
from pathlib import Path, PurePosixPath

from locked import ROOT
from packaging.metadata import Metadata

DATA = ("aircraft", "scenarios")
# What the packages have besides files of the repository.
MADE_WHEEL = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
MADE_SDIST = ("PKG-INFO",)
ALWAYS_SDIST = (".gitignore", "LICENSE", "README.md", "pyproject.toml")


class UnfitError(Exception):
    """A release that must not be made, and why."""


def git(*words: str) -> str:
    """What git says."""
    return subprocess.run(
        ("git", *words), cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout


def committed() -> list[str]:
    """The paths of all committed files."""
    return git("ls-tree", "-r", "--name-only", "-z", "HEAD").rstrip("\0").split("\0")


def build(folder: Path, *, epoch_s: int, odd: bool = False) -> list[Path]:
    """Build wheel and sdist from what is committed, the wheel from the sdist.

    Args:
        folder: where; the packages are put into its `dist`.
        epoch_s: the time that files in the packages have.
        odd: in surroundings that no machine has, to see that nothing of them gets in.
    """
    source = folder / ("elsewhere/and further" if odd else "source")
    source.mkdir(parents=True)
    archive = folder / "source.tar"
    git("archive", "--format=tar", f"--output={archive}", "HEAD")
    strange = {"TZ": "Pacific/Chatham", "LC_ALL": "C", "PYTHONHASHSEED": "7"} if odd else {}
    with tarfile.open(archive) as tar:
        tar.extractall(source, filter="data")
    if odd:
        for path in source.rglob("*"):
            path.chmod(path.stat().st_mode & 0o700)  # who may run it belongs to the file
            os.utime(path, (1e9, 1e9))
    command = (sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder / "dist"))
    done = subprocess.run(
        command,
        cwd=source,
        env={**os.environ, **strange, "SOURCE_DATE_EPOCH": str(epoch_s)},
        umask=0o077 if odd else 0o022,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise UnfitError(f"cannot be built:\n{done.stdout}{done.stderr}")
    return sorted((folder / "dist").iterdir())


def build_twice(folder: Path, *, epoch_s: int) -> list[Path]:
    """Build them in two ways at once and return them, if both came out the same.

    Args:
        folder: where.
        epoch_s: the time that files in the packages have.
    """
    with ThreadPoolExecutor() as pool:
        usual = pool.submit(build, folder / "once", epoch_s=epoch_s)
        odd = pool.submit(build, folder / "again", epoch_s=epoch_s, odd=True)
        once, again = usual.result(), odd.result()
    if [(path.name, sha256(path)) for path in once] != [(p.name, sha256(p)) for p in again]:
        raise UnfitError("two builds of the same commit differ")
    return once


def sha256(path: Path) -> str:
    """The SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def expected_in_wheel(files: list[str], version: str) -> set[str]:
    """What a wheel holds, and nothing else: no test, no log, nothing that lay about."""
    package = {each for each in files if each.startswith("testbed/")}
    data = {f"testbed/_data/{each}" for each in files if each.split("/")[0] in DATA}
    return package | data | {f"testbed-{version}.dist-info/{each}" for each in MADE_WHEEL}


def expected_in_sdist(files: list[str], version: str) -> set[str]:
    """What an sdist holds, and nothing else: what pyproject.toml lists, and what builds it."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        told = tomllib.load(file)["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    listed = tuple(each.removeprefix("/") for each in told)
    inside = {
        each
        for each in files
        if each in ALWAYS_SDIST
        or any(each == part or each.startswith(f"{part}/") for part in listed)
    }
    return {f"testbed-{version}/{each}" for each in inside | set(MADE_SDIST)}


def check_contents(there: set[str], expected: set[str], what: str) -> None:
    """Raise UnfitError unless both are the same files.

    Args:
        there: the files in a package.
        expected: those that belong there.
        what: the package's name.
    """
    wrong = [f"lacks {each}" for each in sorted(expected - there)]
    wrong += [f"has {each}" for each in sorted(there - expected)]
    if wrong:
        raise UnfitError(f"{what}: " + ", ".join(wrong))


def check_wheel(path: Path, files: list[str], version: str) -> None:
    """Hold a wheel to its name, its files, their sums and its metadata.

    Args:
        path: the wheel.
        files: what is committed.
        version: of the release.
    """
    told = f"testbed-{version}.dist-info"
    if path.name != f"testbed-{version}-py3-none-any.whl":
        raise UnfitError(f"{path.name}: is not the wheel of testbed {version} for every system")
    with zipfile.ZipFile(path) as archive:
        if bad := archive.testzip():
            raise UnfitError(f"{path.name}: {bad} is broken")
        check_contents(set(archive.namelist()), expected_in_wheel(files, version), path.name)
        for name in ("testbed/py.typed", "testbed/_data/scenarios/simulation-3.yaml"):
            archive.getinfo(name)
        raw = archive.read(f"{told}/METADATA")
    check_metadata(raw, version)


def check_sdist(path: Path, files: list[str], version: str) -> None:
    """Hold an sdist to its name, its files and its metadata.

    Args:
        path: the sdist.
        files: what is committed.
        version: of the release.
    """
    if path.name != f"testbed-{version}.tar.gz":
        raise UnfitError(f"{path.name}: is not the sdist of testbed {version}")
    with tarfile.open(path) as archive:
        there = {each.name for each in archive if each.isfile()}
        check_contents(there, expected_in_sdist(files, version), path.name)
        raw = archive.extractfile(f"testbed-{version}/PKG-INFO")
        assert raw is not None
        check_metadata(raw.read(), version)


def check_metadata(raw: bytes, version: str) -> None:
    """Hold what a package says of itself to the standard, and to what an index shows of it.

    Args:
        raw: its metadata.
        version: of the release.
    """
    told = Metadata.from_email(raw, validate=True)
    if str(told.version) != version or told.license_expression != "MIT":
        raise UnfitError(f"metadata say {told.version}, {told.license_expression}")
    message: Message = BytesParser().parsebytes(raw)
    if not str(message["Description-Content-Type"]).startswith("text/markdown"):
        raise UnfitError("metadata have no description in Markdown")


def check_version(version: str, tag: str | None) -> None:
    """Hold the version to the tag, the citation and the changelog.

    Args:
        version: of the packages.
        tag: of the release; None: it is only tried.
    """
    cited = re.search(
        r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M
    )
    if not cited or cited[1] != version:
        raise UnfitError(f"CITATION.cff does not say version {version}")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## {re.escape(version)} - (\S+)$", changes, re.M)
    if not heading:
        raise UnfitError(f"CHANGELOG.md has no part '## {version} - DATE'")
    if tag is None:
        return
    if tag != f"v{version}":
        raise UnfitError(f"the tag is {tag}, the packages are of version {version}")
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", heading[1]):
        raise UnfitError(f"CHANGELOG.md calls {version} {heading[1]}: write the day of the release")


def version_of(wheel: Path) -> str:
    """The version in a wheel's name."""
    return PurePosixPath(wheel.name).name.split("-")[1]
