"""Validate bills of materials against the schema of CycloneDX 1.6.

usage: python release/valid.py FILE...

Runs in the environment of release/requirements.lock, which has the schema.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

if __name__ == "__main__":
    validator = JsonStrictValidator(SchemaVersion.V1_6)
    for name in sys.argv[1:]:
        if wrong := validator.validate_str(Path(name).read_text(encoding="utf-8")):
            sys.exit(f"{name}: {wrong}")
        print(f"{Path(name).name}: valid CycloneDX 1.6")
