"""Streams of random numbers: each follows from seed, name and index, and from nothing else."""

import zlib

import numpy as np
import pytest

from stages.runtime.seeding import generator, integer, sequence


def test_a_stream_is_numpys_own_spawned_by_the_names_checksum():
    spawned = np.random.SeedSequence(7, spawn_key=(zlib.crc32(b"demos"), 3, 1))
    assert generator(7, "demos", 3, 1).integers(2**40) == np.random.default_rng(spawned).integers(2**40)
    assert sequence(7, "demos", 3, 1).generate_state(4).tolist() == spawned.generate_state(4).tolist()
    assert integer(7, "demos", 3, 1) == int(spawned.generate_state(1)[0]) // 2


def test_the_numbers_stay_what_they_were():
    """Files say by which seed they were made: what that means must not drift."""
    assert generator(0, "demos", 0).integers(10**9, size=3).tolist() == [152661212, 18908094, 125792097]
    assert integer(0, "translator") == 1469806640


@pytest.mark.parametrize("other", [(8, "demos", 3), (7, "Demos", 3), (7, "demos", 4), (7, "demos"), (7, "demos", 3, 0)])
def test_another_seed_name_or_index_gives_another_stream(other):
    assert generator(*other).integers(2**40) != generator(7, "demos", 3).integers(2**40)
    assert integer(*other) != integer(7, "demos", 3)


def test_integers_have_31_bits():
    drawn = [integer(seed, "x") for seed in range(200)]
    assert all(0 <= value < 2**31 for value in drawn) and max(drawn) > 2**30
    assert {value % 2 for value in drawn} == {0, 1}
