"""What a formation law of your own needs: `controller: {law: "module:Class"}` on the page.

    class MyLaw:
        def __init__(self, team: Team, *, gain: float = 0.3) -> None: ...
        def start(self, own: VehicleState) -> Memory: ...
        def step(self, now, own, inbox, memory) -> tuple[UnicycleCommand | FbwaCommand, Memory]: ...

`module` is a file beside the page or an installed one; the page's `controller.options` are the
keyword arguments. A law steps n followers at once (`team.names`); every array it gets or gives has
one row for each, and row i may depend on what follower i knows and on nothing else: `own` row i is
its own estimate, `inbox` row i the newest message it has received of each of the N aircraft (the
leader's in column 0; nan: nothing heard yet). It must not write into what it is given, and what it
remembers goes out and comes in as a value. It answers with

- a `UnicycleCommand`: ground speed u, turn ω, desired speed and direction. The middle loop of the
  paper turns that into pitch, roll and throttle, and an ideal vehicle flies it as it is; or
- an `FbwaCommand`: pitch, roll, throttle, the sticks of fly-by-wire A.

`testbed validate` holds a law to all of that (`testbed.sim.law_contract`).
"""

from testbed.formation.flags import Guard
from testbed.formation.law import Law, Team
from testbed.state import FbwaCommand, Inbox, UnicycleCommand, VehicleState

__all__ = [
    "FbwaCommand",
    "Guard",
    "Inbox",
    "Law",
    "Team",
    "UnicycleCommand",
    "VehicleState",
]
