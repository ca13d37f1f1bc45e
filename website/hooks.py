"""Hooks of MkDocs that write parts of the reference while the site is built."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import commands
import linked_files
import python_names
import scenario_keys
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
STYLE = "assets/site.css"
MARK = re.compile(r"^<!-- made: (.+) -->$", re.M)
GENERATED: Mapping[str, Callable[[], str]] = {
    "every key of a scenario": scenario_keys.markdown,
    "every command": commands.markdown,
    "the public names of testbed": lambda: python_names.markdown(ROOT / "testbed/__init__.py"),
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the style, and a page for every file outside docs/ that a page links to."""
    style = (Path(__file__).parent / "site.css").read_text(encoding="utf-8")
    files.append(File.generated(config, STYLE, content=style))
    pages = [file.src_uri for file in files.documentation_pages()]
    for linked in linked_files.find_linked(ROOT, Path(config.docs_dir), pages):
        files.append(linked.file(config))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace the marks of generated parts, and adapt links to the paths of the site."""

    def generated(mark: re.Match[str]) -> str:
        if mark[1] not in GENERATED:
            raise PluginError(
                f"{page.file.src_uri}: no generator for {mark[1]!r} "
                f"(write one of {', '.join(GENERATED)})"
            )
        return GENERATED[mark[1]]()

    return MARK.sub(generated, linked_files.adapt_links(markdown, page.file.src_uri))
