"""Mutation testing: break the code in a random sample of places and count how often the tests notice.

mutmut makes and runs the mutants. This script decides which ones: per group of modules a random sample, drawn with a
seed that is an argument, run against the tests that mirror the group. It writes the table in results/mutants.md.

    make mutants SEED=7        or        python tests/mutation/mutants.py --seed 7 --only gps --keep /tmp/gps
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
EXPLANATIONS = Path(__file__).with_name("explained.toml")
TABLE = REPOSITORY / "results" / "mutants.md"
TIMEOUT_SECONDS, TIMEOUT_FACTOR = 20.0, 3.0  # a mutant may take (the tests' own time + 20 s) * 3 of wall-clock time
PYTEST = ["-p", "no:cacheprovider", "-p", "tests.mutation.fastest_first"]
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE", "PYTHONHASHSEED": "0"}
NOT_CAUGHT = ("survived", "no tests", "skipped", "not checked")


@dataclass(frozen=True)
class Group:
    """Modules that are measured together.

    Attributes:
        name: Name of the group in the table.
        sources: Glob patterns of the modules, relative to the repository.
        chosen: Files and folders of tests; empty: the folders that mirror the modules' folders.
        also: More files and folders of tests.
        but: Names of matching modules that another group measures.
    """

    name: str
    sources: tuple[str, ...]
    chosen: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    but: tuple[str, ...] = ()

    def files(self, root: Path) -> list[Path]:
        """Return the modules, relative to `root`."""
        found = {path.relative_to(root) for pattern in self.sources for path in root.glob(pattern)}
        return sorted(path for path in found if path.stem not in ("__init__", *self.but))

    def tests(self, root: Path) -> list[str]:
        """Return the files and folders of tests.

        Raises:
            SystemExit: One of them does not exist.
        """
        mirrored = {f"tests/{path.parent}" for path in self.files(root)}
        tests = sorted({*(self.chosen or mirrored), *self.also})
        if missing := [test for test in tests if not (root / test).exists()]:
            raise SystemExit(f"{self.name}: {missing[0]} does not exist: name its tests in GROUPS")
        return tests


def modules(folder: str, *names: str) -> tuple[str, ...]:
    """Paths of some modules of a folder."""
    return tuple(f"{folder}/{name}.py" for name in names)


def tests(folder: str, *names: str) -> tuple[str, ...]:
    """Paths of some files of tests of a folder."""
    return tuple(f"tests/{folder}/test_{name}.py" for name in names)


STATISTICS, STATE = ("figures", "intervals"), ("checkpoints", "seeding", "trees")
TRAINING = ("augmentation", "optimiser", "train", "training")
GROUPS = (
    Group("losses", modules("stages/translation", "losses"), tests("stages/translation", "losses")),
    Group("metrics", modules("stages/translation", "metrics"), tests("stages/translation", "metrics")),
    Group("alignment", modules("stages/translation", "alignment"), tests("stages/translation", "alignment")),
    Group(
        "translator training",
        modules("stages/translation", "training", "augmentation"),
        tests("stages/translation", *TRAINING),
    ),
    Group("rewards", ("stages/rewards/*.py",)),
    Group("gps", ("stages/learners/gps/*.py",), also=tests("stages/learners", "policy")),
    Group(
        "evaluation",
        ("stages/evaluate.py", "stages/translation/evaluation.py"),
        tests("stages", "evaluate", "evaluate_stage") + tests("stages/translation", "evaluation"),
    ),
    Group(
        "statistics",
        modules("stages/reporting", *STATISTICS),
        tests("stages", "evaluate") + tests("stages/reporting", "intervals"),
    ),
    Group("reporting", ("stages/reporting/*.py",), but=STATISTICS),
    Group(
        "seeding and checkpoints",
        modules("stages/runtime", *STATE),
        tests("stages/runtime", *STATE, "resuming"),
    ),
    Group("artifacts", ("artifacts/*.py",)),
    Group("footage", ("stages/footage/*.py",), also=tests("stages", "import_demos")),
    Group("datasets", ("stages/datasets/*.py",), also=tests("stages", "export_demos")),
)


@dataclass(frozen=True)
class Mutant:
    """One change of one line.

    Attributes:
        name: mutmut's name of it.
        place: Module and function.
        before: The changed lines.
        after: What they are changed into.
        status: mutmut's word for what the tests made of it.
    """

    name: str
    place: str
    before: str
    after: str
    status: str

    @property
    def caught(self) -> bool:
        return self.status not in NOT_CAUGHT


@contextmanager
def workplace(keep: Path | None) -> Iterator[Path]:
    """An empty folder, deleted at the end unless the caller names one."""
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        yield keep
        return
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        yield Path(folder)


def copy_repository(target: Path, group: Group) -> None:
    """Copy what git knows of to `target`, with mutmut's settings for the group."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY, capture_output=True, check=True, text=True,
    )  # fmt: skip
    for name in filter(None, listed.stdout.split("\0")):
        if (REPOSITORY / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / name, target / name)
    also = sorted(path.name for path in target.iterdir() if path.name not in ("stages", "artifacts", "tests", ".git"))
    settings = {
        "source_paths": ["artifacts", "stages"],
        "only_mutate": [str(path) for path in group.files(target)],
        "also_copy": also,
        "pytest_add_cli_args_test_selection": group.tests(target),
        "pytest_add_cli_args": PYTEST,
        "timeout_multiplier": TIMEOUT_FACTOR,
        "timeout_constant": TIMEOUT_SECONDS,
        # torch's and MuJoCo's threads do not survive a fork of a process that has run tests.
        "process_isolation": "forkserver",
        "use_git_change_detection": False,
        "track_dependencies": False,
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    with (target / "pyproject.toml").open("a") as file:
        file.write("\n[tool.mutmut]\n" + "\n".join(lines) + "\n")


def all_mutants(folder: Path, group: Group) -> list[str]:
    """Names of all mutants of a group, in the order of its modules."""
    from mutmut.mutation.file_mutation import mutate_file_contents
    from mutmut.utils.format_utils import get_mutant_name

    return [
        get_mutant_name(path, name)
        for path in group.files(folder)
        for name in mutate_file_contents(str(path), (folder / path).read_text()).mutant_names
    ]


def run_mutants(folder: Path, names: list[str]) -> None:
    """Run the group's tests on the original and on each mutant.

    Raises:
        SystemExit: The tests fail on the original code, or mutmut does not finish.
    """
    command = [sys.executable, "-c", "from mutmut.__main__ import cli; cli()", "run", "--max-children", "1", *names]
    environment = os.environ | ENVIRONMENT
    log = folder / "mutmut.log"
    with log.open("w") as output:
        done = subprocess.run(command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, env=environment)
    if done.returncode:
        print(log.read_text()[-4000:], file=sys.stderr)
        raise SystemExit(f"mutmut ended with exit code {done.returncode}; its output is above")


def verdict_anew(folder: Path, name: str) -> str:
    """What the tests make of a mutant in a process of its own.

    A fork of a process that has imported torch and numba hangs now and then: no verdict but "killed" and "survived" of
    one is believed.
    """
    statistics = json.loads((folder / "mutants" / "mutmut-stats.json").read_text())
    tests = statistics["tests_by_mangled_function_name"][name.partition("__mutmut_")[0]]
    seconds = sum(statistics["duration_by_test"].get(test, 0.0) for test in tests)
    limit = math.ceil((seconds + TIMEOUT_SECONDS) * TIMEOUT_FACTOR)  # of CPU time: the machine may be busy
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--rootdir=.", *PYTEST, *tests]
    limited = ["bash", "-c", f'ulimit -t {limit}; exec "$@"', "bash", *command]
    environment = os.environ | ENVIRONMENT | {"MUTANT_UNDER_TEST": name}
    try:
        done = subprocess.run(
            limited, cwd=folder / "mutants", env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=10 * limit,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "timeout"
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return "timeout"
    return "survived" if done.returncode == 0 else "killed"


def results(folder: Path, group: Group, names: list[str]) -> list[Mutant]:
    """What became of each mutant."""
    from mutmut.mutation.data import SourceFileMutationData
    from mutmut.mutation.diff_apply import get_diff_for_mutant
    from mutmut.stats import status_by_exit_code
    from mutmut.utils.format_utils import orig_function_and_class_names_from_key

    found = []
    for path in group.files(folder):
        data = SourceFileMutationData(path=path)
        data.load()
        for name in (name for name in names if name in data.exit_code_by_key):
            lines = get_diff_for_mutant(name, path=path).splitlines()[2:]
            before, after = ("\n".join(line[1:].strip() for line in lines if line[0] == sign) for sign in "-+")
            function, owner = orig_function_and_class_names_from_key(name)
            place = f"{path}: {owner}.{function}" if owner else f"{path}: {function}"
            status = status_by_exit_code[data.exit_code_by_key[name]]
            if status not in ("killed", *NOT_CAUGHT):
                status = verdict_anew(folder, name)
            found.append(Mutant(name, place, before, after, status))
    return found


def measure(group: Group, size: int, seed: int, keep: Path | None) -> tuple[list[Mutant], int, float]:
    """Sample a group and run it: the sample's mutants, how many the group has, and the seconds taken."""
    started = time.monotonic()
    with workplace(keep) as folder:
        copy_repository(folder, group)
        before = Path.cwd()
        os.chdir(folder)  # mutmut reads its settings there
        try:
            from mutmut.configuration import reset_config

            reset_config()
            names = all_mutants(folder, group)
            chosen = random.Random(f"{seed}/{group.name}").sample(names, min(size, len(names)))
            run_mutants(folder, chosen)
            return results(folder, group, chosen), len(names), time.monotonic() - started
        finally:
            os.chdir(before)


def explanation(mutant: Mutant) -> str:
    """Why a mutant may survive, from explained.toml; empty where nothing is known."""
    for entry in tomllib.loads(EXPLANATIONS.read_text())["mutant"]:
        if entry["place"] == mutant.place and entry["after"] == mutant.after:
            return entry["because"]
    return ""


def page(measured: dict[str, tuple[list[Mutant], int, float]], seed: int) -> str:
    """results/mutants.md."""
    everything = [mutant for mutants, _, _ in measured.values() for mutant in mutants]
    caught = sum(mutant.caught for mutant in everything)
    lines = [
        "# Mutation testing",
        "",
        f"{caught} of {len(everything)} mutants killed ({caught / len(everything):.0%}).",
        "",
        f"`make mutants SEED={seed}`: of each group of modules a random sample of the mutants that mutmut can make,",
        "run against the tests that mirror these modules (not the end-to-end tests, which catch more). A mutant that",
        "makes the tests exceed their time limit counts as killed.",
        "",
        "| Modules | Mutants | Sampled | Killed | of these by time limit | Survived | Minutes |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, (mutants, count, seconds) in measured.items():
        got = Counter(mutant.status for mutant in mutants)
        killed = sum(mutant.caught for mutant in mutants)
        row = (count, len(mutants), killed, got["timeout"], len(mutants) - killed, f"{seconds / 60:.1f}")
        lines.append(f"| {name} | " + " | ".join(map(str, row)) + " |")
    survivors = [mutant for mutant in everything if not mutant.caught]
    lines += ["", "## Survivors", ""]
    for mutant in survivors:
        why = explanation(mutant) or "Unexplained."
        status = "" if mutant.status == "survived" else f" ({mutant.status})"
        lines += [f"`{mutant.place}`{status}: {why}", "", "```diff"]
        lines += [f"-{line}" for line in mutant.before.split("\n")] + [f"+{line}" for line in mutant.after.split("\n")]
        lines += ["```", ""]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, required=True, help="seed of the sample")
    parser.add_argument("--sample", type=int, default=32, help="mutants per group of modules")
    parser.add_argument("--only", action="append", choices=[group.name for group in GROUPS], help="measure this group")
    parser.add_argument("--keep", type=Path, help="work in this folder and keep it")
    parser.add_argument(
        "--out", type=Path, help="where the table goes (default: results/mutants.md, or standard output with --only)"
    )
    options = parser.parse_args()
    measured = {}
    for group in GROUPS:
        if options.only and group.name not in options.only:
            continue
        keep = options.keep and options.keep.resolve() / group.name.replace(" ", "-")
        measured[group.name] = measure(group, options.sample, options.seed, keep)
        mutants, count, seconds = measured[group.name]
        killed = sum(mutant.caught for mutant in mutants)
        print(f"{group.name}: {killed} of {len(mutants)} killed, {count} in all, {seconds:.0f} s", file=sys.stderr)
    out = options.out or (None if options.only else TABLE)
    text = page(measured, options.seed)
    if out is None:
        print(text)
    else:
        out.write_text(text)


if __name__ == "__main__":
    main()
