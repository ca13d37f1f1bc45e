"""Describe the scenarios for `testbed list`: groups by purpose, and a line for each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

MAX_LINE = 38  # characters, which leave the table of `testbed list` within 80 columns

GROUPS: Final[Mapping[str, Mapping[str, str]]] = {
    "start here": {
        "simulation-3": "the paper's formation of three",
        "simulation-3-pixhawk": "the same with hobby sensors and an EKF",
        "packet-loss-30": "the same with 30 % of messages lost",
        "engine-out-uav2": "an aircraft loses its engine",
    },
    "the paper": {
        "simulation-1": "leader's position for uav1 only",
        "simulation-2": "position of the aircraft ahead only",
        "experiment-1": "two Skywalker X8s at 10 Hz, in wind",
        "experiment-2": "three X8s, above and below the leader",
        "experiment-3": "the same with the horizontal law",
        "ideal-figure-eight": "the law on its own unicycle model",
    },
    "variants of simulation-3": {
        "simulation-3-improved": "improved middle loop and estimates",
        "simulation-3-30deg": "corners at 30 degrees of bank",
        "simulation-3-hard": "a path beyond the aircraft's limits",
        "simulation-3-noise": "noise of a GPS/INS estimate",
        "simulation-3-recorded-leader": "behind a recorded flight",
        "simulation-3-ardupilot": "ArduPlane flies every aircraft",
    },
    "network": {
        "simulation-3-latency": "messages 0.1 s old, clocks agree",
        "latency-500ms": "messages 0.5 s old",
        "bursty-wifi": "bursts of loss on a crowded WiFi",
        "loss-and-latency": "loss and latency together",
        "telemetry-radio": "one shared radio with MAVLink frames",
        "partition-and-heal": "formation divided, then whole again",
        "leader-silent": "no messages from the leader",
    },
    "wind": {
        "wind-8ms": "steady wind of 8 m/s",
        "turbulence-moderate": "moderate turbulence, one field for all",
        "gust-front": "a gust front crosses the formation",
        "close-formation-wake": "followers in the leader's wake",
    },
    "sensors and faults": {
        "gps-degraded": "degraded GPS reception",
        "airspeed-blocked": "a blocked pitot tube",
    },
    "your own law": {
        "own-law-leader-follower": "a textbook leader-follower law",
        "own-law-integral": "integral action around the paper's law",
        "own-law-repulsion": "repulsion between two aircraft",
        "own-functions": "a control function and a barrier",
        "ideal-own-speed-model": "ideal vehicles with drag and a propeller",
    },
    "other fleets": {
        "hold-slot": "one follower, for training policies",
        "mixed-fleet": "different aircraft in one formation",
        "vee-30": "a vee of thirty",
        "vee-100": "a vee of a hundred",
    },
}
OTHERS: Final = "others"  # the group of scenarios that are in no other

STUDIES: Final[Mapping[str, str]] = {
    "radio-and-wind": "loss and wind together",
    "what-matters-most": "delay, loss, wind and gusts compared",
    "convergence": "rates that do not change the errors",
    "leader-acceleration": "the leader's acceleration, estimated",
    "leader-turn-acceleration": "differences of the turn rates",
    "table-1": "the set-up that gives Table 1",
    "table-1-ages": "old messages and own states",
    "table-1-causes": "single causes of such errors",
    "table-1-laps": "leader's acceleration left out",
    "table-1-authors": "the authors' gains with old states",
    "joint-fit": "sets of numbers that give Table 2",
    "as-flown": "the experiments, one set of parameters",
    "turn-direction": "the leader turns the other way",
    "gap-budget-0": "the aircraft alone, without troubles",
    "gap-budget-1": "reasons for the errors of experiment 1",
    "gap-budget-2": "reasons for the errors of experiment 2",
    "gap-budget-3": "reasons for the errors of experiment 3",
}
TUNES: Final[Mapping[str, str]] = {"x8-middle-loop": "gains of the X8's middle loop"}
