"""What a process does that a signal shall end: in compiled code, waiting, or in Python."""

import sys
import time

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry_of_user_code
from testbed.core.interrupts import count_signals


def rounds(x, now):
    while now == 0.0:
        x[0] += 1
    return 0


def work():
    """Print a line, and do what the argument of the process names."""
    call = Call(entry_of_user_code(rounds, None), np.zeros(1), NOW)
    call(1.0)
    acts = {
        "stuck": lambda: call(0.0),
        "waiting": lambda: time.sleep(100.0),
        "calling": lambda: [call(1.0) for _ in range(10**9)],
    }
    try:
        with count_signals():
            print("begun", flush=True)
            acts[sys.argv[1]]()
    except KeyboardInterrupt:
        sys.exit("handled")
