"""Count the flights of a study that end with a follower out of its slot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from testbed.core.records import Array, BoolArray

METRICS = ("recovery.", "max_error_m.", "lost_at_s.")  # beginnings of the names that are read
_RECOVERY, _SLOT = "recovery.", ".in_slot_since_s"


def count_out_of_slot(metrics: Mapping[str, Array], where: BoolArray) -> int:
    """Count flights that end with a follower that is not lost out of its slot.

    Args:
        metrics: values (R,) by name, NaN for null.
        where: (R,) the flights to count.
    """
    out = np.zeros(where.shape, dtype=np.bool_)
    for name, since in metrics.items():
        if name.startswith(_RECOVERY) and name.endswith(_SLOT):
            follower = name[len(_RECOVERY) : -len(_SLOT)]
            known = metrics.get(f"max_error_m.{follower}")
            lost = metrics.get(f"lost_at_s.{follower}")
            flew = np.zeros_like(out) if known is None else ~np.isnan(known)
            out |= flew & np.isnan(since) & (True if lost is None else np.isnan(lost))
    return int((out & where).sum())
