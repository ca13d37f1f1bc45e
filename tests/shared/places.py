"""Where the tests find the repository, their data and what they share."""

from pathlib import Path

SHARED = Path(__file__).parent
TESTS = SHARED.parent
ROOT = TESTS.parent
