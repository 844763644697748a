"""The kinds of artifact that each stage reads and writes. This is the only definition; it imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StageFiles:
    """The kind of artifact that a stage reads, if any, and the kind that it writes."""

    reads: str | None
    writes: str


# In the order of the pipeline. If two stages write the same kind, messages suggest the first.
STAGE_FILES: dict[str, StageFiles] = {
    "train-expert": StageFiles(None, "expert"),
    "collect-demos": StageFiles("expert", "demos"),
    "import-demos": StageFiles(None, "demos"),
    "train-translator": StageFiles("demos", "translator"),
    "translate": StageFiles("translator", "translation"),
    "learn-policy": StageFiles("translation", "policy"),
    "evaluate": StageFiles("policy", "evaluation"),
}

# The command that writes each kind, for error messages.
COMMANDS: dict[str, str] = {files.writes: f"ifo {stage}" for stage, files in reversed(STAGE_FILES.items())}
