"""The one tree of errors that a user can meet, each with its exit code.

A message is one line: it names the file or option, says what was expected and what to do.
"""

from __future__ import annotations


class IfoError(Exception):
    """What a user can mend; anything else that escapes is a bug."""

    exit_code = 1


class UsageError(IfoError):
    """The options do not make sense together."""

    exit_code = 2


class ArtifactError(IfoError):
    """A file is missing, damaged, of another kind, or from another time."""

    exit_code = 3


class PlatformError(IfoError):
    """The machine lacks something: GL, a device, room on the disk, leave to write."""

    exit_code = 4


class Interrupted(IfoError):
    """The user stopped the stage; its checkpoint is kept."""

    exit_code = 130
