"""Environments for reinforcement learning: Gymnasium for one follower, PettingZoo for all.

`import testbed.rl` registers `testbed/HoldSlot-v0` for `gymnasium.make`. It needs the extra `rl`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from testbed.core.errors import needs_extra

with needs_extra("rl", "environments"):
    import gymnasium
    import pettingzoo  # noqa: F401 - fail here, not in the module that uses it

if TYPE_CHECKING:
    from testbed.rl.formation import FormationEnv
    from testbed.rl.hold_slot import HoldSlotEnv
    from testbed.rl.vector import FormationVectorEnv, HoldSlotVectorEnv

__all__ = ["FormationEnv", "FormationVectorEnv", "HoldSlotEnv", "HoldSlotVectorEnv"]
_MODULES = {
    "FormationEnv": "testbed.rl.formation",
    "FormationVectorEnv": "testbed.rl.vector",
    "HoldSlotEnv": "testbed.rl.hold_slot",
    "HoldSlotVectorEnv": "testbed.rl.vector",
}

gymnasium.register(
    id="testbed/HoldSlot-v0",
    entry_point="testbed.rl.hold_slot:HoldSlotEnv",
    vector_entry_point="testbed.rl.vector:HoldSlotVectorEnv",
)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - classes of libraries without types
    """Import an environment when it is used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)
