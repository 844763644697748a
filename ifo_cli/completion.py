"""Completions for the shell."""

from __future__ import annotations

from collections.abc import Callable, Sequence


def complete_list(known: Sequence[str]) -> Callable[[str], list[str]]:
    """A completion of lists of names separated by commas: of the last name, by those that are not in the list yet."""

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        chosen = before.split(",")
        return [f"{before}{comma}{name}" for name in known if name.startswith(last) and name not in chosen]

    return complete
