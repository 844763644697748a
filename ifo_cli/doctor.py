"""`ifo doctor`: check that this machine has everything the stages need."""

from __future__ import annotations

import json
import platform
import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata

import typer

from artifacts.errors import IfoError, PlatformError
from ifo_cli.options import Given, stage_command
from ifo_cli.streams import emit, stdout_to_stderr

EXAMPLES = (
    "ifo doctor",
    "ifo doctor --json",
)
PYTHONS = ((3, 11), (3, 12))  # as requires-python in pyproject.toml
MUJOCO_MAJOR = 3
FEWEST_COLOURS = 4  # in a rendered frame; a driver that fails silently produces a single color
REINSTALL = "install ifo again: pip install -e ."
GL_REMEDY = "see gl backend"  # the error of that check says what to install


@dataclass(frozen=True)
class Check:
    """One line of the report; `remedy` says what to do if `ok` is false."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""


@stage_command("doctor")
def doctor(given: Given) -> None:
    """Check this machine: Python, torch, MuJoCo, video encoding, and one rendered frame.

    The exit code is 4 if anything is missing; the line of the failed check says how to fix it.
    """
    with stdout_to_stderr():
        checks = [_run(name, examine, remedy) for name, (examine, remedy) in CHECKS.items()]
    ok = all(check.ok for check in checks)
    if given.get("json"):
        emit(json.dumps({"ok": ok, "checks": [asdict(check) for check in checks]}))
    else:
        for check in checks:
            remedy = f"; {check.remedy}" if check.remedy else ""
            emit(f"{'ok  ' if check.ok else 'fail'} {check.name}: {check.detail}{remedy}")
    if not ok:
        raise typer.Exit(PlatformError.exit_code)


def _run(name: str, examine: Callable[[], str], remedy: str) -> Check:
    """Run one check. All exceptions are caught, because whatever a broken library raises belongs in the report."""
    try:
        return Check(name, True, examine())
    except IfoError as error:
        return Check(name, False, str(error), "" if "apt" in str(error) else remedy)
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return Check(name, False, reason, remedy)


def _python() -> str:
    found = f"{platform.python_version()} on {platform.platform()}"
    if sys.version_info[:2] not in PYTHONS:
        raise PlatformError(f"{found}, expected {' or '.join(f'{major}.{minor}' for major, minor in PYTHONS)}")
    return found


def _torch() -> str:
    import torch

    device = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "CPU"
    return f"{torch.__version__} on {device}, {torch.get_num_threads()} threads"


def _mujoco() -> str:
    found = metadata.version("mujoco")
    if int(found.split(".")[0]) != MUJOCO_MAJOR:
        raise PlatformError(f"{found}, expected version {MUJOCO_MAJOR}.x, 3.17 or later")
    from stages.simulation.gl import forget_backend

    forget_backend()  # The cached answer may be older than the libraries.
    _settle_backend()
    import mujoco.batch  # noqa: F401

    return found


def _dm_control() -> str:
    _settle_backend()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw warns if there is no backend; the backend check reports that better.
        from dm_control import mjcf  # noqa: F401

    return metadata.version("dm-control")


def _settle_backend() -> None:
    """Choose the GL backend before mujoco is imported. The check `gl backend` reports a missing one."""
    from stages.simulation.gl import choose_backend

    choose_backend(required=False)


def _video() -> str:
    import av
    from av.codec import Codec

    Codec("libx264", "w")
    return f"PyAV {av.__version__} encodes H.264"


def _gl() -> str:
    from stages.simulation.gl import choose_backend

    return choose_backend()


def _frame() -> str:
    from stages.simulation.gl import choose_backend

    if not choose_backend(required=False):
        raise PlatformError("rendering needs a GL backend")
    import numpy as np

    from stages.simulation.contexts import DISTRIBUTIONS
    from stages.simulation.render import RenderPool
    from stages.simulation.tasks.reach import Reach

    task = Reach()
    contexts = task.draw_contexts(np.random.default_rng(0), 1, DISTRIBUTIONS["fixed"])
    qpos, _ = task.context_state(contexts)
    height, width = task.frame_size
    with RenderPool.of(task, 1) as pool:
        frame = pool.render(task.model_fields(contexts), qpos[:, None])[0, 0]
    colours = len(np.unique(frame.reshape(-1, 3), axis=0))
    if colours < FEWEST_COLOURS:
        raise PlatformError(
            f"a frame of reach shows {colours} colors, expected at least {FEWEST_COLOURS}: the driver renders "
            "incorrectly; update it, or try MUJOCO_GL=osmesa (apt-get install -y libosmesa6)"
        )
    return f"reach at {width}x{height}, {colours} colors"


CHECKS: dict[str, tuple[Callable[[], str], str]] = {
    "python": (_python, "install ifo with Python 3.11 or 3.12"),
    "torch": (_torch, REINSTALL),
    "mujoco": (_mujoco, "pip install 'mujoco>=3.17,<4'"),
    "dm-control": (_dm_control, REINSTALL),
    "video": (_video, "pip install --force-reinstall av"),
    "gl backend": (_gl, REINSTALL),
    "rendered frame": (_frame, GL_REMEDY),
}
