"""Small studies of ideal aircraft, and a crew that flies them in this process."""

from concurrent.futures import Future
from dataclasses import dataclass, field

from testbed.study.crew import fly

PAGE = """
study:
  schema: 1
  name: small
  scenario: ideal-figure-eight
  duration_s: 1
  set: {rates: {physics_hz: 50, autopilot_hz: 50, control_hz: 25, broadcast_hz: 25, log_hz: 25}}
  design: factorial
  seeds: [3, 1]
  metrics: [portions.approach.mean_rms_m]
vary:
  network.loss: [0, 0.4]
cases:
  near: {}
  far: {"fleet.uav1.start_m": [-90, 30, 0]}
"""
RUNS = 8


def write(folder, text=PAGE, name="small"):
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


@dataclass
class Here:
    """Flies in this process, and keeps the numbers of what it has flown."""

    flown: list[int] = field(default_factory=list)

    def room(self):
        return 1

    def submit(self, task):
        self.flown.append(task.number)
        future = Future()
        future.set_result(fly(task))
        return future

    def killed(self, error):
        return False

    def end(self):
        pass


def content(table):
    """Everything that must not depend on who flew: columns with their bits, and the facts."""
    return {name: (c.dtype, [repr(v) for v in c.tolist()]) for name, c in table.columns.items()}, (
        dict(table.facts)
    )
