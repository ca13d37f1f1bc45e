"""The command line: one module for each group of commands."""

import sys

if sys.platform == "win32":  # no fork, file locks or process groups
    sys.stderr.write("error: testbed needs Linux or macOS; on Windows use WSL 2 or a container\n")
    sys.exit(2)
