"""The same flight, ended earlier."""

from __future__ import annotations

from testbed.scenario.schema import Scenario


def shorten(page: Scenario, duration_s: float) -> Scenario:
    """Return the page with another duration, in s, and only what still fits into it.

    A portion that has begun by then ends with the run; one that has not is dropped, and so is a
    fault. Published numbers stay only beside portions that are flown whole.

    Raises:
        ValueError: (pydantic's) the duration is not above 0.
    """
    data = page.model_dump(by_alias=True)
    header = data["scenario"]
    whole = {name for name, (_, end) in page.scenario.portions.items() if end <= duration_s}
    header["duration_s"] = duration_s
    header["portions"] = {
        name: (begin, min(end, duration_s))
        for name, (begin, end) in page.scenario.portions.items()
        if begin < duration_s
    }
    if header["published"] is not None:
        for key in ("rms_m", "mean_rms_m", "percent_error"):
            table = header["published"][key]
            header["published"][key] = {name: table[name] for name in table if name in whole}
    for craft in (data["leader"], *data["fleet"]):
        craft["faults"] = [fault for fault in craft["faults"] if (fault["at_s"] or 0) <= duration_s]
    return Scenario.model_validate(data)
