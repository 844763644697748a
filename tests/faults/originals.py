"""The undamaged files that injections start from, and how long each command takes undisturbed."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.faults.server import Outcome, command, start

TINY = ("--workers", 1, "--quiet")
NOTES = "undisturbed.json"
SLIDES = "tests.stages.environments.slides"  # a Gymnasium environment and its demonstrators
os.environ.setdefault("IFO_ENVS", f"{SLIDES}:Slide")  # files may name it


@dataclass(frozen=True)
class Stage:
    """A command that is run undisturbed once, and then with faults.

    Attributes:
        words: The command line without --out.
        out: File or folder that it writes.
        inputs: Files that it reads, the one named in the command first.
        checkpoints: Whether it writes a checkpoint next to `out` and accepts --resume.
        cheap: Whether it takes less than about a second.
    """

    words: tuple[object, ...]
    out: str
    inputs: tuple[str, ...] = ()
    checkpoints: bool = False
    cheap: bool = False

    @property
    def command(self) -> str:
        return str(self.words[0])

    @property
    def checkpoint(self) -> str:
        return self.out.removesuffix(".h5") + ".checkpoint.h5"


def learning(name: str, iterations: int, *words: object) -> Stage:
    """Return learn-policy with a method, with a checkpoint after each iteration."""
    episodes = () if "gps" in words else ("--episodes", 4)
    made = ("learn-policy", "x.translation.h5", "--iterations", iterations, "--checkpoint-every", 1, *episodes)
    parents = ("x.translation.h5", "x.translator.h5", "x.demos.h5")
    return Stage((*made, *TINY, *words), f"{name}.policy.h5", parents, checkpoints=True)


# evaluate reads from the ancestors of a policy how it was made.
EVALUATED = ("x.policy.h5", "x.translation.h5", "x.translator.h5", "x.demos.h5")
STAGES = {
    "train-expert": Stage(
        ("train-expert", "reach", "--preset", "toy", "--iterations", 4, "--checkpoint-every", 1, *TINY),
        "x.expert.h5",
        checkpoints=True,
    ),
    "collect-demos": Stage(
        ("collect-demos", "reach", "--preset", "toy", "--n", 8, "--expert", "x.expert.h5", *TINY),
        "x.demos.h5",
        ("x.expert.h5",),
    ),
    "train-translator": Stage(
        ("train-translator", "x.demos.h5", "--steps", 6, "--checkpoint-every", 2, *TINY),
        "x.translator.h5",
        ("x.demos.h5",),
        checkpoints=True,
    ),
    "train-translator --from": Stage(
        ("train-translator", "x.demos.h5", "--from", "x.translator.h5", "--steps", 4, "--checkpoint-every", 2, *TINY),
        "from.translator.h5",
        ("x.demos.h5", "x.translator.h5"),
        checkpoints=True,
    ),
    "translate": Stage(
        ("translate", "x.translator.h5", *TINY),
        "x.translation.h5",
        ("x.translator.h5", "x.demos.h5", "x.expert.h5"),
    ),
    "learn-policy trpo": learning("x", 4),
    "learn-policy ppo": learning("ppo", 3, "--learner", "ppo"),
    "learn-policy sac": learning("sac", 3, "--learner", "sac"),
    "learn-policy gps": learning("gps", 3, "--learner", "gps"),
    "learn-policy gail": learning("gail", 2, "--reward", "gail", "--discriminator-steps", 2),
    "learn-policy tpil": learning("tpil", 2, "--reward", "tpil", "--discriminator-steps", 2),
    "evaluate": Stage(("evaluate", "x.policy.h5", "--episodes", 2, *TINY), "x.evaluation.h5", EVALUATED),
    "collect-demos env": Stage(
        (
            *("collect-demos", f"env:{SLIDES}:Slide", "--demonstrator", f"{SLIDES}:go_right", "--preset", "toy"),
            *("--n", 8, "--size", "16x16", "--frames", 6, *TINY),
        ),
        "g.demos.h5",
    ),
    "train-translator env": Stage(
        ("train-translator", "g.demos.h5", "--steps", 4, "--checkpoint-every", 2, *TINY),
        "g.translator.h5",
        ("g.demos.h5",),
        checkpoints=True,
    ),
    "translate env": Stage(
        ("translate", "g.translator.h5", *TINY), "g.translation.h5", ("g.translator.h5", "g.demos.h5")
    ),
    "learn-policy env": Stage(
        ("learn-policy", "g.translation.h5", "--iterations", 3, "--checkpoint-every", 1, "--episodes", 4, *TINY),
        "g.policy.h5",
        ("g.translation.h5", "g.translator.h5", "g.demos.h5"),
        checkpoints=True,
    ),
    "evaluate env": Stage(
        ("evaluate", "g.policy.h5", "--episodes", 2, *TINY),
        "g.evaluation.h5",
        ("g.policy.h5", "g.translation.h5", "g.translator.h5", "g.demos.h5"),
    ),
    "import-demos": Stage(
        ("import-demos", "videos", "--frames", 5, "--size", "32x24"), "i.demos.h5", ("videos",), cheap=True
    ),
    "export-demos lerobot": Stage(
        ("export-demos", "x.demos.h5", "--format", "lerobot", "--quiet"), "lerobot", ("x.demos.h5",), cheap=True
    ),
    "export-demos robomimic": Stage(
        ("export-demos", "x.demos.h5", "--format", "robomimic", "--quiet"), "r.hdf5", ("x.demos.h5",), cheap=True
    ),
    "report": Stage(("report", "."), "report.html", ("x.evaluation.h5",)),
}  # fmt: skip

# A small grid: six jobs, one after the other.
GRID = "reproduce"
GRID_WORDS = (
    GRID, "--only", "reach", "--methods", "oracle", "--contexts", 1, "--preset", "toy", "--cores", 1, "--quiet",
)  # fmt: skip

# The command that reads a file of each kind.
CONSUMERS = {
    "x.expert.h5": "collect-demos",
    "x.demos.h5": "train-translator",
    "x.translator.h5": "translate",
    "x.translation.h5": "learn-policy trpo",
    "x.policy.h5": "evaluate",
    "x.evaluation.h5": "report",
}


class Originals:
    """Undamaged files in `folder`, and what making them took.

    Attributes:
        folder: Holds one file of every kind, checkpoints, videos and data sets.
        files: Names of the artifacts and checkpoints.
        outcomes: How each stage ended undisturbed.
        content: Content digest of each stage's artifact.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.outcomes: dict[str, Outcome] = {}
        self.content: dict[str, str] = {}
        self.took: dict[str, float] = {}
        self.files: list[str] = []

    @classmethod
    def made(cls, folder: Path, stages: Sequence[str] = tuple(STAGES), keep: Path | None = None) -> Originals:
        """Make the files, or copy those that an earlier run left in `keep`.

        Raises:
            SystemExit: A stage fails without any fault.
        """
        if keep and (keep / NOTES).exists():
            shutil.copytree(keep, folder)
            return cls.found(folder)
        originals = cls(folder)
        folder.mkdir(parents=True)
        make_videos(folder / "videos")
        for name in stages:
            if name == GRID:
                originals._make_grid()
                continue
            if not (folder / "x.demos.h5").exists() and (folder / "i.demos.h5").exists():
                shutil.copy(folder / "i.demos.h5", folder / "x.demos.h5")  # collect-demos was not asked for.
            originals._make(name)
        outcomes = {name: asdict(outcome) for name, outcome in originals.outcomes.items()}
        notes = {"outcomes": outcomes, "content": originals.content, "took": originals.took}
        (folder / NOTES).write_text(json.dumps(notes))
        if keep:
            shutil.copytree(folder, keep)
        return cls.found(folder)

    @classmethod
    def found(cls, folder: Path) -> Originals:
        """Return the files in a folder that `made` has filled."""
        originals = cls(folder)
        notes = json.loads((folder / NOTES).read_text())
        originals.outcomes = {name: Outcome(**outcome) for name, outcome in notes["outcomes"].items()}
        originals.content, originals.took = notes["content"], notes["took"]
        originals.files = sorted(path.name for path in folder.glob("*.h5"))
        return originals

    def _make(self, name: str) -> None:
        """Run a stage undisturbed, and keep a copy of one of its checkpoints."""
        stage = STAGES[name]
        started = time.monotonic()
        child = start(self.folder, command(*stage.words, "--out", stage.out), cpu_seconds=300)
        kept = self.folder / f"kept-{stage.checkpoint}"
        while child.running():
            if stage.checkpoints and not kept.exists() and (self.folder / stage.checkpoint).exists():
                with suppress(FileNotFoundError):  # The stage has just ended.
                    os.link(self.folder / stage.checkpoint, kept)
            time.sleep(0.002)
        self.took[name] = time.monotonic() - started
        outcome = child.wait(600)
        if outcome.code:
            raise SystemExit(f"{name} fails undisturbed: {outcome.stderr}")
        self.outcomes[name] = outcome
        self.content[name] = content_of(self.folder / stage.out)

    def _make_grid(self) -> None:
        started = time.monotonic()
        outcome = start(self.folder, command(*GRID_WORDS, "--out", GRID), cpu_seconds=300).wait(600)
        if outcome.code:
            raise SystemExit(f"{GRID} fails undisturbed: {outcome.stderr}")
        self.took[GRID] = time.monotonic() - started

    def copy(self, folder: Path, names: tuple[str, ...]) -> None:
        """Copy files and folders to a new folder."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            if (self.folder / name).is_dir():
                shutil.copytree(self.folder / name, folder / name)
            else:
                shutil.copy(self.folder / name, folder / name)

    def parents(self, name: str) -> tuple[str, ...]:
        """Return those inputs of the stage that made a file that are here."""
        inputs = next((stage.inputs for stage in STAGES.values() if stage.out == name), ())
        return tuple(name for name in inputs if (self.folder / name).exists())


def content_of(path: Path) -> str:
    """Return a digest of what a stage made: of an artifact its content, of other files their names."""
    from artifacts import read_artifact

    if path.suffix == ".h5":
        return read_artifact(path).content
    return "\n".join(sorted(str(file.relative_to(path)) for file in path.rglob("*"))) if path.is_dir() else path.name


def make_videos(folder: Path, count: int = 4, frames: int = 12) -> None:
    """Write small videos with moving content."""
    import av

    folder.mkdir()
    texture = np.random.default_rng(0).integers(0, 255, (6, 20, 3)).repeat(8, 0).repeat(8, 1).astype(np.uint8)
    for number in range(count):
        with av.open(str(folder / f"{number}.mp4"), "w") as container:
            stream = container.add_stream("libx264", rate=25, options={"g": "6", "threads": "1"})
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            for step in range(frames):
                left = 2 * step + 8 * number
                picture = np.ascontiguousarray(texture[:, left : left + 64])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
