"""Hold bills of materials to the schema of CycloneDX 1.6.

usage: python release/valid.py FILE...

Run by the environment of release/requirements.lock, which has the schema; nothing imports this.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

if __name__ == "__main__":
    judge = JsonStrictValidator(SchemaVersion.V1_6)
    for name in sys.argv[1:]:
        if wrong := judge.validate_str(Path(name).read_text(encoding="utf-8")):
            sys.exit(f"{name}: {wrong}")
        print(f"{Path(name).name}: valid CycloneDX 1.6")
