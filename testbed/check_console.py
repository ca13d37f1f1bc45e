"""What `testbed check` does on the terminal, and its exit codes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from testbed.errors import InputError
from testbed.options import refuse_below_one
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.progress import counting
from testbed.study.golden import Case, check, find_cases, renew
from testbed.study.golden_text import show_check, show_renewals
from testbed.study.golden_words import to_document
from testbed.study.junit import to_junit, write_junit

GOOD, REGRESSION = 0, 3


def check_and_show(
    scenarios: Sequence[str],
    *,
    seeds: int | None,
    jobs: int | None,
    junit: Path | None,
    json: Path | None,
    update: bool,
    reason: str | None,
    golden: Path | None,
) -> int:
    """Hold scenarios to their golden tables, or write these, and return the exit code.

    Raises:
        InputError: an option or a page cannot be used, or there is no table.
        KeyboardInterrupt: Ctrl-C; nothing has been written.
    """
    _refuse(seeds=seeds, jobs=jobs, junit=junit, json=json, update=update, reason=reason)
    try:
        cases = find_cases(scenarios, folder=golden, new=update)
    except InputError as error:
        if junit:
            write_junit(junit, to_junit([], str(error).splitlines()))
        raise
    jobs = jobs or os.cpu_count() or 1
    if update:
        assert reason is not None
        return _update(cases, seeds=seeds, jobs=jobs, reason=reason.strip())
    with counting("flights") as show:
        verdicts = check(cases, seeds=seeds, jobs=jobs, progress=show)
    if junit:
        write_junit(junit, to_junit(verdicts))
    show_check(verdicts, Console(stderr=is_stdout(json), highlight=False))
    document = to_document(verdicts)
    put_json(json, document)
    return GOOD if document["passed"] else REGRESSION


def _update(cases: Sequence[Case], *, seeds: int | None, jobs: int, reason: str) -> int:
    with counting("flights") as show:
        renewals = renew(cases, seeds=seeds, jobs=jobs, reason=reason, progress=show)
    show_renewals(renewals, Console(highlight=False))
    return GOOD if all(renewal.table for renewal in renewals) else REGRESSION


def _refuse(
    *,
    seeds: int | None,
    jobs: int | None,
    junit: Path | None,
    json: Path | None,
    update: bool,
    reason: str | None,
) -> None:
    refuse_below_one(seeds=seeds, jobs=jobs)
    if update and not (reason or "").strip():
        raise InputError(
            "--update: say why the numbers are what they should be, with --reason TEXT"
        )
    if reason is not None and not update:
        raise InputError("--reason: goes with --update, which writes it into the tables")
    for option, path in (("--junit", junit), ("--json", json)):
        if path and update:
            raise InputError(f"{option}: --update writes tables and judges nothing: leave it out")
    refuse_files(junit=junit, json=json)
