"""Make the files of a release in dist/ and check them; nothing is published.

usage: python release/make_release.py [--tag vX.Y.Z] [--no-flight]

Tables and pictures of the docs must not be older than one of their inputs. Wheel and sdist are
built twice from the last commit, in different environments, and must be the same to the bit. The
wheel is installed by pip into two new environments, with the hashes of the lock files: without
extras, where `flight.py` flies it from an empty directory, and with all. dist/ also gets the pins
of both (NAME-VERSION.lock and NAME-VERSION-all.lock), the bill of materials of the second
(.cdx.json), and SHA256SUMS.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path

from bill import Wheel, make_bill
from flight import FlightError, check_extras, check_missing, fly
from locked import (
    EXTRAS,
    ROOT,
    distribution_name,
    here,
    needed,
    requirements_with,
    running_lock,
    running_pins,
)
from packages import (
    UnfitError,
    build_twice,
    check_sdist,
    check_version,
    check_wheel,
    committed,
    git,
    sha256,
    version_of,
)
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

DIST = ROOT / "dist"
HEAD = """# Packages of {distribution} {version}, pinned with hashes; from its requirements.lock.
# In the folder of the wheel:
#    pip install --only-binary :all: --require-hashes -r {name}
"""


def main(arguments: list[str] | None = None) -> int:
    """Make the release files; return 1 if they must not be released."""
    parser = argparse.ArgumentParser(description="Make the files of a release and check them.")
    parser.add_argument(
        "--tag",
        default=os.environ.get("TAG"),
        help="tag of the release, compared with version and changelog; default $TAG",
    )
    parser.add_argument("--no-flight", action="store_true", help="do not install and fly")
    options = parser.parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory() as place:
            make(Path(place), options.tag or None, flight=not options.no_flight)
    except (UnfitError, FlightError, ValueError) as error:
        print(f"no release: {error}", file=sys.stderr)
        return 1
    return 0


def make(place: Path, tag: str | None, *, flight: bool) -> None:
    """Make all files of a release.

    Args:
        place: an empty temporary folder.
        tag: as on the command line.
        flight: install and fly the wheel, and write the bill of materials.
    """
    if changed := git("status", "--porcelain").splitlines():
        if tag:
            raise UnfitError(f"not committed: {', '.join(each[3:] for each in changed)}")
        print("Built from the last commit, without later changes", file=sys.stderr)
    epoch_s = int(git("log", "-1", "--format=%ct"))
    check_numbers()
    sdist, wheel = built(place, epoch_s)
    version = version_of(wheel)
    files = committed()
    check_wheel(wheel, files, version)
    check_sdist(sdist, files, version)
    check_version(version, tag)
    stem = f"{distribution_name()}-{version}"
    plain = write_lock(DIST / f"{stem}.lock", wheel, ())
    full = write_lock(DIST / f"{stem}-all.lock", wheel, EXTRAS)
    if flight:
        work = place / "work"
        work.mkdir()
        program = installed(place / "plain", plain)
        for line in (*fly(program, work), check_missing(program, work)):
            print(line, flush=True)
        program = installed(place / "full", full)
        print(check_extras(program, work), flush=True)
        write_bill(DIST / f"{stem}.cdx.json", wheel, epoch_s, place / "full")
    made = sorted(path for path in DIST.iterdir() if path.name != "SHA256SUMS")
    sums = "".join(f"{sha256(path)}  {path.name}\n" for path in made)
    (DIST / "SHA256SUMS").write_text(sums, encoding="utf-8")
    print(sums, end="")


def check_numbers(script: Path = ROOT / "benchmarks" / "stale.py") -> None:
    """Refuse tables and pictures of the docs that are older than one of their inputs."""
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    if done.returncode:
        raise UnfitError(f"{done.stdout}{done.stderr}".strip())


def write_lock(path: Path, wheel: Path, extras: Iterable[str]) -> Path:
    """Write the pins of the wheel and of its requirements with some extras; return the file."""
    pinned = "\n".join(pin.text for pin in running_lock(extras))
    ours = f"./{wheel.name} \\\n    --hash=sha256:{sha256(wheel)}\n"
    names = {"distribution": distribution_name(), "version": version_of(wheel), "name": path.name}
    path.write_text(f"{HEAD.format(**names)}{pinned}\n{ours}", encoding="utf-8")
    return path


def built(place: Path, epoch_s: int) -> tuple[Path, Path]:
    """Build twice, compare, and copy sdist and wheel to dist/."""
    once = build_twice(place, epoch_s=epoch_s)
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    (sdist,) = (DIST / path.name for path in once if path.name.endswith(".tar.gz"))
    (wheel,) = (DIST / path.name for path in once if path.suffix == ".whl")
    for path in once:
        shutil.copyfile(path, DIST / path.name)
    print(f"{wheel.name}, {sdist.name}: built twice, the same to the bit", flush=True)
    return sdist, wheel


def installed(fresh: Path, lock: Path) -> Path:
    """Install the lock file into a new environment; return the installed program."""
    venv.create(fresh, with_pip=True)
    pip = (str(fresh / "bin" / "python"), "-m", "pip", "--disable-pip-version-check")
    # Wheels only: installing an sdist runs its build code.
    args = ("install", "--quiet", "--only-binary", ":all:", "--require-hashes", "-r", lock.name)
    run((*pip, *args), lock.parent)
    run((*pip, "check"), lock.parent)
    size = sum(each.stat().st_size for each in fresh.rglob("*") if each.is_file())
    print(f"installed from {lock.name}, with hashes: {size / 1e6:.0f} MB", flush=True)
    return fresh / "bin" / distribution_name()


def run(command: tuple[str, ...], cwd: Path) -> None:
    """Run a command without the variables of this checkout's Python."""
    variables = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True)
    if done.returncode:
        raise UnfitError(f"{' '.join(command)}:\n{done.stdout}{done.stderr}")


def write_bill(path: Path, wheel: Path, epoch_s: int, environment: Path) -> None:
    """Write the bill of materials of an environment with the wheel."""
    (packages,) = environment.glob("lib/python3*/site-packages")
    first = [canonicalize_name(Requirement(each).name) for each in requirements_with(*EXTRAS)]
    bill = make_bill(
        Wheel(version_of(wheel), sha256(wheel), epoch_s),
        distributions(path=[str(packages)]),
        running_pins(here()),
        needed(here()),
        first,
    )
    path.write_text(json.dumps(bill, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{path.name}: {len(bill['components'])} packages", flush=True)


if __name__ == "__main__":
    sys.exit(main())
