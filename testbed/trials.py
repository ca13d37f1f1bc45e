"""The old name of `testbed.probes.channel_probe`, until release 0.2."""

import sys
import warnings

from testbed.probes import channel_probe

warnings.warn(
    "testbed.trials.channel_probe is testbed.probes.channel_probe now (write this name)",
    DeprecationWarning,
    stacklevel=2,
)
__path__: list[str] = []  # so that the import of what is below finds the next line
sys.modules[f"{__name__}.channel_probe"] = channel_probe
