"""Runs commands in forked children of a process that has already imported ifo, under limits, and judges how they end.

A fork takes milliseconds where a new process imports for seconds, and a crash ends only the child.
"""

from __future__ import annotations

import ctypes
import io
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

MEMORY = 3 << 30  # bytes of address space that a child may map in addition to what its parent has mapped
EXTRA_RESIDENT = 400 << 20  # bytes of physical memory that an injection may need in addition to an undisturbed run
CPU_SECONDS = 10.0
WALL_SECONDS = 60.0  # a child may wait for a busy machine; what only waits, such as for a FIFO, ends here
CHANGED = 99  # exit code of a child that read other data than was written
IMPORTS = (
    "ifo_cli.main",
    "stages.train_expert", "stages.collect_demos", "stages.import_demos", "stages.export_demos",
    "stages.train_translator", "stages.translate", "stages.learn_policy", "stages.evaluate", "stages.report",
    "stages.learners.algorithms", "stages.learners.gps.learner", "stages.datasets.lerobot", "stages.datasets.robomimic",
    "torch", "mujoco", "h5py", "av", "cv2", "pyarrow.parquet",
)  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """How a child ended.

    Attributes:
        code: Exit code; minus the signal's number if a signal ended it.
        stdout: Its standard output.
        stderr: Its standard error.
        seconds: CPU time of the child and its own children that it waited for.
        resident: Peak of its physical memory, bytes.
        hung: It was stopped because it exceeded a time limit.
    """

    code: int
    stdout: str
    stderr: str
    seconds: float
    resident: int
    hung: bool


@dataclass
class Child:
    """A running child, which leads a process group of its own."""

    pid: int
    folder: Path
    started: float = field(default_factory=time.monotonic)

    def send(self, number: int) -> None:
        """Send a signal to the child itself, not to its group, unless it has ended."""
        os.kill(self.pid, number)  # Until `wait`, a child that has ended is a zombie, so the number is still its own.

    def running(self) -> bool:
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None

    def wait(self, limit: float = WALL_SECONDS) -> Outcome:
        """Wait until it ends, or kill it at the limit (seconds of wall-clock time since its start)."""
        descriptor = os.pidfd_open(self.pid)
        left = max(0.0, limit - (time.monotonic() - self.started))
        hung = not select.select([descriptor], [], [], left)[0]
        if hung:
            os.kill(self.pid, signal.SIGKILL)
        os.close(descriptor)
        _, status, usage = os.wait4(self.pid, 0)
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)  # processes that it left behind
        code = os.waitstatus_to_exitcode(status)
        texts = [(self.folder / name).read_bytes().decode(errors="backslashreplace") for name in ("stdout", "stderr")]
        seconds = usage.ru_utime + usage.ru_stime
        return Outcome(code, *texts, seconds, usage.ru_maxrss * 1024, hung or code == -signal.SIGXCPU)


def prepare() -> None:
    """Import everything that the commands need. No thread and no OpenGL context may exist when a child is forked."""
    os.environ |= {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
    from stages.simulation.gl import choose_backend

    choose_backend()
    for name in IMPORTS:
        __import__(name)


def start(
    folder: Path,
    task: Callable[[], int],
    *,
    cpu_seconds: float = CPU_SECONDS,
    memory: int = MEMORY,
    restricted: bool = False,
    stdin: bytes | int = b"",
) -> Child:
    """Run a function in a child.

    Args:
        folder: Working folder of the child.
        task: Returns the exit code.
        cpu_seconds: CPU time after which the kernel ends it.
        memory: Bytes of address space that it may map in addition.
        restricted: Whether the permissions of files apply to it, as to an ordinary user.
        stdin: What it reads, or an open descriptor.
    """
    logs = folder.parent / f"{folder.name}.output"
    logs.mkdir(exist_ok=True)
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return Child(pid, logs)
    try:
        os.setpgid(0, 0)
        os.chdir(folder)
        _redirect(logs, stdin)
        limit = int(cpu_seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + memory, mapped + memory))
        if restricted:
            respect_permissions()
        code = task()
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(code)


