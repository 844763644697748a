"""`ifo reproduce`: run the paper's comparisons and ablations with one command."""

from __future__ import annotations

import os
import shlex

from artifacts.errors import UsageError
from ifo_cli.options import Given, stage_command
from ifo_cli.runner import command_line, emit_result, settled_alone
from ifo_cli.streams import emit, stdout_to_stderr
from stages.reproduction.plan import METHODS, Grid

EXAMPLES = (
    "ifo reproduce --only reach,push --contexts 5 | ifo report",
    "ifo reproduce --only reach --methods translation,gail,gail-own --contexts 3 --dry-run",
    "ifo reproduce --executor slurm --cores 100 --out shared/grid",
)
NOTE = "Methods:\n\n" + "\n\n".join(f"  {name}: {method.help}" for name, method in METHODS.items())


@stage_command("reproduce")
def reproduce(given: Given) -> None:
    """Run the paper's grid of tasks, methods and contexts, as a Snakemake workflow over the other commands.

    Files that exist are not made again. You can therefore run the command again after an interruption, with more
    contexts, or after you have copied files from another machine into the folder. A run that fails is tried once more,
    and does not stop the others.
    """
    settled = settled_alone(given)
    if settled is None:
        return
    config, preset = settled.config, settled.settings["preset"]
    out, quiet, dry_run = given.get("out"), given.get("quiet"), given.get("dry_run")
    grid = Grid(config.tasks, config.chosen_methods, config.contexts, preset, settled.settings["seed"])
    if os.path.exists(out) and not os.path.isdir(out):
        raise UsageError(f"--out {out} is a file: expected a folder")
    with stdout_to_stderr():
        from stages.reproduce import Execution, described, missing, reproduce
        from stages.reproduction.plan import plan
        from stages.reproduction.times import minutes
        from stages.runtime.devices import pick_workers
        from stages.runtime.progress import Progress

        cores = config.cores or pick_workers(0)
        if dry_run:
            jobs = missing(plan(grid), out)
            Progress(quiet=quiet).say(described(jobs, grid, cores))
            lines = [f"{minutes(job, preset):6.1f}  {shlex.join(['ifo', *job.words])}" for job in jobs]
        else:
            execution = Execution(config.executor, cores, command_line(given))
            result = reproduce(grid, out, execution, Progress(quiet=quiet))
    if dry_run:
        for line in lines:
            emit(line)
    else:
        emit_result(given, result, "reproduction")
