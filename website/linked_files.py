"""Make pages of the files outside docs/ that the docs link to.

A file outside docs/ is below `repository/` under its own path, Markdown as a page, a picture as it
is, and other text as code. A folder is a list of its names.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

PREFIX = "repository"
DOCS = "docs"
LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)\s]*)?(\))")
PICTURE = ".png"
FENCE = re.compile(r"^ *(`{3,})[^\n]*\n.*?^ *\1 *$", re.M | re.S)
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".xml": "xml", ".cff": "yaml"}


@dataclass(frozen=True, slots=True)
class LinkedFile:
    """A file or folder outside docs/: its path in the repository, and its page or picture."""

    path: str
    content: str | bytes


def find_linked(root: Path, pages: Iterable[str]) -> list[LinkedFile]:
    """Return every file and folder outside docs/ that these pages link to, directly or not.

    Args:
        root: of the repository.
        pages: their paths in the repository.

    Raises:
        ValueError: links lead to files that do not exist.
    """
    wanted: set[str] = set()
    waiting = {page: (root / page).read_text(encoding="utf-8") for page in pages}
    texts: dict[str, str] = {}
    broken: list[str] = []
    while waiting:
        source, text = waiting.popitem()
        for line, target in targets(text, source):
            path = root / target
            if target.startswith("../") or not path.exists():
                broken.append(f"{source}:{line}: there is no {target} in the repository")
            elif target not in wanted and not target.startswith(f"{DOCS}/"):
                wanted.add(target)
                if path.is_file() and path.suffix == ".md":
                    texts[target] = waiting[target] = path.read_text(encoding="utf-8")
    if broken:
        raise ValueError("\n".join(sorted(broken)))
    return [
        LinkedFile(path, texts[path] if path in texts else folder_or_code(root, path, wanted))
        for path in sorted(wanted)
    ]


def targets(text: str, source: str) -> Iterator[tuple[int, str]]:
    """Yield the links of a page to files: line, and path in the repository."""
    blanked = FENCE.sub(lambda fence: "\n" * fence[0].count("\n"), text)
    for link in LINK.finditer(blanked):
        if "://" not in link[2]:
            yield blanked[: link.start()].count("\n") + 1, resolved(link[2], source)


def resolved(link: str, source: str) -> str:
    """Return the path in the repository of a link's target."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def folder_or_code(root: Path, path: str, wanted: set[str]) -> str | bytes:
    """Return the page of a folder, or of a file that is not Markdown, or the picture."""
    place = root / path
    if place.suffix == PICTURE:
        return place.read_bytes()
    if place.is_file():
        language = LANGUAGES.get(place.suffix, "text")
        code = place.read_text(encoding="utf-8")
        return f"---\nsearch: {{exclude: true}}\n---\n# {path}\n\n````{language}\n{code}````\n"
    names = sorted(
        f"{each.name}/" if each.is_dir() else each.name
        for each in place.iterdir()
        if not each.name.startswith(".") and each.name != "__pycache__"
    )
    rows = (
        f"- [`{name}`]({place.name}/{name.rstrip('/')})"
        if posixpath.join(path, name.rstrip("/")) in wanted
        else f"- `{name}`"
        for name in names
    )
    return "\n".join((f"---\nsearch: {{exclude: true}}\n---\n# {path}/\n", *rows, ""))


def address(path: str) -> str:
    """Return the path on the site, as a Markdown file, of a path in the repository."""
    if path.startswith(f"{DOCS}/"):
        return path.removeprefix(f"{DOCS}/")
    seen = "/".join(part.lstrip(".") for part in path.split("/"))  # Zensical skips hidden files
    return f"{PREFIX}/{seen}" if path.endswith((".md", PICTURE)) else f"{PREFIX}/{seen}.md"


def adapt_links(markdown: str, source: str) -> str:
    """Return a page with links to the repository replaced by their paths on the site.

    Args:
        markdown: the page.
        source: its path in the repository.
    """
    folder = posixpath.dirname(address(source))

    def adapt(link: re.Match[str]) -> str:
        if "://" in link[2]:
            return link[0]
        there = posixpath.relpath(address(resolved(link[2], source)), folder or ".")
        return f"{link[1]}{there}{link[3] or ''}{link[4]}"

    parts, end = [], 0
    for fence in FENCE.finditer(markdown):
        parts += [LINK.sub(adapt, markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join((*parts, LINK.sub(adapt, markdown[end:])))
