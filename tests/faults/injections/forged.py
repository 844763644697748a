"""Files by hostile or careless authors: the digests are right, the content is not."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.case import Case, Verdict, kind
from tests.faults.originals import CONSUMERS, STAGES
from tests.faults.server import command, complaint, run

STAGE_SHARE = 0.25
MOST_DIGESTED = 64 << 20  # bytes; a hostile shape would keep the harness itself busy
FLOATS = ("x.expert.h5", "x.translator.h5", "x.translation.h5", "x.policy.h5", "gps.policy.h5", "sac.policy.h5")
DEEP = "[" * 20_000 + "]" * 20_000
TEXTS = (
    "", "\0", "a\nb", "\x1b[31mred", "\u202e", "x" * 100_000, "../" * 2_000, "/dev/zero", "/dev/full", "é" * 255,
    "<script>alert(1)</script>", "=1+1", "{0.__class__}", "%s%n", "|", "nan", "9" * 5_000, "\ud800",
)  # fmt: skip
NUMBERS = (0, -1, 1, 2**31, 2**63 - 1, -(2**63), 10**30, 1e308, -0.0, float("nan"), float("inf"), 1_000_000, 0.5)


def value(case: Case, depth: int = 0) -> Any:
    """Return a random JSON value of the awkward sort."""
    pick = case.rng.random()
    if pick < 0.35:
        return case.choose(NUMBERS)
    if pick < 0.7:
        return case.choose(TEXTS)
    if pick < 0.8:
        return case.choose((None, True, False))
    if depth > 2 or pick < 0.85:
        return case.choose(([], {}, [[]], {"": {}}))
    count = int(case.rng.integers(1, 4))
    if pick < 0.95:
        return [value(case, depth + 1) for _ in range(count)]
    return {str(case.choose(TEXTS))[:50]: value(case, depth + 1) for _ in range(count)}


def forge(
    path: Path,
    *,
    datasets: Callable[[Any], None] | None = None,
    attributes: Callable[[dict[str, Any]], None] | None = None,
) -> None:
    """Change a file's datasets or its manifest, and make the digests in the manifest right again."""
    import h5py

    from artifacts import hdf5
    from artifacts.schema import DIGEST, attributes_digest

    with h5py.File(path, "r+") as file:
        found = hdf5.read_attributes(file)
        if datasets:
            datasets(file)
            listed = json.loads(str(found["datasets"]))
            for name in listed:
                # What cannot be digested keeps its old digest.
                with suppress(Exception):
                    if file[name].size * file[name].dtype.itemsize <= MOST_DIGESTED and not has_short_chunk(file[name]):
                        listed[name] = hdf5.dataset_digest(file[name])
            found["datasets"] = json.dumps(listed)
        if attributes:
            attributes(found)
        found.pop(DIGEST, None)
        try:
            found[DIGEST] = attributes_digest(found)
        except (TypeError, ValueError, UnicodeError):
            found[DIGEST] = "0" * 64
        for name in list(file.attrs):
            del file.attrs[name]
        for name, item in found.items():
            write_attribute(file, name, item)


def has_short_chunk(dataset: Any) -> bool:
    """Return whether a chunk is shorter than a checksum, which ends a process that reads it (SIGSEGV)."""
    sizes: list[int] = []
    if dataset.chunks is not None:
        dataset.id.chunk_iter(lambda chunk: sizes.append(chunk.size))
    return any(size <= 8 for size in sizes)


def write_attribute(file: Any, name: str, item: Any) -> None:
    """Store an attribute as ifo does, or as HDF5 can."""
    from artifacts import hdf5

    try:
        hdf5.write_attributes(file, {name: item})
    except Exception:  # Not every hostile value can be stored; then something else that is wrong is.
        file.attrs[name] = np.void(b"\0\1\2")


def judge(case: Case, name: str, what: str, codes: tuple[int, ...] = (0, 3)) -> Verdict:
    """Give a forged file to a command that reads it."""
    consumer = CONSUMERS.get(name, "")
    case.originals.copy(
        case.folder, tuple(n for n in case.originals.parents(name) if not os.path.lexists(case.folder / n))
    )
    if consumer in case.originals.outcomes and case.rng.random() < STAGE_SHARE:
        needed = (n for n in STAGES[consumer].inputs if not os.path.lexists(case.folder / n))
        case.originals.copy(case.folder, tuple(needed))
        outcome = case.run_stage(consumer)
        problem = complaint(outcome, (*codes, 2, 4), case.originals.outcomes[consumer].resident)
        if not problem and outcome.code and (case.folder / STAGES[consumer].out).exists():
            problem = f"leaves {STAGES[consumer].out} although it failed"
        return Verdict(consumer, what, problem)
    word = case.choose(("verify", "inspect"))
    return Verdict(word, what, complaint(run(case.folder, command(word, name)), codes, 300 << 20))