def _redirect(logs: Path, stdin: bytes | int) -> None:
    if isinstance(stdin, bytes):
        (logs / "stdin").write_bytes(stdin)
        stdin = os.open(logs / "stdin", os.O_RDONLY)
    os.dup2(stdin, 0)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(logs / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666), number)
    # A test runner may have put something else in their places.
    for number, name in ((1, "stdout"), (2, "stderr")):
        binary = io.FileIO(number, "w", closefd=False)
        text = io.TextIOWrapper(io.BufferedWriter(binary), encoding="utf-8", errors="backslashreplace")
        setattr(sys, name, text)


def respect_permissions() -> None:
    """Give up root's right to ignore the permissions of files (CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH)."""
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # _LINUX_CAPABILITY_VERSION_3, this process
    sets = (ctypes.c_uint32 * 6)()  # effective, permitted, inheritable: low words, then high words
    if os.geteuid() == 0 and libc.capget(header, sets) == 0:
        for at in (0, 1):
            sets[at] &= ~0b110
        if libc.capset(header, sets):
            raise OSError(ctypes.get_errno(), "capset")


def command(*words: object) -> Callable[[], int]:
    """Return a task that runs the command line."""

    def task() -> int:
        from ifo_cli.main import main

        return main([str(word) for word in words])

    return task


def run(folder: Path, task: Callable[[], int], **options: object) -> Outcome:
    """Run a function in a child and wait for it."""
    return start(folder, task, **options).wait()  # type: ignore[arg-type]


def complaint(outcome: Outcome, codes: Iterable[int], resident: int = 0) -> str:
    """Return what is wrong with the way a command ended; empty: nothing.

    Args:
        outcome: How it ended.
        codes: Exit codes that are right.
        resident: Peak of physical memory of an undisturbed run, bytes; 0: unknown.
    """
    if outcome.hung:
        return f"hangs (stopped after {outcome.seconds:.0f} s of CPU time)"
    if outcome.code == CHANGED:
        return "silent: " + outcome.stderr.strip()
    if outcome.code < 0:
        return f"crashes: {signal.Signals(-outcome.code).name}"
    if "Traceback" in outcome.stderr or outcome.code == 1:
        return f"traceback (exit code {outcome.code}): " + " | ".join(outcome.stderr.strip().splitlines()[-4:])
    if outcome.code not in tuple(codes):
        return f"exit code {outcome.code}, expected {'/'.join(map(str, codes))}: {last_line(outcome.stderr)}"
    if outcome.code and (len(said := error_lines(outcome.stderr)) != 1 or not said[0]):
        return f"{len(said)} error lines, expected one: {outcome.stderr.strip()[-300:]}"
    if outcome.code and outcome.stdout:
        return f"prints {outcome.stdout[:100]!r} although it failed"
    if bad := sorted({c for c in outcome.stderr if c not in "\n\r\t" and not c.isprintable()}):
        return f"prints control characters {bad}"
    if resident and outcome.resident > resident + EXTRA_RESIDENT:
        return f"needs {outcome.resident >> 20} MiB, undisturbed {resident >> 20} MiB"
    return ""


def error_lines(stderr: str) -> list[str]:
    """Return the error lines without their prefix."""
    return [line.removeprefix("ifo: ") for line in stderr.splitlines() if line.startswith("ifo: ")]


def last_line(text: str) -> str:
    """Return the last line that is not empty."""
    return next((line for line in reversed(text.splitlines()) if line.strip()), "")


def mount_tmpfs(folder: Path, size: int) -> bool:
    """Mount a file system of `size` bytes on a folder; return whether that is possible."""
    libc = ctypes.CDLL(None, use_errno=True)
    return libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={size},mode=777".encode()) == 0


def unmount(folder: Path) -> None:
    """Unmount what `mount_tmpfs` mounted."""
    ctypes.CDLL(None).umount2(os.fsencode(folder), 2)  # 2: MNT_DETACH
