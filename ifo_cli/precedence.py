"""Give the packages of ifo precedence over the user's modules of the same name.

`python -m` puts the current folder first in `sys.path`, and PYTHONPATH comes before the installed packages. A user's
artifacts.py or stages/ there would be imported instead of ours.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import PathFinder

PACKAGES = ("artifacts", "ifo", "stages")


def put_our_packages_first(home: str) -> None:
    """Move the entries of `sys.path` that hold modules with our names directly behind `home`.

    They stay on the path, because users' tasks are imported from there. Child processes inherit the order.

    Args:
        home: The folder that holds our packages. It is added to the path if it is missing (editable installs).

    Raises:
        ImportError: Another module with one of our names has already been imported.
    """
    home = os.path.realpath(home)
    for name in PACKAGES:
        if (module := sys.modules.get(name)) is not None:
            _check_is_ours(name, getattr(module, "__file__", None) or "", home)
    entries = list(map(_real, sys.path))
    at = entries.index(home) if home in entries else len(entries)
    shadows = [entry for entry in sys.path[:at] if any(PathFinder.find_spec(name, [entry]) for name in PACKAGES)]
    if shadows:
        sys.path[:] = [*(entry for entry in sys.path[:at] if entry not in shadows), home, *shadows, *sys.path[at + 1 :]]


def _real(entry: str) -> str:
    """Return an entry of `sys.path` without links; a relative one stays as it is if the working folder is gone."""
    try:
        return os.path.realpath(entry)
    except FileNotFoundError:
        return entry


def _check_is_ours(name: str, file: str, home: str) -> None:
    if not os.path.realpath(file).startswith(os.path.join(home, name) + os.sep):
        raise ImportError(f"the imported module {name!r} ({file}) has the same name as a package of ifo: rename it")
