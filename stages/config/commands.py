"""The options of every command: its own configuration class, and those that it shares with others."""

from __future__ import annotations

from dataclasses import dataclass

from artifacts.errors import UsageError
from stages.config.common import (
    CheckOptions,
    CollectOptions,
    CommonOptions,
    ExportOptions,
    ImportOptions,
    LookOptions,
    ReportOptions,
    ReproduceOptions,
)
from stages.config.demonstrations import ExportConfig, ImportConfig
from stages.config.fields import Config, one_of, option
from stages.config.names import TASKS
from stages.config.stages import STAGES

EXECUTORS = ("local", "slurm", "kubernetes")


@dataclass(frozen=True)
class ReportConfig(Config):
    """The page that report writes."""

    title: str = option("Imitation from observation", "Heading of the page.")


@dataclass(frozen=True)
class ReproduceConfig(Config):
    """The grid that reproduce runs, and where."""

    only: str = option(",".join(TASKS), "Tasks, separated by commas.", metavar="TASKS", complete="tasks")
    methods: str = option(
        "",
        "Methods, separated by commas (default: those that the paper compares, and its ablations of reach and push).",
        metavar="METHODS",
        complete="methods",
    )
    contexts: int = option(10, "Contexts per task and method.", low=1)
    executor: str = option("local", "Where jobs run; Snakemake's own plugins.", EXECUTORS)
    cores: int = option(0, "Jobs at a time, one core each (0: as many as there are cores).", low=0)

    def check_together(self) -> None:
        """Refuse names of tasks and methods that there are not.

        Raises:
            UsageError: One line.
        """
        _ = self.tasks, self.chosen_methods

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of --only, each once."""
        return chosen("--only", self.only, TASKS)

    @property
    def chosen_methods(self) -> tuple[str, ...]:
        """The methods of --methods, each once; empty: the paper's."""
        from stages.reproduction.plan import METHODS

        return chosen("--methods", self.methods, tuple(METHODS))


def chosen(name: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """The names in a comma-separated list, each once.

    Raises:
        UsageError: One is not known.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    for word in names:
        if word not in known:
            raise UsageError(f"{name} {word!r}: expected a comma-separated choice of {one_of(known)}")
    return names


@dataclass(frozen=True)
class Command:
    """What the options of a command are made of.

    Attributes:
        config: The class of its own options.
        shared: The class of the options that it shares with other commands.
        names: Those of `shared` that it has.
    """

    config: type[Config]
    shared: type[CommonOptions]
    names: tuple[str, ...]


_OUTPUT = ("out", "config", "show_config", "json", "quiet")
_STAGE = ("preset", "seed", "workers", "overwrite", *_OUTPUT)

# Experts learn, and policies are evaluated, on the CPU: --device would have no effect there.
COMMANDS: dict[str, Command] = {
    "train-expert": Command(STAGES["train-expert"], CommonOptions, (*_STAGE, "resume")),
    "collect-demos": Command(STAGES["collect-demos"], CollectOptions, ("expert", *_STAGE)),
    "import-demos": Command(ImportConfig, ImportOptions, ("preview", "preset", "overwrite", *_OUTPUT)),
    "export-demos": Command(ExportConfig, ExportOptions, _OUTPUT),
    "train-translator": Command(STAGES["train-translator"], CommonOptions, (*_STAGE, "device", "resume")),
    "translate": Command(STAGES["translate"], CommonOptions, (*_STAGE, "device")),
    "learn-policy": Command(STAGES["learn-policy"], CommonOptions, (*_STAGE, "device", "resume")),
    "evaluate": Command(STAGES["evaluate"], CommonOptions, _STAGE),
    "reproduce": Command(ReproduceConfig, ReproduceOptions, ("preset", "seed", "dry_run", *_OUTPUT)),
    "report": Command(ReportConfig, ReportOptions, _OUTPUT),
    "inspect": Command(Config, LookOptions, ("json",)),
    "verify": Command(Config, LookOptions, ()),
    "check-task": Command(Config, CheckOptions, ("seed", "out", "json")),
    "doctor": Command(Config, LookOptions, ("json",)),
}
