"""The compiled twins of `hearing.some_deaf` and `hearing.overdue`."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import bound, twin
from testbed.formation.flags import Guard

SILENT = int(Guard.LEADER_SILENT)


@twin
def some_deaf(guards):
    for i in range(len(guards)):
        if guards[i] & SILENT:
            return True
    return False


def ready_overdue(rows, received_s, heeded, missed, limit, late):
    return bound(_overdue, rows, received_s, heeded, missed, limit, late, more=(0.0,))


@twin
def _overdue(rows, received_s, heeded, missed, limit, late, now):
    changed = False
    for k in range(len(rows)):
        i = rows[k]
        for m in range(heeded.shape[1]):
            # what was never heard counts from the start
            heard = max(received_s[i, m], 0.0) if received_s[i, m] == received_s[i, m] else 0.0
            late[i, m] = heeded[i, m] and now - heard > limit
            changed |= late[i, m] != missed[i, m]
    return changed
