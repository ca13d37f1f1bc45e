"""Build wheel and sdist from the last commit, and check their contents."""

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

from locked import ROOT, distribution_name
from packaging.metadata import Metadata

DATA = ("aircraft", "scenarios")
# Files in the packages that are not in the repository.
MADE_WHEEL = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
MADE_SDIST = ("PKG-INFO",)
FILES = distribution_name().replace("-", "_")  # how the names of the packages begin
ALWAYS_SDIST = (".gitignore", "LICENSE", "README.md", "pyproject.toml")


class UnfitError(Exception):
    """Reason why a release must not be made."""


def git(*words: str) -> str:
    """Return the output of a git command."""
    return subprocess.run(
        ("git", *words), cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout


def committed() -> list[str]:
    """Return the paths of all committed files."""
    return git("ls-tree", "-r", "--name-only", "-z", "HEAD").rstrip("\0").split("\0")


def build(folder: Path, *, epoch_s: int, odd: bool = False) -> list[Path]:
    """Build the sdist from the last commit, and the wheel from the sdist.

    Args:
        folder: work folder; the packages are written into its `dist`.
        epoch_s: time stamp of the files in the packages.
        odd: use an unusual environment, which must not influence the packages.
    """
    source = folder / ("elsewhere/and further" if odd else "source")
    source.mkdir(parents=True)
    archive = folder / "source.tar"
    git("archive", "--format=tar", f"--output={archive}", "HEAD")
    variables = {"TZ": "Pacific/Chatham", "LC_ALL": "C", "PYTHONHASHSEED": "7"} if odd else {}
    with tarfile.open(archive) as tar:
        tar.extractall(source, filter="data")
    if odd:
        for path in source.rglob("*"):
            path.chmod(path.stat().st_mode & 0o700)  # keep the execute bit
            os.utime(path, (1e9, 1e9))
    command = (sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder / "dist"))
    done = subprocess.run(
        command,
        cwd=source,
        env={**os.environ, **variables, "SOURCE_DATE_EPOCH": str(epoch_s)},
        umask=0o077 if odd else 0o022,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise UnfitError(f"cannot be built:\n{done.stdout}{done.stderr}")
    return sorted((folder / "dist").iterdir())


def build_twice(folder: Path, *, epoch_s: int) -> list[Path]:
    """Build them in two environments in parallel; return them if both are equal.

    Args:
        folder: work folder.
        epoch_s: time stamp of the files in the packages.
    """
    with ThreadPoolExecutor() as pool:
        usual = pool.submit(build, folder / "once", epoch_s=epoch_s)
        odd = pool.submit(build, folder / "again", epoch_s=epoch_s, odd=True)
        once, again = usual.result(), odd.result()
    if [(path.name, sha256(path)) for path in once] != [(p.name, sha256(p)) for p in again]:
        raise UnfitError("two builds of the same commit differ")
    return once


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def expected_in_wheel(files: list[str], version: str) -> set[str]:
    """Return the files that a wheel must contain."""
    package = {each for each in files if each.startswith("testbed/")}
    data = {f"testbed/_data/{each}" for each in files if each.split("/")[0] in DATA}
    return package | data | {f"{FILES}-{version}.dist-info/{each}" for each in MADE_WHEEL}


def expected_in_sdist(files: list[str], version: str) -> set[str]:
    """Return the files that an sdist must contain: those listed in pyproject.toml."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        include = tomllib.load(file)["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    listed = tuple(each.removeprefix("/") for each in include)
    inside = {
        each
        for each in files
        if each in ALWAYS_SDIST
        or any(each == part or each.startswith(f"{part}/") for part in listed)
    }
    return {f"{FILES}-{version}/{each}" for each in inside | set(MADE_SDIST)}


def check_contents(found: set[str], expected: set[str], name: str) -> None:
    """Raise UnfitError unless both are the same files.

    Args:
        found: the files in a package.
        expected: the files that must be in it.
        name: the package's name.
    """
    wrong = [f"lacks {each}" for each in sorted(expected - found)]
    wrong += [f"has {each}" for each in sorted(found - expected)]
    if wrong:
        raise UnfitError(f"{name}: " + ", ".join(wrong))


def check_wheel(path: Path, files: list[str], version: str) -> None:
    """Check a wheel's name, files, checksums and metadata.

    Args:
        path: the wheel.
        files: the committed files.
        version: of the release.
    """
    info = f"{FILES}-{version}.dist-info"
    if path.name != f"{FILES}-{version}-py3-none-any.whl":
        raise UnfitError(f"{path.name}: is not the wheel of {FILES} {version} for every system")
    with zipfile.ZipFile(path) as archive:
        if bad := archive.testzip():
            raise UnfitError(f"{path.name}: {bad} is broken")
        check_contents(set(archive.namelist()), expected_in_wheel(files, version), path.name)
        for name in ("testbed/py.typed", "testbed/_data/scenarios/simulation-3.yaml"):
            archive.getinfo(name)
        raw = archive.read(f"{info}/METADATA")
    check_metadata(raw, version)


def check_sdist(path: Path, files: list[str], version: str) -> None:
    """Check an sdist's name, files and metadata.

    Args:
        path: the sdist.
        files: the committed files.
        version: of the release.
    """
    if path.name != f"{FILES}-{version}.tar.gz":
        raise UnfitError(f"{path.name}: is not the sdist of {FILES} {version}")
    with tarfile.open(path) as archive:
        found = {each.name for each in archive if each.isfile()}
        check_contents(found, expected_in_sdist(files, version), path.name)
        raw = archive.extractfile(f"{FILES}-{version}/PKG-INFO")
        assert raw is not None
        check_metadata(raw.read(), version)


def check_metadata(raw: bytes, version: str) -> None:
    """Check a package's metadata against the standard and the needs of an index.

    Args:
        raw: its metadata.
        version: of the release.
    """
    metadata = Metadata.from_email(raw, validate=True)
    if metadata.name != distribution_name():
        raise UnfitError(f"metadata name {metadata.name}, not {distribution_name()}")
    if str(metadata.version) != version or metadata.license_expression != "MIT":
        raise UnfitError(f"metadata: version {metadata.version}, {metadata.license_expression}")
    message: Message = BytesParser().parsebytes(raw)
    if not str(message["Description-Content-Type"]).startswith("text/markdown"):
        raise UnfitError("metadata have no description in Markdown")


def check_version(version: str, tag: str | None) -> None:
    """Compare the version with the tag, the citation and the changelog.

    Args:
        version: of the packages.
        tag: of the release; None without a release.
    """
    cited = re.search(
        r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M
    )
    if not cited or cited[1] != version:
        raise UnfitError(f"CITATION.cff: the version is not {version}")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## {re.escape(version)} - (\S+)$", changes, re.M)
    if not heading:
        raise UnfitError(f"CHANGELOG.md: no section '## {version} - DATE'")
    if tag is None:
        return
    if tag != f"v{version}":
        raise UnfitError(f"the tag is {tag}, the version of the packages {version}")
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", heading[1]):
        raise UnfitError(
            f"CHANGELOG.md: {version} is dated {heading[1]}: write the day of the release"
        )


def version_of(wheel: Path) -> str:
    """Return the version in a wheel's name."""
    return PurePosixPath(wheel.name).name.split("-")[1]
