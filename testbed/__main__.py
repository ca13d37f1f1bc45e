"""Run the command line with `python -m testbed`."""

from testbed.cli.entry import main

main()
