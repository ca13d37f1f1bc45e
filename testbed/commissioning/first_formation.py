"""A scenario in which a new aircraft flies in a formation of its own kind."""

from __future__ import annotations

import math
from typing import Any

from testbed.commissioning.new_aircraft import ALTITUDE, DerivedAircraft
from testbed.core.frames import GRAVITY

NAME = "formation-of-three.yaml"
BANK = math.radians(21.0)  # of the leader on its circle, in which small errors of speed are seen
BEHIND, ASIDE = 2.75, 2.25  # wingspans, from the leader to its first two slots
CLIMB = 1.0 / 16.0  # of the radius
TURNS = 2.5
KAPPA, K = 3.6, 3.0  # m/s, the paper's
MARGIN = 0.9  # of the margin of the slots' speeds, that is κ


def first_formation(name: str, found: DerivedAircraft, span: float) -> str:
    """Return the text of a scenario with a leader and three followers on a circle that climbs.

    Slots are a few wingspans apart. κ is the paper's, or less where the slots' speeds come nearer
    to the speeds of the autopilot.

    Args:
        name: of the aircraft's folder, in which the file is.
        found: what was measured on the aircraft, which has an engine.
        span: m.
    """
    speed, params = found.level.airspeed, found.check.params
    true = found.steps.airspeed / found.steps.equivalent_airspeed
    low = math.ceil(params.airspeed_min * true * 10.0) / 10.0
    high = math.floor(params.airspeed_max * true * 10.0) / 10.0
    radius = math.ceil(speed**2 / (GRAVITY * math.tan(BANK)) / 10.0) * 10.0
    behind, aside = round(BEHIND * span, 1), round(ASIDE * span, 1)
    inner, outer = speed * (1.0 - aside / radius), speed * (1.0 + aside / radius)
    kappa = min(KAPPA, math.floor(MARGIN * min(inner - low, high - outer) * 10.0) / 10.0)
    kappa = max(kappa, 0.1)
    turn_s = 2.0 * math.pi * radius / speed
    climb = round(CLIMB * radius)
    assert found.speed is not None, "with an engine"
    numbers: dict[str, Any] = {
        "name": name,
        "duration": f"{math.ceil(TURNS * turn_s)}",
        "window": f"[{math.ceil(0.5 * turn_s)}, {math.ceil(TURNS * turn_s)}]",
        "speed": f"{speed:g}",
        "radius": f"{radius:g}",
        "altitude": f"{ALTITUDE:g}",
        "higher": f"{ALTITUDE + climb:g}",
        "ahead": f"{-behind:g}",
        "left": f"{-aside:g}",
        "right": f"{aside:g}",
        "third": f"{-2.0 * behind:g}",
        "start": f"{-1.6 * behind:.1f}",
        "start_third": f"{-2.6 * behind:.1f}",
        "low": f"{low:g}",
        "high": f"{high:g}",
        "kappa": f"{kappa:g}",
        "k": f"{round(K / KAPPA * kappa, 2):g}",
        "pole": f"{found.speed.model.pole:.2f}",
    }
    return _TEXT.format_map(numbers)


_TEXT = """\
# Three {name} behind a fourth, on a circle with 21° of bank that climbs and descends, made by
# testbed new aircraft: speeds are those of its autopilot, the pole was measured, and slots are some
# wingspans apart. It flies with: testbed run {name}/formation-of-three.yaml

scenario:
  schema: 2
  name: {name}-formation
  question: Does the {name} hold the slots of a formation?
  duration_s: {duration}
  windows: {{circle: {window}}}

leader:
  aircraft: .
  start: {{east_m: -{radius}, altitude_m: {altitude}}}
  path:
    kind: mission
    airspeed_mps: {speed}
    legs:
      - kind: loiter
        centre_m: [0, 0]
        radius_m: {radius}
        levels:
          - {{altitude_m: {altitude}, turns: 0.5}}
          - {{altitude_m: {higher}, turns: 1}}
          - {{altitude_m: {altitude}, turns: 2}}

fleet:
  - {{name: uav1, aircraft: ., start_m: [{start}, {right}, 0]}}
  - {{name: uav2, aircraft: ., start_m: [{start}, {left}, 0]}}
  - {{name: uav3, aircraft: ., start_m: [{start_third}, 0, 0]}}

formation:
  offsets_m: {{uav1: [{ahead}, {right}, 0], uav2: [{ahead}, {left}, 0], uav3: [{third}, 0, 0]}}
  leader_gains: {{uav1: 1, uav2: 1, uav3: 1}}
  speed_mps: [{low}, {high}] # of the autopilot
  speed_pole_per_s: {pole} # measured
  kappa_mps: {kappa}
  k: {k}
"""
