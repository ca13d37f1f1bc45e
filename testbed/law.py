"""Types for a formation law of your own: `controller: {law: "module:Class"}` in a scenario.

    class MyLaw:
        def __init__(self, config: FormationConfig, *, gain: float = 0.3) -> None: ...
        def start(self, own: OwnState) -> Memory: ...
        def step(self, now, own, inbox, memory) -> tuple[UnicycleCommand | FbwaCommand, Memory]: ...

`module` is a file beside the scenario, or an installed module; `controller.options` are the keyword
arguments. `start` is called once, with the first estimates, and returns the memory before the first
step; `step` is called every control period, at time `now` (s), and returns the command and the new
memory.

A law that is compiled and flies without Python is a function of one follower: `testbed.kernel`.

A law steps n followers at once, of N aircraft. Each array has one row per follower, and row i of
the command may depend on row i of `own` and `inbox` only: on what follower i has received. A law
must not modify its inputs, and carries its state in the memory only. `testbed validate` checks
these rules (`testbed.plan.user_code`).

Vectors are north, east, down (NED) from the scenario's origin; angles in rad, rates in rad/s.

`FormationConfig`, the first argument of the class:

- `names`: of the n followers. `agents` (n,): their rows among the N aircraft; the leader's is 0.
- `offsets` (N, 3) m: slots, forward, right, down in the leader's velocity frame; 0 for the leader.
- `gains` (n, N, 3): β_i of the leader in column 0, β_ij of the neighbours; per axis of NED.
- `airspeed_min`, `airspeed_max` (n,) m/s: bounds of the airspeed. `ground_speed_min`,
  `ground_speed_max` (n,) m/s: those of the ground speed, 0 and infinite with
  `controller.bounded_speed: airspeed`, the default in wind. The ground velocity is the velocity
  through the air plus the wind; `ground_speed_bounds(config, own)` are the bounds of the speed over
  the ground at present. `speed_min`, `speed_max`: older names of the airspeed's, without wind only.
- `speed_pole` (n,) 1/s: p of the speed model ds/dt = p (u − s).
- `pitch_limit`, `roll_limit` (n,) rad: of the fly-by-wire-A command.
- `trim_throttle` (n,), 0 to 1: for level flight at `trim_airspeed` (n,) m/s.
- `dt` s: control period.
- `leader_timeout_s`, `neighbour_timeout_s` s: age at which messages of the leader, and of a
  neighbour, should no longer be used.
- `hbh23`: the built-in law of [HBH23] with the scenario's gains, for a law that extends it.

`OwnState`, the argument `own`, each follower's estimate of itself:

- `position_ned` (n, 3) m; `velocity_ned` (n, 3) m/s, over the ground; `acceleration_ned` (n, 3)
  m/s², its derivative.
- `euler` (n, 3): roll, pitch, yaw. `rates_body` (n, 3): p, q, r.
- `airspeed` (n,) m/s: true. `equivalent_airspeed` (n,) m/s: what a pitot tube measures.
- `wind_ned` (n, 3) m/s: velocity of the air, as the navigation filter estimates it; without
  sensors the wind at the aircraft.

`Inbox`, the newest message that each follower has received of each aircraft, the leader's in column
0; NaN before the first:

- `stamp_s` (n, N) s: time of the measurement on the sender's clock. `received_s` (n, N) s: time of
  arrival on the receiver's clock. With `controller.extrapolate_from` positions and velocities are
  extrapolated to the present from one of the two, and both are `now`, but for messages that have
  timed out.
- `position_ned`, `velocity_ned`, `acceleration_ned` (n, N, 3): as above. `euler`, `euler_rates`
  (n, N, 3): roll, pitch, yaw, and their derivatives. `turn_rate` (n, N): rate of the course.
- `failed` (n, N): whether the sender declares that it has failed.
- `payload` (n, N, K): numbers that the sender's law has sent, see `Outputs`.

`Outputs` declares fields of a law's memory that each message carries, that the log has, or whose
changes are events: the attribute `outputs` of a class, arguments of `testbed.kernel`.

Commands; each array has one row per follower, and one number is no array:

- `UnicycleCommand`, the inputs of the extended unicycle, [HBH23] (2) and (3). The middle loop turns
  it into pitch, roll and throttle; `vehicle: unicycle` flies it directly.
  `speed` (n,) m/s: u, commanded ground speed.
  `omega` (n, 3): ω, angular velocity of the zero-roll velocity frame in its own axes forward,
  right, down: (0, pitch rate, yaw rate).
  `speed_desired` (n,) m/s: s_d, and `direction` (n, 3): y_d, a unit vector in NED; desired motion
  for the middle loop and the log.
  `limiter_flags` (n,): bit set of `LimiterFlag`, which limits acted; 0 for none, also as one
  number for all.
  `command_from_velocity(config, own, velocity_ned)` makes one from desired velocities.
- `FbwaCommand`, what ArduPlane's mode FBWA takes from the sticks: `pitch` (n,) rad, nose up
  positive; `roll` (n,) rad, right wing down positive; `throttle` (n,), 0 to 1.
"""

from __future__ import annotations

from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.records import FbwaCommand, Inbox, OwnState, UnicycleCommand, VehicleState
from testbed.formation.compiled_law import FollowerConfig
from testbed.formation.follower_hbh23 import HBH23_MEMORY, FollowerHbh23
from testbed.formation.law import FormationConfig, Law
from testbed.formation.law_outputs import Outputs
from testbed.formation.velocity_command import command_from_velocity, ground_speed_bounds

__all__ = [
    "HBH23_MEMORY",
    "FbwaCommand",
    "FollowerConfig",
    "FollowerHbh23",
    "FormationConfig",
    "Inbox",
    "Law",
    "LimiterFlag",
    "Outputs",
    "OwnState",
    "Saturation",
    "UnicycleCommand",
    "VehicleState",
    "command_from_velocity",
    "ground_speed_bounds",
]
