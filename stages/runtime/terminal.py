"""Text for a terminal. What comes out of files, names or libraries cannot control the terminal or fake another line."""

from __future__ import annotations

import sys
from contextlib import suppress

LONGEST = 4000  # characters of a line on standard error


def one_line(text: str) -> str:
    r"""Return the text on one line: what is not printable is escaped, as `\u001b` or `\U000e0001`.

    Not printable are control characters, line breaks, marks that change the direction of text, and surrogates.
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else _escaped(ord(letter)) for letter in text)


def _escaped(code: int) -> str:
    return f"\\u{code:04x}" if code < 1 << 16 else f"\\U{code:08x}"


def say(text: str) -> None:
    """Print one line on standard error, with its middle left out if it is very long; never raises OSError."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    if sys.stderr is not None:
        with suppress(OSError):  # The work continues even if nobody reads standard error anymore.
            print(one_line(text), file=sys.stderr, flush=True)
