"""What MkDocs does beyond its plugins: parts of the reference are made while the site is built."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import commands
import pages_beyond
import python_names
import scenario_keys
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
STYLE = "assets/site.css"
MARK = re.compile(r"^<!-- made: (.+) -->$", re.M)
MADE: Mapping[str, Callable[[], str]] = {
    "every key of a page": scenario_keys.markdown,
    "every command": commands.markdown,
    "the public names of testbed": lambda: python_names.markdown(ROOT / "testbed/__init__.py"),
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the style, and a page for every file outside docs/ that a page links to."""
    style = (Path(__file__).parent / "site.css").read_text(encoding="utf-8")
    files.append(File.generated(config, STYLE, content=style))
    pages = [file.src_uri for file in files.documentation_pages()]
    for beyond in pages_beyond.found(ROOT, Path(config.docs_dir), pages):
        files.append(beyond.file(config))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put what is made where a page asks for it, and lead links to where the files are here."""

    def made(mark: re.Match[str]) -> str:
        if mark[1] not in MADE:
            raise PluginError(
                f"{page.file.src_uri}: nothing makes {mark[1]!r} (write one of {', '.join(MADE)})"
            )
        return MADE[mark[1]]()

    return MARK.sub(made, pages_beyond.led(markdown, page.file.src_uri))
