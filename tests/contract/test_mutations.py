"""Files that are broken, by chance or on purpose, give a result or one clear error.

TESTBED_MUTATIONS sets how many are tried, over all kinds. What goes wrong is told with its number;
`python tests/contract/test_mutations.py KIND NUMBER FOLDER` leaves the file that did it there.
"""

import json
import os
import random
import selectors
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from mutation_kinds import KINDS
from mutation_worker import SEED
from mutations import mutated
from patience import PATIENCE_S

MUTATIONS = int(os.environ.get("TESTBED_MUTATIONS", "240"))
TOLD = 20  # of faults
WHOLE = 4  # files of a kind that are tried as they are


class Worker:
    """A process that tries files, begun anew when one has ended it."""

    def __init__(self, kind, folder):
        self.kind, self.folder, self.count = kind, folder, 0
        self.process = None

    def begin(self):
        self.count += 1
        folder = self.folder / str(self.count)
        folder.mkdir(parents=True)
        command = [sys.executable, Path(__file__).with_name("mutation_worker.py")]
        with (folder / "errors").open("wb") as errors:
            self.process = subprocess.Popen(
                [*command, self.kind, folder],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        self.answers = selectors.DefaultSelector()
        self.answers.register(self.process.stdout, selectors.EVENT_READ)

    def end(self):
        if self.process:
            self.answers.close()
            self.process.kill()
            self.process.wait()
            self.process.stdin.close()
            self.process.stdout.close()
            self.process = None

    def ask(self, number):
        """Outcome, text, way and file of a mutation."""
        if self.process is None:
            self.begin()
        self.process.stdin.write(f"{number}\n")
        self.process.stdin.flush()
        if not self.answers.select(PATIENCE_S):
            self.end()
            return "fault", f"nothing after {PATIENCE_S:g} s", "", ""
        line = self.process.stdout.readline()
        if line:
            return json.loads(line)
        code = self.process.wait()
        errors = (self.folder / str(self.count) / "errors").read_text(errors="replace")[-2000:]
        said = (self.folder / str(self.count) / "said").read_text(errors="replace")[-2000:]
        self.end()
        return "fault", f"ended the process with {code}: {errors}{said}", "", ""


@pytest.fixture(scope="module", params=KINDS)
def worker(request, tmp_path_factory):
    """One of each kind: to begin it takes longer than to try some files."""
    worker = Worker(request.param, tmp_path_factory.mktemp(request.param))
    yield worker
    worker.end()


def test_every_file_is_good_before_it_is_broken(worker):
    taken = [worker.ask(-1 - number) for number in range(WHOLE)]
    assert [each for each in taken if each[0] != "good"] == []


def test_a_broken_file_gives_a_result_or_one_clear_error(worker):
    kind, seen, faults = worker.kind, Counter(), []
    for number in range(max(1, MUTATIONS * KINDS[kind].share // 100)):
        outcome, text, way, file = worker.ask(number)
        seen[outcome] += 1
        if outcome == "fault":
            faults.append(f"{kind} {number} ({way} of {file}): {text}")
    print(kind, dict(seen))
    assert not faults, f"{len(faults)} of {seen.total()}:\n" + "\n".join(faults[:TOLD])
    # mutations that all fail alike, or that all fly, try nothing
    assert seen["good"] and seen["refused"]


def keep(kind, number, folder):
    """Leave the mutated file of a number, among the files it needs."""
    home = Path(folder).resolve()
    home.mkdir(parents=True)
    files = KINDS[kind].put(home)
    dice = random.Random(f"{SEED}/{kind}/{number}")
    path = dice.choice(files)
    data, way = mutated(path.read_bytes(), path.suffix, dice)
    path.write_bytes(data)
    print(way, path)


if __name__ == "__main__":
    keep(sys.argv[1], int(sys.argv[2]), sys.argv[3])
