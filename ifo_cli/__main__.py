"""`python -m ifo_cli`, which launchers of several processes start."""

import sys

from ifo_cli.main import main

if __name__ == "__main__":
    sys.exit(main())
