"""The options of every command: its own configuration class, and the options that it shares with other commands."""

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
    TrainOptions,
    ViewOptions,
)
from stages.config.demonstrations import ExportConfig, ImportConfig
from stages.config.fields import Config, one_of, option
from stages.config.inventory import CleanConfig, ListConfig
from stages.config.names import TASKS
from stages.config.stages import STAGES

EXECUTORS = ("local", "slurm", "kubernetes")


@dataclass(frozen=True)
class ReportConfig(Config):
    """Configuration of report: the page that it writes."""

    title: str = option("Imitation from observation", "Heading of the page.")


@dataclass(frozen=True)
class ReproduceConfig(Config):
    """Configuration of reproduce: the grid of runs, and where they run."""

    only: str = option(",".join(TASKS), "Tasks, separated by commas.", metavar="TASKS", complete="tasks")
    methods: str = option(
        "",
        "Methods, separated by commas (default: the methods that the paper compares, and its ablations for reach and "
        "push).",
        metavar="METHODS",
        complete="methods",
    )
    contexts: int = option(10, "Contexts per task and method.", low=1)
    executor: str = option("local", "Where jobs run: a Snakemake executor.", EXECUTORS)
    cores: int = option(0, "Number of jobs that run in parallel, one core each (0: one per core).", low=0)

    def check_together(self) -> None:
        """Refuse unknown names of tasks and methods.

        Raises:
            UsageError: A name is unknown.
        """
        _ = self.tasks, self.chosen_methods

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of --only, each once."""
        return chosen("--only", self.only, TASKS)

    @property
    def chosen_methods(self) -> tuple[str, ...]:
        """The methods of --methods, each once; empty: the paper's methods."""
        from stages.reproduction.plan import METHODS

        return chosen("--methods", self.methods, tuple(METHODS))


def chosen(name: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names in a comma-separated list, each once.

    Raises:
        UsageError: A name is unknown.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    for word in names:
        if word not in known:
            raise UsageError(f"{name} {word!r}: expected a comma-separated choice of {one_of(known)}")
    return names


@dataclass(frozen=True)
class Command:
    """The classes that define the options of a command.

    Attributes:
        config: Class of the command's own options.
        shared: Class of the options that it shares with other commands.
        names: Names of the options in `shared` that the command has.
    """

    config: type[Config]
    shared: type[CommonOptions]
    names: tuple[str, ...]


_OUTPUT = ("out", "config", "show_config", "json", "quiet")
_STAGE = ("preset", "seed", "workers", "overwrite", *_OUTPUT)

# Training of experts and evaluation of policies run on the CPU: --device would have no effect there.
COMMANDS: dict[str, Command] = {
    "train-expert": Command(STAGES["train-expert"], CommonOptions, (*_STAGE, "resume")),
    "collect-demos": Command(STAGES["collect-demos"], CollectOptions, ("expert", *_STAGE)),
    "import-demos": Command(ImportConfig, ImportOptions, ("preview", "preset", "overwrite", *_OUTPUT)),
    "export-demos": Command(ExportConfig, ExportOptions, _OUTPUT),
    "train-translator": Command(STAGES["train-translator"], TrainOptions, ("base", *_STAGE, "device", "resume")),
    "translate": Command(STAGES["translate"], CommonOptions, (*_STAGE, "device")),
    "learn-policy": Command(STAGES["learn-policy"], CommonOptions, (*_STAGE, "device", "resume")),
    "evaluate": Command(STAGES["evaluate"], CommonOptions, _STAGE),
    "reproduce": Command(ReproduceConfig, ReproduceOptions, ("preset", "seed", "dry_run", *_OUTPUT)),
    "report": Command(ReportConfig, ReportOptions, _OUTPUT),
    "ls": Command(ListConfig, LookOptions, ("json",)),
    "gc": Command(CleanConfig, LookOptions, ("json",)),
    "view": Command(Config, ViewOptions, ("out", "open", "json", "quiet")),
    "inspect": Command(Config, LookOptions, ("json",)),
    "verify": Command(Config, LookOptions, ()),
    "check-task": Command(Config, CheckOptions, ("seed", "out", "json")),
    "doctor": Command(Config, LookOptions, ("json",)),
}
