"""The paper's grid of learning runs as jobs: one command each, with the files that it reads and the one it writes."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from stages.config.presets import DEFAULT_PRESET
from stages.config.stages import TASKS
from stages.reporting.names import method_name, short_name

WHOLE, BLANK, OWN = "whole", "blank", "own"


@dataclass(frozen=True)
class Method:
    """How the runs of a method are made, and, by `stages.reporting.names`, what they are called.

    Attributes:
        help: What it is, for people.
        reward: Of learn-policy.
        without: Terms of the reward that are left out.
        losses_off: Losses of the translator that are switched off.
        trained: Whether the translator behind the reward is trained.
        own_context: Whether the demonstrations are recorded in the learner's context.
        more: Further options of learn-policy.
        named: Its name, where that does not follow from the above.
    """

    help: str
    reward: str = "translation"
    without: tuple[str, ...] = ()
    losses_off: tuple[str, ...] = ()
    trained: bool = True
    own_context: bool = False
    more: tuple[str, ...] = ()
    named: str = ""

    @property
    def label(self) -> str:
        """What the report calls it."""
        steps = 1 if self.trained else 0
        return method_name(
            {
                "reward": self.reward,
                "without": self.without,
                "own_context": self.own_context,
                "translator": {"steps": steps, "without": self.losses_off},
            }
        )

    @property
    def name(self) -> str:
        """What file names and the command line call it."""
        return self.named or short_name(self.label)

    @property
    def translator(self) -> str:
        """Which translator stands behind the runs.

        `whole`; `blank`, of random weights, where the reward needs none; `own`, a blank one behind demonstrations in
        the learner's own context; or one of its own, by the method's name.
        """
        if self.own_context:
            return OWN
        if self.losses_off:
            return self.name
        return WHOLE if self.trained and self.reward == "translation" else BLANK

    @property
    def train(self) -> tuple[str, ...]:
        """Options of train-translator."""
        return tuple(word for loss in self.losses_off for word in ("--without", loss))

    @property
    def learn(self) -> tuple[str, ...]:
        """Options of learn-policy."""
        reward = () if self.reward == "translation" else ("--reward", self.reward)
        return (*reward, *(word for term in self.without for word in ("--without", term)), *self.more)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("the true distance as reward", "oracle"),
        Method("the paper's method"),
        Method("features of an ImageNet network, untranslated", "pretrained"),
        Method("third-person imitation", "tpil"),
        Method("GAIL on images", "gail"),
        Method("joint angles of one demonstration in another context", "joints"),
        Method("TPIL, demonstrations in the learner's own context", "tpil", own_context=True),
        Method("GAIL, demonstrations in the learner's own context", "gail", own_context=True),
        Method("a translator of random weights", trained=False),
        Method("no R_feat", without=("feat",)),
        Method("no R_img", without=("img",)),
        Method("no L_trans", losses_off=("trans",)),
        Method("no L_rec", losses_off=("rec",)),
        Method("no L_align", losses_off=("align",)),
        Method("no L_rec, no L_align", losses_off=("rec", "align")),
        Method("R_img without blurred images, as the paper has it", more=("--blur", "0"), named="no-blur"),
    )
}
COMPARED = ("oracle", "translation", "pretrained", "tpil", "gail")
# The paper's ablations of each task (Sec. VI.C).
ABLATED = {
    "reach": ("without-feat", "without-img", "without-trans", "without-rec", "without-rec-align"),
    "push": ("without-feat", "without-img"),
}

OWN_DEMOS = {"quick": ("-n", "1024"), "paper": ("-n", "1024")}  # a single context needs fewer


@dataclass(frozen=True)
class Job:
    """One command.

    Attributes:
        stage: The subcommand.
        task: Name of the task.
        words: The command line, after `ifo`.
        inputs, output: File names in the grid's folder.
    """

    stage: str
    task: str
    words: tuple[str, ...]
    inputs: tuple[str, ...]
    output: str

    @property
    def name(self) -> str:
        """A unique name of letters, digits and underscores."""
        return self.output.removesuffix(".h5").replace("-", "_").replace(".", "_")

    @property
    def command(self) -> str:
        """The command line for a shell."""
        return shlex.join([sys.executable, "-m", "ifo_cli", *self.words])


@dataclass(frozen=True)
class Grid:
    """The runs to make.

    Attributes:
        tasks: Names of tasks.
        methods: Names in METHODS; empty: those of the paper's comparison, and its ablations of the task.
        contexts: Contexts per task and method, with seeds 0, 1, ...
        preset, seed: Of every stage.
    """

    tasks: tuple[str, ...] = TASKS
    methods: tuple[str, ...] = ()
    contexts: int = 10
    preset: str = DEFAULT_PRESET
    seed: int = 0

    def methods_of(self, task: str) -> tuple[str, ...]:
        """The methods that are run on a task."""
        return self.methods or (*COMPARED, *ABLATED.get(task, ()))


def plan(grid: Grid) -> list[Job]:
    """All jobs of a grid, each after the jobs whose files it reads. The evaluations are its results."""
    jobs: dict[str, Job] = {}
    for task in grid.tasks:
        for method in grid.methods_of(task):
            for seed in range(grid.contexts):
                jobs |= {job.output: job for job in _run(grid, task, method, seed)}
    return list(jobs.values())


def _run(grid: Grid, task: str, name: str, seed: int) -> Iterator[Job]:
    """The jobs behind one learning run, from the expert on; runs share files of the same name."""
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
    """The jobs that write the results of a grid."""
    return [job for job in jobs if job.stage == "evaluate"]
