"""What the tests put into artifacts."""

from __future__ import annotations

import numpy as np

PROVENANCE = {"config": {"task": "reach", "rate": 1e-4}, "seed": 7, "command": "ifo test"}


def demos_arrays(seed: int = 0, n: int = 4) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "frames": rng.integers(0, 256, (n, 5, 8, 10, 3), dtype=np.uint8),
        "final_distance": rng.random(n),
        "contexts/angle": rng.random((n, 2)),
    }
