"""Start the command line with ``python -m bcapscope``."""

from bcapscope.cli import main

main()
