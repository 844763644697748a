"""The `ifo` command. Heavy packages are imported only when a command runs."""

from pathlib import Path

from ifo_cli.precedence import put_our_packages_first

put_our_packages_first(str(Path(__file__).parents[1]))
