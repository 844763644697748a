"""Random numbers: one seed per run, and a separate stream for every consumer, identified by name."""

from __future__ import annotations

import zlib

import numpy as np


def sequence(seed: int, name: str, *index: int) -> np.random.SeedSequence:
    """Return the seed sequence of consumer `name` (and of its `index`-th use) in the run with seed `seed`."""
    return np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()), *index))


def generator(seed: int, name: str, *index: int) -> np.random.Generator:
    """Return a generator for consumer `name`; the same arguments always give the same stream."""
    return np.random.default_rng(sequence(seed, name, *index))


def integer(seed: int, name: str, *index: int) -> int:
    """Return a 31-bit seed, for libraries that expect an integer."""
    return int(sequence(seed, name, *index).generate_state(1)[0] >> 1)
