"""Build the documentation site: python website/build.py [REPOSITORY] [--into FOLDER].

Writes all pages as Markdown to FOLDER/docs: those of docs/, the generated reference, the files that
pages link to. Zensical makes FOLDER/site of them, in strict mode. FOLDER is build/ by default.
With REPOSITORY_URL in the environment each page has a link to the sources.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import commands
import linked_files
import python_names
import python_reference
import scenario_keys

ROOT = Path(__file__).parents[1]
CONFIG = "website/zensical.toml"
ASSETS = ("site.css", "iframe-worker.js")  # of this folder, in assets/ of the site
MARK = re.compile(r"^<!-- made: (.+) -->$", re.M)
NAME = re.compile(r"^::: ([\w.]+)$", re.M)
GENERATED: Mapping[str, Callable[[], str]] = {
    "every key of a scenario": scenario_keys.markdown,
    "every command": commands.markdown,
    "the public names of testbed": lambda: python_names.markdown(ROOT / "testbed/__init__.py"),
}


def main() -> int:
    """Build the site; return the exit code: 0 if there is nothing to mend."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("repository", type=Path, nargs="?", default=ROOT)
    parser.add_argument("--into", type=Path)
    options = parser.parse_args()
    root = options.repository.resolve()
    into = (options.into or root / "build").resolve()
    print("Building the site: half a minute", file=sys.stderr)
    gc.set_threshold(300_000, 20, 50)  # the package that is read has as many objects
    try:
        write_sources(root, into)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return build_site(into)


def build_site(into: Path) -> int:
    """Let Zensical make the site; print its warnings and where the site is; return an exit code."""
    shutil.rmtree(into / "site", ignore_errors=True)
    done = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict", "--clean"],
        cwd=into,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        text = re.sub(r"\x1b\[[\d;]*m", "", done.stdout)  # colours
        print(text.partition("Traceback (most recent")[0].rstrip(), file=sys.stderr)
        return 2
    print(into / "site" / "index.html")
    return 0


def write_sources(root: Path, into: Path) -> None:
    """Write what Zensical builds: zensical.toml and docs/.

    Raises:
        ValueError: the navigation lacks a page or has one too many, a link leads to no file, a
            generated part is unknown, or the folder has other files.
    """
    own = {"docs", "site", ".cache", "zensical.toml"}
    if into.exists() and (others := {each.name for each in into.iterdir()} - own):
        raise ValueError(
            f"{into}: has {min(others)}, which is not of a site (write another folder)"
        )
    config = (root / CONFIG).read_text(encoding="utf-8")
    pages = sorted(path.relative_to(root).as_posix() for path in (root / "docs").rglob("*.md"))
    linked = linked_files.find_linked(root, pages)
    check_navigation(
        set(listed(tomllib.loads(config)["project"]["nav"])),
        {linked_files.address(page) for page in pages},
        {linked_files.address(each.path) for each in linked},
    )

    docs = into / "docs"
    shutil.rmtree(docs, ignore_errors=True)
    shutil.copytree(root / "docs", docs, ignore=shutil.ignore_patterns("*.md"))
    for page in pages:
        text = with_generated((root / page).read_text(encoding="utf-8"), page)
        write(docs, page, text)
    for each in linked:
        write(docs, each.path, each.content)
    (docs / "assets").mkdir()
    for name in ASSETS:
        shutil.copy(Path(__file__).with_name(name), docs / "assets")
    (into / "zensical.toml").write_text(with_repository(config), encoding="utf-8")


def write(docs: Path, path: str, content: str | bytes) -> None:
    """Write a page, or a picture, to its place on the site, with links that fit there.

    Args:
        docs: the folder of sources.
        path: in the repository.
        content: of the page or picture.
    """
    place = docs / linked_files.address(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, bytes):
        place.write_bytes(content)
    else:
        place.write_text(linked_files.adapt_links(content, path), encoding="utf-8")


def listed(nav: Any) -> Iterator[str]:  # noqa: ANN401 - nested lists and tables
    """Yield the pages of a navigation."""
    if isinstance(nav, str):
        yield nav
    else:
        for each in nav.values() if isinstance(nav, dict) else nav:
            yield from listed(each)


def check_navigation(named: set[str], pages: set[str], linked: set[str]) -> None:
    """Check that every page of docs/ is in the navigation, and nothing that is no page.

    Raises:
        ValueError: with a line for each fault.
    """
    faults = [f"{CONFIG}: nav lacks {page}" for page in sorted(pages - named)]
    faults += [f"{CONFIG}: nav has {page}: no page" for page in sorted(named - pages - linked)]
    if faults:
        raise ValueError("\n".join(faults))


def with_generated(markdown: str, page: str) -> str:
    """Return a page with its generated parts.

    Raises:
        ValueError: a part is unknown.
    """

    def generated(mark: re.Match[str]) -> str:
        if mark[1] not in GENERATED:
            known = ", ".join(GENERATED)
            raise ValueError(f"{page}: no generator for {mark[1]!r} (write one of {known})")
        return GENERATED[mark[1]]()

    def documented(name: re.Match[str]) -> str:
        try:
            return python_reference.markdown(name[1])
        except KeyError:
            raise ValueError(f"{page}: there is no {name[1]} in the package") from None

    return NAME.sub(documented, MARK.sub(generated, markdown))


def with_repository(config: str) -> str:
    """Return the configuration with the address of the repository, where it is known."""
    url = os.environ.get("REPOSITORY_URL")
    line = f"repo_url = {json.dumps(url)}" if url else ""  # a JSON string is one of TOML
    return config.replace("[project]\n", f"[project]\n{line}\n", 1)


if __name__ == "__main__":
    sys.exit(main())
