"""What the tests put into artifacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

FIXTURES = Path(__file__).parents[1] / "fixtures"
OLD_FILES = {  # of schema 1, each the parent of the next
    kind: FIXTURES / "v1" / f"{stem}.{kind}.h5"
    for kind, stem in {
        "expert": "small",
        "demos": "small",
        "translator": "small",
        "translation": "small-c0",
        "policy": "small-c0",
        "evaluation": "small-c0",
    }.items()
}
OLD_CHECKPOINT = FIXTURES / "v1" / "small-c0.policy.checkpoint.h5"

PROVENANCE = {"config": {"task": "reach", "rate": 1e-4}, "seed": 7, "command": "ifo test"}


def demos_arrays(seed: int = 0, n: int = 4) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "frames": rng.integers(0, 256, (n, 5, 8, 10, 3), dtype=np.uint8),
        "final_distance": rng.random(n),
        "contexts/angle": rng.random((n, 2)),
    }
