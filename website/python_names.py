"""List the public Python names for the reference from the source, without importing it."""

from __future__ import annotations

import ast
from pathlib import Path


def markdown(module: Path) -> str:
    """Return a line `::: NAME` for each of the names in a package's `__all__`."""
    tree = ast.parse(module.read_text(encoding="utf-8"))
    (names,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and [ast.unparse(t) for t in node.targets] == ["__all__"]
    )
    public = sorted((name for name in names if not name.startswith("__")), key=str.lower)
    package = module.parent.name
    return "\n\n".join(f"::: {package}.{name}" for name in public)
