"""One injection: where it happens, its random numbers, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.originals import STAGES, Originals
from tests.faults.server import Outcome, command, complaint, run

TEMPORARY = ".tmp-"  # part of the names that a killed writer leaves behind, and that the next one removes


@dataclass(frozen=True)
class Verdict:
    """What came of an injection.

    Attributes:
        stage: The command.
        what: The fault, described so that it can be made again by hand.
        problem: What is wrong with what the command did; empty: nothing.
    """

    stage: str
    what: str
    problem: str


@dataclass
class Case:
    """The place of one injection.

    Attributes:
        originals: The undamaged files.
        folder: An empty folder.
        rng: Random numbers of this injection only.
    """

    originals: Originals
    folder: Path
    rng: np.random.Generator
    notes: list[str] = field(default_factory=list)

    def choose(self, items: Any) -> Any:
        """Return one of the items at random."""
        items = list(items)
        return items[int(self.rng.integers(len(items)))]

    def damage(self, name: str) -> Path:
        """Copy the file `name` here, and return the copy."""
        self.originals.copy(self.folder, (name,))
        return self.folder / name

    def run_stage(self, name: str, *more: object, **options: Any) -> Outcome:
        """Run a stage here, on inputs that are here."""
        stage = STAGES[name]
        return run(self.folder, command(*stage.words, "--out", stage.out, *more), **({"cpu_seconds": 90} | options))

    def judge_stage(self, name: str, outcome: Outcome, codes: tuple[int, ...] = (0, 3)) -> str:
        """Return what is wrong with how a stage ended, or with what it left behind."""
        stage = STAGES[name]
        problem = complaint(outcome, codes, self.originals.outcomes[name].resident)
        if problem:
            return problem
        out = self.folder / stage.out
        if outcome.code and out.exists():
            return f"leaves {stage.out} although it failed: {outcome.stderr.strip()[-200:]}"
        if not outcome.code:
            return self.judge_output(name)
        return self.judge_leftovers()

    def judge_output(self, name: str) -> str:
        """Return whether the stage's output differs from what an undisturbed run makes."""
        from tests.faults.originals import content_of

        out = self.folder / STAGES[name].out
        if not out.exists():
            return "exit code 0, but there is no output"
        if content_of(out) != self.originals.content[name]:
            return "silent: the output differs from that of an undisturbed run"
        return self.judge_leftovers()

    def judge_leftovers(self) -> str:
        """Return which temporary files were left behind."""
        left = [str(path.relative_to(self.folder)) for path in self.folder.rglob(f"*{TEMPORARY}*")]
        return f"leaves {left[0]}" if left else ""


Kind = Callable[[Case], Verdict]
KINDS: dict[str, tuple[Kind, float]] = {}


def kind(name: str, share: float) -> Callable[[Kind], Kind]:
    """Register a kind of injection.

    Args:
        name: Its name in the table.
        share: How many of 1,000 injections are of this kind.
    """

    def register(function: Kind) -> Kind:
        KINDS[name] = (function, share)
        return function

    return register
