"""How fast `ifo verify` is, beside the digest's own speed on the same bytes and HDF5's own speed on the same file.

    python benchmarks/verify.py --gigabytes 3

Writes random demonstrations of that size to --folder, and prints one JSON line: seconds and gigabytes per second of
`verify_artifact`, with the file in the page cache and without it (`cold`); of HDF5 reading the file, which includes its
checksum; of a plain sequential read of the file, without the cache; and of digesting the same bytes in memory by XXH3
and, for comparison, by SHA-256. `ratio_to_xxh3` is the time of `verify_artifact` over that of the digest, and `ratio`
over that of HDF5 and the digest together: 1 is the least that it can be. `load` is the machine's load average before.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from artifacts import verify_artifact, write_artifact
from artifacts.digests import DatasetDigest, blocks

SHAPE = (25, 48, 48, 3)  # of one demonstration
ROUNDS = 3  # the fastest counts


def seconds(work: Callable[[], Any], before: Callable[[], Any] = lambda: None) -> float:
    """Of the fastest run of `work`."""
    spent = []
    for _ in range(ROUNDS):
        before()
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return min(spent)


def forget(path: Path) -> None:
    """Drop a file from the page cache."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def read_plainly(path: Path) -> None:
    """Read a file from its first byte to its last."""
    buffer = bytearray(8 << 20)
    with open(path, "rb", buffering=0) as file:
        while file.readinto(buffer):
            pass


def read_by_hdf5(path: Path) -> None:
    """Read the frames by the same blocks as `verify_artifact`, and do nothing with them."""
    with h5py.File(path, locking=False) as file:
        frames = file["frames"]
        for selection in blocks(frames.shape, frames.dtype.itemsize, frames.chunks):
            frames[selection]


def digest(frames: np.ndarray) -> None:
    """Digest the frames in memory as `verify_artifact` does."""
    whole = DatasetDigest(frames.shape, frames.dtype)
    for selection in blocks(frames.shape, frames.dtype.itemsize):
        whole.update(frames[selection])
    whole.hexdigest()


def measure(path: Path, count: int) -> dict[str, float]:
    """Seconds to write demonstrations to `path`, to check and to read them."""
    frames = np.random.default_rng(0).integers(0, 256, (count, *SHAPE), np.uint8)
    arrays = {"frames": frames, "final_distance": np.zeros(count)}
    return {
        "write": seconds(lambda: write_artifact(path, "demos", arrays, config={}, seed=0, command="benchmark")),
        "verify": seconds(lambda: verify_artifact(path)),
        "hdf5": seconds(lambda: read_by_hdf5(path)),
        "xxh3": seconds(lambda: digest(frames)),
        "sha256": seconds(lambda: hashlib.sha256(frames.data).digest()),
        "verify_cold": seconds(lambda: verify_artifact(path), before=lambda: forget(path)),
        "disk": seconds(lambda: read_plainly(path), before=lambda: forget(path)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=0.5)
    parser.add_argument("--folder", type=Path, default=None, help="where to write (default: the temporary folder)")
    options = parser.parse_args()
    count = max(1, round(options.gigabytes * 1e9 / math.prod(SHAPE)))
    gigabytes = count * math.prod(SHAPE) / 1e9
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        spent = measure(Path(folder) / "x.demos.h5", count)
    result = {
        "benchmark": "verify",
        "gigabytes": round(gigabytes, 2),
        "load": round(load, 1),
        **{f"{name}_s": round(value, 2) for name, value in spent.items()},
        **{f"{name}_gb_s": round(gigabytes / value, 2) for name, value in spent.items()},
        "ratio_to_xxh3": round(spent["verify"] / spent["xxh3"], 2),
        "ratio": round(spent["verify"] / (spent["hdf5"] + spent["xxh3"]), 2),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
