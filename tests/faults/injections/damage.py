"""Damage by disks and transfers: bytes of finished files change. They are refused, or read as they were written."""

from __future__ import annotations

from pathlib import Path

from tests.faults.case import Case, Verdict, kind
from tests.faults.originals import CONSUMERS, STAGES
from tests.faults.server import CHANGED, command, complaint, run

SECTORS = (512, 4096)
STAGE_SHARE = 0.02  # share of the cases in which the stage that reads the file runs, too


def read_back(path: Path, original: Path) -> int:
    """Read a file in all ways, in a child; CHANGED: other data than in the original came out without an error."""
    import sys

    from artifacts import ArtifactError, read_artifact, verify_artifact

    truth = read_artifact(original)
    try:
        found = read_artifact(path)
        names = truth.names()
        if found.manifest != truth.manifest or found.names() != names:
            print("another manifest was read", file=sys.stderr)
            return CHANGED
        refused = 0
        for name in names:
            try:
                array = found[name]
            except ArtifactError as error:
                refused += 1
                message = str(error)
                continue
            expected = truth[name]
            if array.dtype != expected.dtype or array.shape != expected.shape or array.tobytes() != expected.tobytes():
                print(f"dataset {name} was read with other values", file=sys.stderr)
                return CHANGED
        if refused:
            raise ArtifactError(message)
        verify_artifact(path)
    except ArtifactError as error:
        if "\n" in str(error) or str(path) not in str(error):
            print(f"Traceback: not one line that names the file: {error}", file=sys.stderr)
            return 1
        print(f"ifo: {error}", file=sys.stderr)
        return 3
    return 0


def judge(case: Case, name: str, what: str) -> Verdict:
    """Read a damaged file, by the library, by a command, or by the stage that consumes it."""
    consumer = CONSUMERS.get(name, "")
    if consumer in case.originals.outcomes and case.rng.random() < STAGE_SHARE:
        case.originals.copy(case.folder, tuple(other for other in STAGES[consumer].inputs if other != name))
        return Verdict(consumer, what, case.judge_stage(consumer, case.run_stage(consumer)))
    if case.rng.random() < 0.1:
        word = case.choose(("verify", "inspect"))
        return Verdict(word, what, complaint(run(case.folder, command(word, name)), (0, 3)))
    original = case.originals.folder / name
    path = case.folder / name
    return Verdict("read", what, complaint(run(case.folder, lambda: read_back(path, original)), (0, 3)))


def damaged(case: Case, change, described: str) -> Verdict:
    """Copy a random file, change its bytes with `change(bytes) -> description`, and judge the result."""
    name = case.choose(case.originals.files)
    path = case.damage(name)
    case.originals.copy(case.folder, case.originals.parents(name))
    data = bytearray(path.read_bytes())
    before = bytes(data)
    what = change(data)
    path.write_bytes(data)
    if bytes(data) == before:
        what += " (no byte differs)"
    return judge(case, name, f"{name}: {described} {what}")


def places(case: Case, data: bytearray, size: int, count: int) -> list[int]:
    """Return the offsets of random sectors."""
    return [size * int(k) for k in case.rng.integers(0, max(1, len(data) // size), count)]


@kind("flipped bits", 300)
def flipped_bits(case: Case) -> Verdict:
    def change(data: bytearray) -> str:
        bits = case.rng.integers(0, 8 * len(data), case.rng.integers(1, 9))
        for bit in bits:
            data[bit // 8] ^= 1 << (bit % 8)
        return ", ".join(map(str, bits))

    return damaged(case, change, "flip bits")


@kind("zeroed sectors", 130)
def zeroed_sectors(case: Case) -> Verdict:
    def change(data: bytearray) -> str:
        size = case.choose(SECTORS)
        chosen = places(case, data, size, int(case.rng.integers(1, 5)))
        for at in chosen:
            data[at : at + size] = bytes(len(data[at : at + size]))
        return f"{chosen}, {size} bytes each"

    return damaged(case, change, "zero")


@kind("copied or swapped sectors", 130)
def copied_sectors(case: Case) -> Verdict:
    def change(data: bytearray) -> str:
        size = case.choose(SECTORS)
        one, other = places(case, data, size, 2)
        if max(one, other) + size > len(data):
            return "nothing: the file is too short"
        first, second = bytes(data[one : one + size]), bytes(data[other : other + size])
        data[other : other + size] = first
        if swap := case.rng.random() < 0.5:
            data[one : one + size] = second
        return f"{one} {'swapped with' if swap else 'copied to'} {other}, {size} bytes"

    return damaged(case, change, "sector")


@kind("overwritten sectors", 70)
def overwritten_sectors(case: Case) -> Verdict:
    def change(data: bytearray) -> str:
        size = case.choose(SECTORS)
        (at,) = places(case, data, size, 1)
        length = len(data[at : at + size])
        data[at : at + size] = case.choose((case.rng.bytes(length), b"\xff" * length))
        return f"{at}, {size} bytes"

    return damaged(case, change, "overwrite")


@kind("wrong length", 70)
def wrong_length(case: Case) -> Verdict:
    def change(data: bytearray) -> str:
        if case.rng.random() < 0.8:
            length = int(case.rng.integers(0, len(data)))
            del data[length:]
        else:
            length = len(data)
            data += case.rng.bytes(int(case.rng.integers(1, 10_000)))
        return f"{length} -> {len(data)} bytes"

    return damaged(case, change, "length")


@kind("swapped chunks", 60)
def swapped_chunks(case: Case) -> Verdict:
    """Two chunks of equal size change places, checksums included, as after a write to the wrong address."""
    names = [name for name in case.originals.files if chunks_of(case.originals.folder / name)]
    name = case.choose(names)
    path = case.damage(name)
    case.originals.copy(case.folder, case.originals.parents(name))
    where, size, one, other = case.choose(chunks_of(path))
    data = bytearray(path.read_bytes())
    first, second = bytes(data[one : one + size]), bytes(data[other : other + size])
    data[one : one + size], data[other : other + size] = second, first
    path.write_bytes(data)
    return judge(case, name, f"{name}: chunks of {where} at {one} and {other} swapped")


def chunks_of(path: Path) -> list[tuple[str, int, int, int]]:
    """Return pairs of equally long chunks: dataset, bytes, and both offsets."""
    import h5py

    found: list[tuple[str, int, int, int]] = []
    with h5py.File(path) as file:

        def visit(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and item.chunks:
                count = item.id.get_num_chunks()
                if count > 1:
                    one, other = (item.id.get_chunk_info(k) for k in (0, count - 1))
                    if one.size == other.size:
                        found.append((name, one.size, one.byte_offset, other.byte_offset))

        file.visititems(visit)
    return found
