"""Where MuJoCo's warnings go: to Python's logging, each once.

By default, MuJoCo appends them to a file MUJOCO_LOG.TXT in the current folder, wherever a command happens to run.
"""

from __future__ import annotations

import logging

_LOG = logging.getLogger("mujoco")
_seen: set[str] = set()


def log_warnings() -> None:
    """Send MuJoCo's warnings to the logger `mujoco`, unless a handler is set already. Imports mujoco."""
    import mujoco

    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_warn)


def _warn(text: str) -> None:
    """Log a warning once, whatever the time of the simulation that it names.

    What MuJoCo says of deprecated elements is for authors of models, so it is logged at a level that is not shown.
    """
    what = text.partition(" Time =")[0]
    if what not in _seen:
        _seen.add(what)
        _LOG.log(logging.DEBUG if "deprecated" in what else logging.WARNING, "MuJoCo: %s", what)
