"""Which files of tests are in a shard: those of all shards take about as long.

`make test ALL=1 TESTBED_SECONDS=1` writes how long the files take. One that is not in the table is
taken for short, so that an old table makes shards less even, and nothing else.
"""

import json

from places import SHARED

SECONDS = SHARED / "seconds.json"
SHORT_S = 1.0  # files that take less than twice as long are not in the table
CHECKS = 0.05  # share of all tests that lint and types take, which the first shard has


def files_of(part, of, files):
    """Return the files of a shard: each goes, the longest first, to the shard with the least.

    Args:
        part: number of the shard, from 1.
        of: number of shards.
        files: names of all files of tests.
    """
    seconds = json.loads(SECONDS.read_text("utf-8"))
    loads, found = [0.0] * of, set()
    loads[0] = CHECKS * sum(seconds.values())
    for name in sorted(files, key=lambda each: (-seconds.get(each, SHORT_S), each)):
        least = loads.index(min(loads))
        loads[least] += seconds.get(name, SHORT_S)
        if least == part - 1:
            found.add(name)
    return found


def write_seconds(seconds):
    """Write how long files of tests took."""
    long = {name: round(s) for name, s in sorted(seconds.items()) if s >= 2.0 * SHORT_S}
    SECONDS.write_text(json.dumps(long, indent=1) + "\n", encoding="utf-8")
