"""Modules that these tests share with those of the product, and the scripts of this folder."""

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tests" / each) for each in ("shared", "whole/bounds")]


@pytest.fixture
def script(monkeypatch):
    """Import a script of this folder by name."""
    for folder in ("benchmarks", "paper"):
        monkeypatch.syspath_prepend(str(ROOT / folder))
    return importlib.import_module
