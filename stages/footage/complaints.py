"""Listens to what FFmpeg's libraries log as errors: they conceal damage and tell of it only there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def complaints() -> Iterator[list[tuple[int, str, str]]]:
    """A list that fills with the errors that are logged inside: level, who logs it, and the message."""
    import av

    level, repeated = av.logging.get_level(), av.logging.get_skip_repeated()
    av.logging.set_skip_repeated(False)
    av.logging.set_level(av.logging.ERROR)
    try:
        with av.logging.Capture(local=False) as lines:
            yield lines
    finally:
        av.logging.set_level(level)
        av.logging.set_skip_repeated(repeated)
