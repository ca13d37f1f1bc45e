"""Environments for reinforcement learning: Gymnasium for one follower, PettingZoo for all.

`import testbed.rl` registers `testbed/HoldSlot-v0` for `gymnasium.make`. It needs the extra `rl`.
"""

from testbed.core.errors import needs_extra

with needs_extra("rl", "environments"):
    import gymnasium
    import pettingzoo  # noqa: F401 - fail here, not in the module that uses it

gymnasium.register(id="testbed/HoldSlot-v0", entry_point="testbed.rl.hold_slot:HoldSlotEnv")
