"""Values of --contexts and --vary, shared by the stages that draw contexts."""

from __future__ import annotations

from artifacts.errors import UsageError
from stages.config.names import FACTORS

CONTEXTS_HELP = (
    "viewpoints on the full circle (paper), within 40 degrees to either side (narrow), or a single one (fixed)"
)
VARY_HELP = (
    f"Factors that vary between contexts, comma-separated: {', '.join(FACTORS)} (default: those that the paper varies "
    "in the task)."
)


def parse_factors(vary: str) -> frozenset[str] | None:
    """Return the factors that `--vary` lists; None: the task's default.

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
    """Refuse unknown factors, and a viewpoint that is both varied and fixed.

    Raises:
        UsageError: The options are invalid.
    """
    factors = parse_factors(vary)
    if factors and "azimuth" in factors and contexts == "fixed":
        raise UsageError(
            "--vary azimuth has no effect with --contexts fixed, a single viewpoint: use --contexts paper or narrow"
        )