@kind("hostile manifest", 60)
def hostile_manifest(case: Case) -> Verdict:
    name = case.choose(case.originals.files)
    path = case.damage(name)
    told = []

    def change(attributes: dict[str, Any]) -> None:
        for _ in range(int(case.rng.integers(1, 3))):
            key = case.choose((*attributes, "unknown"))
            pick = case.rng.random()
            if pick < 0.1:
                attributes.pop(key, None)
                told.append(f"no {key}")
                continue
            item = value(case)
            if key in ("config", "parents", "environment", "datasets", "recipe", "summary"):
                item = case.choose((DEEP, "{", json.dumps(item), json.dumps({"a": item}), json.dumps([item])))
            attributes[key] = item
            told.append(f"{key} = {str(item)[:60]!r}")

    forge(path, attributes=change)
    return judge(case, name, f"{name}: {', '.join(told)}")


@kind("hostile configuration", 60)
def hostile_configuration(case: Case) -> Verdict:
    """A value of the stage's configuration is of a wrong type or size, or missing."""
    name = case.choose(case.originals.files)
    path = case.damage(name)
    told = []

    def change(attributes: dict[str, Any]) -> None:
        config = json.loads(str(attributes["config"]))
        if not config:
            return
        where, key = config, case.choose(config)
        while isinstance(where[key], dict) and where[key] and case.rng.random() < 0.7:
            where, key = where[key], case.choose(where[key])
        if case.rng.random() < 0.15:
            told.append(f"no {key}")
            del where[key]
        else:
            where[key] = value(case)
            told.append(f"{key} = {str(where[key])[:60]!r}")
        try:
            attributes["config"] = json.dumps(config)
        except (TypeError, ValueError):
            attributes["config"] = "{}"

    forge(path, attributes=change)
    return judge(case, name, f"{name}: configuration: {', '.join(told)}")


@kind("not finite", 15)
def not_finite(case: Case) -> Verdict:
    """NaN or infinity in a dataset of numbers: the stage that uses it refuses it, or it does not matter."""
    name = case.choose(n for n in FLOATS if CONSUMERS.get(n, "evaluate") in case.originals.outcomes)
    path = case.damage(name)
    told = []

    def change(file: Any) -> None:
        import h5py

        names: list[str] = []
        file.visititems(
            lambda n, item: (
                names.append(n) if isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and item.size else None
            )
        )
        chosen = case.choose(sorted(names))
        array = file[chosen][...]
        array.reshape(-1)[int(case.rng.integers(array.size))] = case.choose((np.nan, np.inf, -np.inf))
        file[chosen][...] = array
        told.append(chosen)

    forge(path, datasets=change)
    what = f"{name}: a number of {told[0]} is not finite"
    consumer = CONSUMERS.get(name, "evaluate")
    if consumer == "evaluate" and name != "x.policy.h5":
        words = ("evaluate", name, *STAGES["evaluate"].words[2:], "--out", "x.evaluation.h5")
        outcome = run(case.folder, command(*words), cpu_seconds=90)
        return Verdict("evaluate", what, complaint(outcome, (3,)) if told[0].startswith("weights") else "")
    case.originals.copy(case.folder, tuple(n for n in STAGES[consumer].inputs if n != name))
    outcome = case.run_stage(consumer)
    problem = complaint(outcome, (0, 3))
    # Metrics and curves may be undefined; a policy records the metrics of its translator.
    if not problem and outcome.code == 0 and not told[0].startswith(("curve", "metrics")):
        problem = case.judge_output(consumer)
    if not problem and outcome.code and told[0] not in outcome.stderr and name not in outcome.stderr:
        problem = f"does not name the file: {outcome.stderr.strip()[-200:]}"
    return Verdict(consumer, what, problem)


@kind("hostile lineage", 30)
def hostile_lineage(case: Case) -> Verdict:
    """Parents that are missing, odd files, equal many times over, or in a circle."""
    name = case.choose([n for n in case.originals.files if n.startswith("x.") and case.originals.parents(n)])
    path = case.damage(name)
    parent = case.originals.parents(name)[0]
    case.originals.copy(case.folder, (parent,))
    pick = case.choose(("fifo", "folder", "device", "circle", "many", "text", "missing", "other"))

    def change(attributes: dict[str, Any]) -> None:
        parents = json.loads(str(attributes["parents"]))
        if pick == "many":
            parents = parents * 3_000
        elif pick == "circle":
            parents = [{**entry, "path": name} for entry in parents]
        elif pick in ("text", "device"):
            item = "/dev/zero" if pick == "device" else case.choose([text for text in TEXTS if "\ud800" not in text])
            parents = [{**entry, "path": item} for entry in parents]
        attributes["parents"] = json.dumps(parents)

    forge(path, attributes=change)
    target = case.folder / parent
    if pick in ("fifo", "folder", "missing", "other"):
        target.unlink()
    if pick == "fifo":
        os.mkfifo(target)
    elif pick == "folder":
        target.mkdir()
    elif pick == "other":
        target.write_bytes(case.rng.bytes(1000))
    return judge(case, name, f"{name}: parent: {pick}")
