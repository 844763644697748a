"""What --contexts and --vary may say; shared by the stages that draw contexts."""

from __future__ import annotations

from artifacts.errors import UsageError
from stages.config.names import FACTORS

CONTEXTS_HELP = "seen from all around (paper), from within 40 degrees (narrow), or from a single viewpoint (fixed)"
VARY_HELP = (
    f"What varies between contexts, a comma-separated choice of {', '.join(FACTORS)} (default: what the paper varies "
    "in the task)."
)


def parse_factors(vary: str) -> frozenset[str] | None:
    """The factors that `--vary` lists; None: the task's own choice.

    Raises:
        UsageError: There is no such factor.
    """
    if not vary:
        return None
    factors = frozenset(word.strip() for word in vary.split(","))
    if unknown := sorted(factors - set(FACTORS)):
        raise UsageError(f"--vary {unknown[0]!r}: expected a comma-separated choice of {', '.join(FACTORS)}")
    return factors


def check_contexts(contexts: str, vary: str) -> None:
    """Refuse unknown factors, and a viewpoint that is to vary and to be fixed.

    Raises:
        UsageError: One line.
    """
    factors = parse_factors(vary)
    if factors and "azimuth" in factors and contexts == "fixed":
        raise UsageError(
            "--vary azimuth has no range with --contexts fixed, a single viewpoint: expected --contexts paper or narrow"
        )
