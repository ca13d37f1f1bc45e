"""Write the table of docs/rl.md, and the picture of the training: python benchmarks/training.py.

usage: python benchmarks/training.py --into docs/rl.md

Runs `make train`, which makes its own environment; numbers differ between machines in their digits.
"""

from __future__ import annotations

import argparse
import re
import subprocess

from inputs import NUMERIC, ROOT, TRAINING, Case, Inputs
from tables import add_output_arguments, publish, row

MARK = "python benchmarks/training.py"
INPUTS = {MARK: Inputs((Case("hold-slot"),), packages=(*NUMERIC, *TRAINING))}
PICTURE = "docs/images/training.png"
NAMES = {
    "trim": "trim: all actions zero",
    "policy": "policy",
    "paper's law": "the paper's law",
}
LINE = re.compile(r"  (.+?) +([\d.]+) m mean slot error, +([\d.]+) m in the second half; +(\d+)%")


def text(output: str) -> str:
    """Return the table of what the training printed, and the picture."""
    found = {name: numbers for name, *numbers in LINE.findall(output)}
    lines = [
        row("flown by", "mean error, m", "in the second half, m", "left the formation"),
        "|---|---|---|---|",
        *(
            row(label, *(f"{float(each):.1f}" for each in found[name][:2]), f"{found[name][2]} %")
            for name, label in NAMES.items()
        ),
        "",
        "![Mean distance from the slot of an episode during the training, and of the episodes of "
        "the table](images/training.png)",
    ]
    return "\n".join(lines)


def main() -> None:
    """Train, and print or insert the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser)
    options = parser.parse_args()
    if options.check:
        parser.error("--check: a training does not repeat its digits")
    command = ("make", "train", f"ARGS=--plot {PICTURE}")
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    publish(options, {MARK: text(done.stdout)}, INPUTS)


if __name__ == "__main__":
    main()
