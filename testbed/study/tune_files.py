"""What a search leaves: every trial, the best gains, and a page that flies them."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from testbed import __version__
from testbed.errors import InputError
from testbed.metrics.document import replacing, write_json
from testbed.record.rundir import leave
from testbed.scenario import dump_middle_loop, find_scenario, gains_of, library, load
from testbed.scenario.yaml_door import write
from testbed.study.tune_cost import said
from testbed.study.tune_page import GAINS
from testbed.study.tune_search import Trial

if TYPE_CHECKING:
    from testbed.study.tune import Tuned, Tuner

TRIALS, GAINS_FILE, PAGE, RESULT, COPY = (
    "trials.csv", "middle_loop.yaml", "tuned.yaml", "result.json", "tune.yaml",
)  # fmt: skip
UNSEEN = "not held to other seeds"


class Keeper:
    """Writes a search down as it goes; what is there is always whole."""

    def __init__(self, tuner: Tuner, out: Path) -> None:
        """Into this folder."""
        self._tuner = tuner
        self.out = out

    def begin(self, first: Trial) -> None:
        """Write the page, and what the scenario had as the first trial."""
        page = self._tuner.tune.page
        leave(self.out, COPY, self._tuner.tune.study.text.encode())  # which makes it ours
        runs = [f"cost of run {run.number}" for run in self._tuner.runs]
        head = ["trial", "generation", "cost", *page.gains, *runs]
        self._put(TRIALS, _line(head) + _line(_cells(first)))

    def add(self, trials: Sequence[Trial], best: Trial) -> None:
        """Add a generation, and write the best gains so far."""
        try:
            with (self.out / TRIALS).open("a", encoding="utf-8", newline="") as file:
                file.writelines(_line(_cells(trial)) for trial in trials)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(f"{self.out / TRIALS}: cannot write: {error.strerror}") from error
        if any(trial is best for trial in trials):
            self._gains(best, UNSEEN)

    def end(self, tuned: Tuned) -> Tuned:
        """Write what the gains are worth."""
        judgement = tuned.judgement
        if judgement is not None:
            self._gains(tuned.best, judgement.verdict)
        write_json(self.out / RESULT, document(tuned, self._tuner))
        return tuned

    def _gains(self, best: Trial, verdict: str) -> None:
        tuner = self._tuner
        head, page = tuner.tune.page.study, tuner.page_of(best.gains)
        objective = tuner.tune.page.objective
        about = (
            f"# Tuned by testbed {__version__} for {objective.metric} of {head.scenario}, study "
            f"{head.name}:\n# {said(objective.robust)} over its flights is {best.cost:.4g} "
            f"({verdict}).\n"
        )
        own: dict[str, Any] = {}
        middle = any(key.startswith(GAINS) for key in tuner.keys)
        if middle:
            profile, airframe = page.controller.profile, page.fleet[0].aircraft
            self._put(
                GAINS_FILE, f"{about}\n" + dump_middle_loop({profile: gains_of(page, airframe)})
            )
            own["controller"] = {"middle_loop": GAINS_FILE, "profile": profile}
            if load(self._path).controller.gains:  # which the file has, too
                own["controller"]["gains"] = None
        for key, value in tuner.changed(best.gains).items():
            if not key.startswith(GAINS):
                node = own
                *parts, last = key.split(".")
                for part in parts:
                    node = node.setdefault(part, {})
                node[last] = value
        flown = {"extends": self._extends(), "scenario": {"name": f"{head.name}-tuned"}, **own}
        self._put(PAGE, f"{about}# testbed run {self.out / PAGE}\n\n{write(flown)}")

    @property
    def _path(self) -> Path:
        """Of the scenario of the first case."""
        return find_scenario(self._tuner.runs[0].scenario)

    def _extends(self) -> str:
        if self._path.parent == library() / "scenarios":
            return self._path.stem
        return os.path.relpath(self._path, self.out)

    def _put(self, name: str, text: str) -> None:
        try:
            with replacing(self.out / name) as file:
                file.write(text)
        except OSError as error:
            raise InputError(f"{self.out / name}: cannot write: {error.strerror}") from error


def document(tuned: Tuned, tuner: Tuner) -> dict[str, Any]:
    """What came of a search, as JSON has it."""
    page, judgement = tuned.tune.page, tuned.judgement
    out: dict[str, Any] = {
        "schema": 1,
        "study": page.study.name,
        "scenario": page.study.scenario,
        "metric": page.objective.metric,
        "robust": said(page.objective.robust),
        "seeds": list(page.study.seeds),
        "held_out": list(page.held_out),
        "bound": tuned.bound,
        "flights": tuned.flights,
        "ended": tuned.ended,
        "gains": {
            key: {"before": before, "after": after, "from": bounds.low, "to": bounds.high}
            for (key, bounds), before, after in zip(
                page.gains.items(), tuner.before, tuned.best.gains, strict=True
            )
        },
        "cost": {"before": tuned.trials[0].cost, "after": tuned.best.cost},
        "judgement": None,
    }
    if judgement is not None and tuned.costs is not None:
        mean, low, high = judgement.difference
        out["judgement"] = {
            "verdict": judgement.verdict,
            "better": judgement.better,
            "pairs": judgement.pairs,
            "seeds": judgement.seeds,
            "before": _known(judgement.before),
            "after": _known(judgement.after),
            "difference": {"mean": _known(mean), "low": _known(low), "high": _known(high)},
            "lost_before": judgement.lost_before,
            "lost_after": judgement.lost_after,
            "cost": {"before": tuned.costs[0], "after": tuned.costs[1]},
        }
    return out


def _known(value: float) -> float | None:
    return value if value == value else None


def _cells(trial: Trial) -> list[str]:
    numbers = (trial.cost, *trial.gains, *trial.costs)
    return [str(trial.number), str(trial.generation), *map(repr, numbers)]


def _line(cells: Sequence[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(cells)
    return file.getvalue()
