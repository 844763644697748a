"""Makes results/real.csv and real.md: the household tasks, from footage to policies, beside two baselines (Sec. VI.D).

    python results/real.py

A person is filmed (as many demonstrations as the paper has, of the ladle 180 in place of 60; MP4s at crf 23), the
footage is imported, a translator is trained on it, and in each of five contexts guided policy search learns from the
translation; with three searches that begin apart; from its features alone (as in the paper); from the translation of
the paper's own network (which asks for a GPU: without one, only where runs/real has its translators); from features of
an ImageNet network; from one demonstration's joint angles; and from the true state.
Finished artifacts, in runs/real, are not made again; the tables are of all evaluations in results/real.
"""

from __future__ import annotations

import argparse
import os
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from commands import ifo, runs_of

from artifacts import stem_of
from stages.config.stages import HOUSEHOLD
from stages.reporting.intervals import wilson
from stages.reporting.names import marked
from stages.reporting.paper import ROBOT
from stages.reporting.rows import COLUMNS, Run, csv_text, row
from stages.simulation.gl import choose_backend

HERE = Path(os.path.relpath(Path(__file__).parent))
REAL, EVALUATIONS = Path("runs/real"), HERE / "real"
CONTEXTS = 5
# Options; "": of all tasks without their own. A mirrored ladle tips to the other side.
TRANSLATOR: dict[str, tuple[object, ...]] = {
    "": ("--augment", "--no-swap-colours", "--mirror"),
    "ladle-almonds": ("--augment", "--no-swap-colours"),
}
# The paper's network for real images, for a third of its steps (its rate is constant): on an H100 8 minutes a task,
# four tasks side by side.
NETWORK = ("--preset", "paper", "--arch", "real", "--steps", 21_000, "--compile")
METHODS: dict[str, tuple[object, ...]] = {
    "translation": (),
    "starts": ("--starts", 3),
    "features": ("--without", "img"),
    "network": (),
    "pretrained": ("--reward", "pretrained"),
    "joints": ("--reward", "joints"),
    "oracle": ("--reward", "oracle"),
}
MEANINGS = {
    "translation": "what is tracked are the translation's images and features",
    "starts": "the same, by three searches that begin apart, of which the cheapest goes on after half of the episodes",
    "features": "the translation's features alone, as in the paper",
    "network": "images and features of the translation by the paper's own network for real images, trained on a GPU",
    "pretrained": "features of a network that was trained on ImageNet, not translated",
    "joints": "the joint angles of one demonstration",
    "oracle": "the true state",
}


def place(preset: tuple[object, ...]) -> Path:
    """Where files lie; what was only tried lies apart."""
    return REAL / "toy" if preset else REAL


def suffix(method: str) -> str:
    """What the names of a method's translators and translations end in."""
    return "-network" if method == "network" else ""


def translator(task: str, method: str, preset: tuple[object, ...]) -> Path:
    """Film, import, train."""
    folder = place(preset)
    demos = folder / f"{task}.demos.h5"
    if not demos.exists():
        filmed = folder / f"{task}-filmed.demos.h5"
        ifo("collect-demos", task, "--videos", folder / task, "--workers", 1, *preset, out=filmed)
        ifo("import-demos", folder / task, "--task", task, *preset, out=demos)
    options = TRANSLATOR.get(task, TRANSLATOR[""])
    words = ("train-translator", demos, *options, "--workers", 1, "--resume")
    network = (NETWORK if not preset else (*preset, "--arch", "real")) if suffix(method) else preset
    return ifo(*words, *network, out=folder / f"{task}{suffix(method)}.translator.h5")


def translate(model: Path, task: str, method: str, seed: int, preset: tuple[object, ...]) -> Path:
    """The demonstrations in context `seed`."""
    words = ("translate", model, "--split", "all", "--context-seed", seed, "--workers", 1)
    out = place(preset) / f"{task}{suffix(method)}-c{seed}.translation.h5"
    return ifo(*words, *(preset or ("--preset", "quick")), out=out)


