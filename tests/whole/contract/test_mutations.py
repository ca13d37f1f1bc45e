"""Mutated files give a result or one clear error.

TESTBED_MUTATIONS sets the number of mutations of all kinds. A fault is reported with its number;
`python tests/whole/contract/test_mutations.py KIND NUMBER FOLDER` writes the mutated file there.
"""

import json
import os
import random
import selectors
import sys
from collections import Counter
from pathlib import Path

import pytest
from cases import ALL
from forked import Forked
from mutation_kinds import KINDS
from mutation_worker import SEED
from mutations import mutate
from places import ROOT
from waiting import TIMEOUT_S

MUTATIONS = int(os.environ.get("TESTBED_MUTATIONS", "60"))
MAX_LISTED = 20  # faults
# files of a kind that are tried without mutation
UNCHANGED = {
    "logs": 1,
    "results": 2,
    **({} if ALL else dict.fromkeys(("studies", "aircraft", "scenarios"), 1)),
}


class Worker:
    """Process that tries files; it is started again after a crash."""

    def __init__(self, kind, folder):
        self.kind, self.folder, self.count = kind, folder, 0
        self.process = None

    def begin(self):
        self.count += 1
        folder = self.folder / str(self.count)
        folder.mkdir(parents=True)
        (theirs_in, to), (back, theirs_out) = os.pipe(), os.pipe()
        self.to, self.back = os.fdopen(to, "w"), os.fdopen(back)
        with (
            (folder / "errors").open("wb") as errors,
            os.fdopen(theirs_in) as stdin,
            os.fdopen(theirs_out, "w") as stdout,
        ):
            self.process = Forked(
                "mutation_worker:work",
                *(self.kind, folder),
                cwd=ROOT,
                env=dict(os.environ),
                stdin=stdin,
                stdout=stdout,
                stderr=errors,
            )
        self.answers = selectors.DefaultSelector()
        self.answers.register(self.back, selectors.EVENT_READ)

    def end(self):
        if self.process:
            self.answers.close()
            self.process.kill()
            self.process.wait(TIMEOUT_S)
            self.to.close()
            self.back.close()
            self.process = None

    def ask(self, number):
        """Return outcome, text, mutation, file, time in s and peak memory in bytes."""
        if self.process is None:
            self.begin()
        print(number, file=self.to, flush=True)
        if not self.answers.select(TIMEOUT_S):
            self.end()
            return "fault", f"no answer after {TIMEOUT_S:g} s", "", "", TIMEOUT_S, 0
        line = self.back.readline()
        if line:
            return json.loads(line)
        code = self.process.wait(TIMEOUT_S)
        errors = (self.folder / str(self.count) / "errors").read_text(errors="replace")[-2000:]
        output = (self.folder / str(self.count) / "output").read_text(errors="replace")[-2000:]
        self.end()
        return "fault", f"ended the process with {code}: {errors}{output}", "", "", 0.0, 0


@pytest.fixture(scope="module", params=KINDS)
def worker(request, tmp_path_factory):
    """Yield one worker per kind, as its start takes longer than some files."""
    worker = Worker(request.param, tmp_path_factory.mktemp(request.param))
    yield worker
    worker.end()


def test_unchanged_files_are_accepted(worker):
    taken = [worker.ask(-1 - number) for number in range(UNCHANGED.get(worker.kind, 4))]
    assert [each for each in taken if each[0] != "good"] == []


def test_mutated_file_gives_result_or_clear_error(worker):
    kind, seen, faults, longest_s, most = worker.kind, Counter(), [], 0.0, 0
    # a log takes as long as ten other files
    numbers = range(
        3 if kind == "logs" and not ALL else max(1, MUTATIONS * KINDS[kind].share // 100)
    )
    for number in numbers:
        outcome, text, way, file, took_s, memory = worker.ask(number)
        seen[outcome] += 1
        longest_s, most = max(longest_s, took_s), max(most, memory)
        if outcome == "fault":
            faults.append(f"{kind} {number} ({way} of {file}): {text}")
    print(f"{kind} {dict(seen)}, longest {longest_s:.1f} s, at most {most / 1e9:.2f} GB")
    assert not faults, f"{len(faults)} of {seen.total()}:\n" + "\n".join(faults[:MAX_LISTED])
    # some of both, or the mutations test nothing
    assert seen["good"] and seen["refused"]


def write_mutation(kind, number, folder):
    """Write the mutated file of a number, with the files it needs."""
    home = Path(folder).resolve()
    home.mkdir(parents=True)
    files = KINDS[kind].put(home)
    rng = random.Random(f"{SEED}/{kind}/{number}")
    path = rng.choice(files)
    data, way = mutate(path.read_bytes(), path.suffix, rng)
    path.write_bytes(data)
    print(way, path)


if __name__ == "__main__":
    write_mutation(sys.argv[1], int(sys.argv[2]), sys.argv[3])
