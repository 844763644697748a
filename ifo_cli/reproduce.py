"""`ifo reproduce`: the paper's comparisons and ablations, by one command."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from artifacts.errors import UsageError
from ifo_cli.completion import complete_list
from ifo_cli.streams import emit, stdout_to_stderr
from stages.config.presets import DEFAULT_PRESET, PRESETS
from stages.config.stages import TASKS
from stages.reproduction.plan import METHODS, Grid

EXAMPLES = (
    "ifo reproduce --only reach,push --contexts 5 | ifo report",
    "ifo reproduce --only reach --methods translation,gail,gail-own --contexts 3 --dry-run",
    "ifo reproduce --executor slurm --cores 100 --out shared/grid",
)
NOTE = "Methods:\n\n" + "\n\n".join(f"  {name}: {method.help}" for name, method in METHODS.items())


def reproduce(
    context: typer.Context,
    only: Annotated[
        str,
        typer.Option(help="Tasks, separated by commas.", metavar="TASKS", autocompletion=complete_list(TASKS)),
    ] = ",".join(TASKS),
    methods: Annotated[
        str,
        typer.Option(
            help="Methods, separated by commas (default: the paper's comparison, and its ablations of reach and push).",
            metavar="METHODS",
            autocompletion=complete_list(tuple(METHODS)),
            show_default=False,
        ),
    ] = "",
    contexts: Annotated[int, typer.Option(help="Contexts a task and method.", min=1, metavar="INT")] = 10,
    preset: Annotated[
        Literal[tuple(PRESETS)],  # type: ignore[valid-type]
        typer.Option(help="Preset of every stage."),
    ] = DEFAULT_PRESET,
    seed: Annotated[int, typer.Option(help="Seed of every stage.", min=0, metavar="INT")] = 0,
    executor: Annotated[
        Literal["local", "slurm", "kubernetes"], typer.Option(help="Where jobs run; Snakemake's own plugins.")
    ] = "local",
    cores: Annotated[
        int, typer.Option(help="Jobs at a time, a core each (0: as many as there are cores).", min=0, metavar="INT")
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder of all files.", metavar="FOLDER")] = Path("runs/reproduce"),
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the jobs that would run, and an estimate of their minutes.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object in place of the folder.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No messages of ours on standard error.")] = False,
) -> None:
    """Run the paper's grid of tasks, methods and contexts as a Snakemake workflow over these very commands.

    Files that are there are not made again: run it again after an interruption, or with more contexts, or in a folder
    into which those of another machine were copied. A run that fails is tried once more, and does not stop the others.
    """
    grid = Grid(
        _chosen("--only", only, tuple(TASKS)), _chosen("--methods", methods, tuple(METHODS)), contexts, preset, seed
    )
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out} is a file: expected a folder")
    with stdout_to_stderr():
        from stages.reproduce import Execution, described, missing, reproduce
        from stages.reproduction.plan import plan
        from stages.reproduction.times import minutes
        from stages.runtime.devices import pick_workers
        from stages.runtime.progress import Progress

        cores = cores or pick_workers(0)
        if dry_run:
            jobs = missing(plan(grid), out)
            Progress(quiet=quiet).say(described(jobs, grid, cores))
            lines = [f"{minutes(job, preset):6.1f}  {shlex.join(['ifo', *job.words])}" for job in jobs]
        else:
            command = shlex.join(["ifo", *(context.find_root().obj or [])])
            result = reproduce(grid, out, Execution(executor, cores, command), Progress(quiet=quiet))
    if dry_run:
        for line in lines:
            emit(line)
    elif as_json:
        emit(json.dumps({"path": str(result.path), "kind": "reproduction", **result.summary}))
    else:
        emit(str(result.path))


def _chosen(option: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """The names in a comma-separated list, each once.

    Raises:
        UsageError: One is not known.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    for name in names:
        if name not in known:
            raise UsageError(f"{option} {name!r}: expected some of {', '.join(known)}, separated by commas")
    return names
