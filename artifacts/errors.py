"""All errors that a user may see, each with its exit code.

A message is one line: it names the file or option, what was expected, and what to do.
"""

from __future__ import annotations


class IfoError(Exception):
    """An error that a user can fix; any other exception that reaches the user is a bug."""

    exit_code = 1


class UsageError(IfoError):
    """An option, argument or combination of options is invalid, or a user's own task is broken."""

    exit_code = 2


class ArtifactError(IfoError):
    """A file is missing, damaged, of the wrong kind, or of a version that cannot be read."""

    exit_code = 3


class PlatformError(IfoError):
    """The machine lacks something: OpenGL, a device, disk space, write permission."""

    exit_code = 4


class Interrupted(IfoError):
    """The user stopped the stage; its checkpoint is kept."""

    exit_code = 130
