"""Has pytest find what tests of every folder share: the modules beside this file."""

import signal

# A shell that runs `make test` in the background has it ignore SIGINT, which programs inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
