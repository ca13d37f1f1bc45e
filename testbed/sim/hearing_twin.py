"""The compiled twin of `hearing.heard`."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import bound, twin
from testbed.formation.flags import Guard, Missing
from testbed.network.ledger_twin import use

SILENT = int(Guard.LEADER_SILENT)
OVERDUE, DEAF = map(int, Missing)


def ready_heard(ledger, *fixed):
    return bound(_heard, ledger.sent.base, *fixed, more=(0.0,))


@twin
def _heard(ledger, rows, age_s, guards, received_s, heeded, missed, limit, late, now):
    use(ledger, rows, age_s)
    found = 0
    for i in rows:
        for m in range(heeded.shape[1]):
            # what was never heard counts from the start
            since = max(received_s[i, m], 0.0) if received_s[i, m] == received_s[i, m] else 0.0
            late[i, m] = heeded[i, m] and now - since > limit
            if late[i, m] != missed[i, m]:
                found |= OVERDUE
    for i in range(len(guards)):
        if guards[i] & SILENT:
            found |= DEAF
    return found
