"""Run the command line with `python -m testbed`."""

from testbed.cli.main import main

main()
