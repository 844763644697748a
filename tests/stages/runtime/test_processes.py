"""Who says what, and what several processes refuse, without starting any."""

from __future__ import annotations

import pytest

from artifacts import Interrupted, PlatformError, UsageError
from stages.runtime import processes
from stages.runtime.processes import OtherFailed, Processes, is_main, join, process_count


@pytest.fixture
def launched(monkeypatch):
    """A function that makes this process number `rank` of two."""

    def set_rank(rank):
        for name, value in (("WORLD_SIZE", 2), ("RANK", rank), ("LOCAL_RANK", rank), ("LOCAL_WORLD_SIZE", 2)):
            monkeypatch.setenv(name, str(value))

    return set_rank


def test_a_process_that_nobody_launched_is_alone(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "4")  # As some schedulers set it by themselves.
    assert process_count() == 1 and is_main()
    alone = join("train-translator", "cuda:1", True)
    assert (alone.count, alone.main, alone.device) == (1, True, "")
    assert list(alone.share(3)) == [0, 1, 2]
    assert alone.failed(UsageError("x"))
    alone.ready(0)
    alone.finish()


def test_groups_are_shared_out_evenly():
    assert [list(Processes(3, index).share(6)) for index in range(3)] == [[0, 3], [1, 4], [2, 5]]
    with pytest.raises(UsageError, match="--groups 4 with 3 processes: expected a multiple of 3"):
        Processes(3, 1).share(4)


@pytest.mark.parametrize(
    ("stage", "device", "shared", "said"),
    [
        ("learn-policy", "auto", False, "learn-policy runs in one process"),
        ("train-translator", "cuda:1", True, "each process uses its own GPU"),
        ("train-translator", "tpu", True, "expected auto, cpu, cuda or cuda:N"),
    ],
)
def test_the_main_process_says_what_all_refuse(launched, stage, device, shared, said):
    launched(0)
    assert is_main()
    with pytest.raises(UsageError, match=said):
        join(stage, device, shared)
    launched(1)
    assert not is_main()
    with pytest.raises(OtherFailed):
        join(stage, device, shared)


def test_accelerate_is_needed(launched, monkeypatch):
    launched(0)
    monkeypatch.setattr(processes, "find_spec", lambda name: None)
    with pytest.raises(PlatformError, match=r"pip install 'ifo\[accelerate\]'"):
        join("train-translator", "cpu", True)


def test_more_processes_than_gpus_are_refused(launched, monkeypatch):
    launched(0)
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    with pytest.raises(PlatformError, match="2 processes on a machine with 1 GPUs"):
        join("train-translator", "auto", True)


@pytest.mark.parametrize(
    ("met", "index", "raised"),
    [
        ([[0, 5], [0, 5]], 0, None),
        ([[0, 5], [1, 0]], 0, OtherFailed),
        ([[0, 5], [0, 0]], 0, UsageError),  # a machine that does not see the checkpoint
        ([[0, 5], [0, 0]], 1, OtherFailed),
    ],
)
def test_training_starts_where_all_are_ready_at_the_same_step(monkeypatch, met, index, raised):
    process = Processes(2, index)
    monkeypatch.setattr(process, "_meet", lambda code, step: met)
    if raised is None:
        process.ready(5)
        return
    with pytest.raises(raised) as error:
        process.ready(met[index][1])
    assert process.failed(error.value) == (raised is not OtherFailed)


def test_in_training_an_interrupt_is_said_by_the_main_process_alone():
    for index, interrupt, full in ((0, True, True), (1, False, True)):
        process = Processes(2, index)
        process._training = True
        assert process.failed(Interrupted("x")) == interrupt
        assert process.failed(PlatformError("x")) == full
        assert not process.failed(OtherFailed())


def test_several_processes_share_no_standard_input(monkeypatch, capfd, tmp_path):
    from ifo_cli.main import main

    class Two(Processes):
        def failed(self, error):
            return True

    monkeypatch.setattr(processes, "join", lambda *_: Two(2))
    assert main(["train-translator"]) == 2
    assert "name the demos artifact" in capfd.readouterr().err
