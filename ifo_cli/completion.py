"""Shell completion."""

from __future__ import annotations

from collections.abc import Callable, Sequence


def complete_list(known: Sequence[str]) -> Callable[[str], list[str]]:
    """Return a completion function for comma-separated lists: it completes the last name with names not yet listed."""

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        chosen = before.split(",")
        return [f"{before}{comma}{name}" for name in known if name.startswith(last) and name not in chosen]

    return complete
