"""The installed version of ifo."""

from __future__ import annotations


def ifo_version() -> str:
    """Return the version of the installed package; `0.0.0+unknown` if it is not installed."""
    from importlib import metadata

    try:
        return metadata.version("ifo")
    except metadata.PackageNotFoundError:
        return "0.0.0+unknown"
