"""Words and units of metrics and keys, for titles and axes."""

from __future__ import annotations

UNITS = {
    "m": "m", "mps": "m/s", "s": "s", "deg": "°", "percent": "%", "hz": "Hz", "radps": "rad/s",
}  # fmt: skip
# of quantities that `metrics.json` abbreviates
WORDS = {
    "mean_rms_m": "mean RMS error",
    "rms_m": "RMS error",
    "estimated_rms_m": "RMS error by estimates",
    "estimated_mean_rms_m": "mean RMS error by estimates",
    "max_error_m": "largest error",
    "min_separation_m": "smallest separation",
    "joined_at_s": "time of joining",
}
WITHOUT_MEANING = ("windows",)


def metric_words(metric: str) -> tuple[str, str]:
    """Return a metric's words and unit, "" without one: "mean RMS error, circles" and "m".

    The words are the quantity, what it is of, and the part of `metrics.json`.
    """
    names = metric.split(".")
    for k in range(len(names) - 1, -1, -1):
        stem, _, suffix = names[k].rpartition("_")
        if stem and suffix in UNITS:
            quantity = WORDS.get(names[k]) or _plain(stem)
            others = [_plain(each) for each in names[k + 1 :] + names[:k]]
            others = [each for each in others if each not in WITHOUT_MEANING]
            return ", ".join([quantity, *others]), UNITS[suffix]
    words = [WORDS.get(each) or _plain(each) for each in names]
    return ", ".join(each for each in words if each not in WITHOUT_MEANING), ""


def metric_title(metric: str) -> str:
    """Return the words of a metric with a capital letter."""
    words, _ = metric_words(metric)
    return words[0].upper() + words[1:]


def axis_label(metric: str) -> str:
    """Return the words and the unit of a metric."""
    return ", ".join(filter(None, metric_words(metric)))


def wrap_key(key: str, length: int) -> str:
    """Break a key of a scenario behind dots into lines of at most this length where possible."""
    lines = [""]
    parts = key.split(".")
    for k, part in enumerate(parts):
        text = part + "." * (k < len(parts) - 1)
        if lines[-1] and len(lines[-1]) + len(text) > length:
            lines.append("")
        lines[-1] += text
    return "\n".join(lines)


def _plain(name: str) -> str:
    return name.replace("_", " ")