def learn(task: str, method: str, seed: int, preset: tuple[object, ...]) -> Path:
    """One run and its evaluation."""
    folder = place(preset)
    translation = folder / f"{task}{suffix(method)}-c{seed}.translation.h5"
    words = ("learn-policy", translation, "--learner", "gps", *METHODS[method], "--workers", 1, "--resume")
    policy = ifo(*words, *preset, out=folder / f"{task}-{method}-c{seed}.policy.h5")
    return ifo(
        "evaluate",
        policy,
        "--workers",
        1,
        *preset,
        out=(folder if preset else EVALUATIONS) / f"{stem_of(policy)}.evaluation.h5",
    )


def markdown(cells: dict[tuple[str, str], list[Run]]) -> str:
    """The table of cells."""
    lines = [
        "<!-- made by results/real.py -->",
        "# Household tasks",
        "",
        "| task | method | runs | success [95%] | mean fraction | episodes | minutes | the paper's robot |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for (task, method), runs in cells.items():
        low, high = wilson(sum(run.success for run in runs), len(runs))
        rate = np.mean([run.success for run in runs])
        fraction = np.mean([1 - run.normalised_distance for run in runs])
        minutes = np.mean([run.recorded["learning_minutes"] for run in runs])
        episodes = np.mean([run.recorded["iterations"] * run.recorded["episodes"] for run in runs])
        # What is learned from a translation, in whatever way, stands beside the paper's method.
        reward = runs[0].recorded["reward"]
        paper = None if any(run.unknown for run in runs) else ROBOT.get((task, reward))
        lines.append(
            f"| {task} | {method} | {len(runs)} | {rate:.2f} [{low:.2f}, {high:.2f}] | {fraction:.2f} | {episodes:.0f} "
            f"| {minutes:.1f} | {'-' if paper is None else f'{paper:.2f}'} |"
        )
    lines += ["", "The paper's robot: the success of push-real, the mean fraction of the other tasks.", ""]
    shown = {method for _, method in cells}
    lines += [f"- {method}: {meaning}." for method, meaning in MEANINGS.items() if method in shown]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parallel", type=int, default=2, help="runs side by side")
    parser.add_argument("--only", nargs="*", default=list(HOUSEHOLD), choices=HOUSEHOLD, help="tasks to run")
    parser.add_argument("--methods", nargs="*", default=list(METHODS), choices=METHODS, help="methods to run")
    parser.add_argument("--contexts", type=int, default=CONTEXTS, help="contexts a task and method")
    parser.add_argument("--toy", action="store_true", help="preset toy, to try this script; writes no table")
    arguments = parser.parse_args()
    choose_backend()
    preset = ("--preset", "toy") if arguments.toy else ()
    folder = place(preset)
    for each in (folder, EVALUATIONS):
        each.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.contexts)
    methods = list(arguments.methods)
    if "network" in methods and not preset and not torch.cuda.is_available():
        missing = [task for task in arguments.only if not (folder / f"{task}-network.translator.h5").exists()]
        if missing:
            print(f"the paper's network needs a GPU: left out, for {', '.join(missing)} has no translator of it")
            methods.remove("network")
    with ThreadPoolExecutor(arguments.parallel) as pool:
        for method in {suffix(method): method for method in methods}.values():
            trained = list(pool.map(lambda task, method=method: translator(task, method, preset), arguments.only))
            for (task, model), seed in (
                (each, seed) for each in zip(arguments.only, trained, strict=True) for seed in seeds
            ):
                translate(model, task, method, seed, preset)
        jobs = [(task, method, seed) for method in methods for task in arguments.only for seed in seeds]
        list(pool.map(lambda job: learn(*job, preset), jobs))
    if arguments.toy:
        return
    cells: dict[tuple[str, str], list[Run]] = defaultdict(list)
    for task, method in ((task, method) for task in HOUSEHOLD for method in METHODS):
        for path in sorted(EVALUATIONS.glob(f"{task}-{method}-c*.evaluation.h5")):
            for run in runs_of(path, METHODS[method]):
                cells[task, marked(method, run.recorded)].append(run)
    rows = [
        {**row(run), "method": method, "fraction": round(1 - run.normalised_distance, 4)}
        for (_, method), runs in cells.items()
        for run in runs
    ]
    (HERE / "real.csv").write_text(csv_text((*COLUMNS, "fraction"), rows), encoding="utf-8", newline="")
    (HERE / "real.md").write_text(markdown(cells), encoding="utf-8")


if __name__ == "__main__":
    main()
