"""Copies of aircraft with other numbers."""

import re
import shutil
from pathlib import Path

from jsbsim import get_default_root_dir as jsbsim_root

TWIN = (r"(<engine .*?</engine>)", r"\1\1")  # a change to two engines


def of_jsbsim(name, tmp_path):
    """Copy an aircraft of the installed JSBSim, with the engines and systems that it names."""
    data, folder = Path(jsbsim_root()), tmp_path / name
    shutil.copytree(data / "aircraft" / name, folder, dirs_exist_ok=True)
    text = "".join(each.read_text(errors="replace") for each in folder.rglob("*.xml"))
    for source, target in (("engine", "Engines"), ("systems", "Systems")):
        (folder / target).mkdir(exist_ok=True)
        for file in (data / source).glob("*.xml"):
            if file.stem in text and not (folder / target / file.name).exists():
                shutil.copy(file, folder / target)
                text += file.read_text(errors="replace")
    return folder


def changed(folder, tmp_path, *changes, file=None):
    """Copy an aircraft, with parts of a file of it replaced, by regular expressions.

    Args:
        folder: of the aircraft.
        tmp_path: into which it is copied.
        changes: patterns and what stands in their places.
        file: in the folder; default the aircraft's own.
    """
    copy = tmp_path / folder.name
    shutil.copytree(folder, copy)
    path = copy / (file or f"{folder.name}.xml")
    text = path.read_text(encoding="utf-8")
    for pattern, new in changes:
        text, count = re.subn(pattern, new, text, flags=re.DOTALL)
        assert count
    path.write_text(text, encoding="utf-8")
    return copy
