"""The paper's grid of learning runs as jobs: each one command, with the files that it reads and the one it writes."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from stages.config.stages import TASKS

WHOLE, BLANK, OWN = "whole", "blank", "own"


@dataclass(frozen=True)
class Method:
    """How the runs of a method are made.

    Attributes:
        help: What it is, for people.
        translator: Which translator stands behind them: `whole`; `blank`, whose weights stay random, where the reward
            needs none; `own`, a blank one behind demonstrations in the learner's own context; or, by another name, one
            that is trained with `train`.
        train: Options of train-translator.
        learn: Options of learn-policy.
    """

    help: str
    translator: str = WHOLE
    train: tuple[str, ...] = ()
    learn: tuple[str, ...] = ()


METHODS: dict[str, Method] = {
    "oracle": Method("the true distance as reward", BLANK, learn=("--reward", "oracle")),
    "translation": Method("the paper's method"),
    "pretrained": Method("features of an ImageNet network, untranslated", BLANK, learn=("--reward", "pretrained")),
    "tpil": Method("third-person imitation", BLANK, learn=("--reward", "tpil")),
    "gail": Method("GAIL on images", BLANK, learn=("--reward", "gail")),
    "joints": Method("joint angles of one demonstration in another context", BLANK, learn=("--reward", "joints")),
    "tpil-own": Method("TPIL, demonstrations in the learner's own context", OWN, learn=("--reward", "tpil")),
    "gail-own": Method("GAIL, demonstrations in the learner's own context", OWN, learn=("--reward", "gail")),
    "random": Method("a translator of random weights", BLANK),
    "without-feat": Method("no R_feat", learn=("--without", "feat")),
    "without-img": Method("no R_img", learn=("--without", "img")),
    "without-trans": Method("no L_trans", "without-trans", train=("--without", "trans")),
    "without-rec": Method("no L_rec", "without-rec", train=("--without", "rec")),
    "without-align": Method("no L_align", "without-align", train=("--without", "align")),
    "without-rec-align": Method(
        "no L_rec, no L_align", "without-rec-align", train=("--without", "rec", "--without", "align")
    ),
    "no-blur": Method("R_img without blurred images, as the paper has it", learn=("--blur", "0")),
}
COMPARED = ("oracle", "translation", "pretrained", "tpil", "gail")
# What the paper ablates, a task (Sec. VI.C).
ABLATED = {
    "reach": ("without-feat", "without-img", "without-trans", "without-rec", "without-rec-align"),
    "push": ("without-feat", "without-img"),
}

OWN_DEMOS = {"quick": ("-n", "1024"), "paper": ("-n", "1024")}  # of one context, fewer show as much


@dataclass(frozen=True)
class Job:
    """One command.

    Attributes:
        stage: The subcommand.
        task: What it is about.
        words: The command line, after `ifo`.
        inputs, output: File names, in the folder where all of them lie.
    """

    stage: str
    task: str
    words: tuple[str, ...]
    inputs: tuple[str, ...]
    output: str

    @property
    def name(self) -> str:
        """A name of letters, digits and underscores, its own among the jobs."""
        return self.output.removesuffix(".h5").replace("-", "_").replace(".", "_")

    @property
    def command(self) -> str:
        """What a shell runs."""
        return shlex.join([sys.executable, "-m", "ifo_cli", *self.words])


@dataclass(frozen=True)
class Grid:
    """Which runs to make.

    Attributes:
        tasks: Names of tasks.
        methods: Names in METHODS; empty: those of the paper's comparison and, where it has some, its ablations.
        contexts: Contexts a task and method, of seeds 0, 1, ...
        preset, seed: As of every stage.
    """

    tasks: tuple[str, ...] = TASKS
    methods: tuple[str, ...] = ()
    contexts: int = 10
    preset: str = "quick"
    seed: int = 0

    def methods_of(self, task: str) -> tuple[str, ...]:
        """The methods that are run on a task."""
        return self.methods or (*COMPARED, *ABLATED.get(task, ()))


def plan(grid: Grid) -> list[Job]:
    """All jobs of a grid, each after those whose files it reads. The evaluations are what is wanted of it."""
    jobs: dict[str, Job] = {}
    for task in grid.tasks:
        for method in grid.methods_of(task):
            for seed in range(grid.contexts):
                jobs |= {job.output: job for job in _run(grid, task, method, seed)}
    return list(jobs.values())


def _run(grid: Grid, task: str, name: str, seed: int) -> Iterator[Job]:
    """The jobs behind one learning run, from the expert on; runs share what has the same name."""
    method = METHODS[name]
    common = ("--preset", grid.preset, "--seed", str(grid.seed), "--workers", "1")
    expert = f"{task}.expert.h5"

    def job(stage: str, words: Sequence[str], inputs: tuple[str, ...], output: str) -> Job:
        return Job(stage, task, (stage, *words, *common, "--out", output), inputs, output)

    yield job("train-expert", (task, "--resume"), (), expert)
    own = method.translator == OWN
    stem = f"{task}-own-c{seed}" if own else task
    where = (*OWN_DEMOS.get(grid.preset, ()), "--context-seed", str(seed)) if own else ()
    demos = f"{stem}.demos.h5"
    yield job("collect-demos", (task, "--expert", expert, *where), (expert,), demos)
    kind = BLANK if own else method.translator
    translator = f"{stem}-{kind}.translator.h5"
    train = ("--steps", "0") if kind == BLANK else (*method.train, "--resume")
    yield job("train-translator", (demos, *train), (demos,), translator)
    translation = f"{stem}-{kind}.translation.h5" if own else f"{stem}-{kind}-c{seed}.translation.h5"
    yield job("translate", (translator, "--context-seed", str(seed)), (translator,), translation)
    policy = f"{task}-{name}-c{seed}.policy.h5"
    yield job("learn-policy", (translation, *method.learn, "--resume"), (translation,), policy)
    yield job("evaluate", (policy,), (policy,), f"{task}-{name}-c{seed}.evaluation.h5")


def wanted(jobs: Sequence[Job]) -> list[Job]:
    """The jobs whose files are what a grid is made for."""
    return [job for job in jobs if job.stage == "evaluate"]
