"""`python -m ifo_cli`, the entry point for launchers of several processes."""

import sys

from ifo_cli.main import main

if __name__ == "__main__":
    sys.exit(main())
