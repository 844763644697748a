"""Chooses the OpenGL backend before mujoco is imported, because mujoco reads MUJOCO_GL only on import.

A backend works if a child process can render an image with it. The probe takes about a second, so its result is cached
in the user's cache folder until the machine restarts or mujoco changes.
"""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import platform
import subprocess
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from artifacts.errors import PlatformError, UsageError

BACKENDS = ("egl", "osmesa", "glfw")
PROBE_SECONDS = 30
# The Debian packages that EGL needs: the EGL and OpenGL loaders and Mesa's drivers. `.ci/setup.sh` installs them.
PACKAGES = ("libegl1", "libopengl0", "libgl1-mesa-dri")
INSTALL = f"apt-get install -y {' '.join(PACKAGES)}"
# The libraries that PyOpenGL loads for a backend: one of each group must be installed.
_LIBRARIES: dict[str, tuple[tuple[str, ...], ...]] = {
    "egl": (("libEGL.so.1",), ("libOpenGL.so.0", "libGL.so.1")),
    "osmesa": (("libOSMesa.so.8", "libOSMesa.so.6"),),
}
_CURES = {"egl": f"run `{INSTALL}`", "osmesa": "run `apt-get install -y libosmesa6`"}

_PROBE = """
import mujoco, numpy
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='.3'/></worldbody></mujoco>"
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
gl = mujoco.GLContext(64, 64)
gl.make_current()
context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
scene, camera = mujoco.MjvScene(model, maxgeom=16), mujoco.MjvCamera()
mujoco.mjv_defaultFreeCamera(model, camera)
mujoco.mjv_updateScene(
    model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), camera, mujoco.mjtCatBit.mjCAT_ALL, scene
)
viewport, pixels = mujoco.MjrRect(0, 0, 64, 64), numpy.zeros((64, 64, 3), numpy.uint8)
mujoco.mjr_render(viewport, scene, context)
mujoco.mjr_readPixels(pixels, None, viewport, context)
context.free()
gl.free()
if pixels.min() == pixels.max():
    raise SystemExit("it draws a blank picture")
print("drawn")
"""

_proven: set[str] = set()
_renders_in: int | None = None  # the process that rendered first
_set_here = False


def check_not_forked() -> None:
    """Refuse to render in a process that was forked from one that has rendered.

    A fork has no copy of the driver's threads, and would wait for them forever.

    Raises:
        PlatformError: Another process has rendered, of which this one is a copy.
    """
    global _renders_in
    _renders_in = _renders_in or os.getpid()
    if _renders_in != os.getpid():
        raise PlatformError(
            "rendering does not work in a process that was forked after its parent had rendered: start processes with "
            "the start method 'spawn' or 'forkserver', or before the first frame"
        )


def choose_backend(required: bool = True) -> str:
    """Choose the GL backend and set MUJOCO_GL for this process and its children.

    MUJOCO_GL takes precedence if it is set. Otherwise the first working backend of EGL, OSMesa and GLFW is used.
    LP_NUM_THREADS is set to 1 unless it is already set. Call this function before anything imports mujoco or
    dm_control; later calls are cheap.

    Args:
        required: Whether the caller is going to render. If false, a machine without GL is not an error.

    Returns:
        `egl`, `osmesa` or `glfw`; empty if nothing works and `required` is false.

    Raises:
        UsageError: MUJOCO_GL does not name a backend.
        PlatformError: No backend works, or mujoco was imported with another one.
    """
    try:
        backend = _working_backend()
        _check_loaded(backend)
    except PlatformError:
        if required:
            raise
        return ""
    _use(backend)
    return backend


def forget_backend() -> None:
    """Clear the cached backend, in memory and on disk, so that the next choice probes again."""
    global _set_here
    _proven.clear()
    if _set_here:
        os.environ.pop("MUJOCO_GL", None)
        _set_here = False
    if (path := _cache_path()) is not None:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _working_backend() -> str:
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if requested and requested not in BACKENDS:
        raise UsageError(f"MUJOCO_GL={requested}: expected one of {', '.join(BACKENDS)}; unset it to let ifo choose")
    _proven.update(_read_cache())
    reasons = {}
    for backend in (requested,) if requested else BACKENDS:
        if backend in _proven:
            return backend
        if (failure := probe(backend)) is None:
            _proven.add(backend)
            _write_cache(_proven)
            return backend
        reasons[backend] = failure
    if requested:
        cure = f" or {_CURES[requested]}" if requested in _CURES else ""
        raise PlatformError(f"MUJOCO_GL={requested} does not work here ({reasons[requested]}); unset it{cure}")
    # EGL is the backend to install. The reasons why the others fail would only distract from its own.
    raise PlatformError(f"no OpenGL backend works here (EGL: {reasons['egl']}); on Debian {_CURES['egl']}")


def probe(backend: str) -> str | None:
    """Render a small image with `backend` in a child process; return the reason if that fails, else None."""
    environment = os.environ | {"MUJOCO_GL": backend, "LP_NUM_THREADS": "1"}
    environment.pop("PYOPENGL_PLATFORM", None)  # mujoco rejects a backend that does not match it.
    try:
        child = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"no image within {PROBE_SECONDS} s"
    if child.returncode == 0 and "drawn" in child.stdout:
        return None
    if (missing := missing_library(backend)) is not None:
        return missing
    if backend == "glfw" and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return "GLFW needs a display, and DISPLAY is not set"
    lines = child.stderr.strip().splitlines()
    reason = lines[-1].strip() if lines else f"the probe ended with status {child.returncode}"
    return "no driver found" if "Cannot initialize a EGL device display" in reason else reason[:160]


def missing_library(backend: str) -> str | None:
    """One line naming the library of `backend` that cannot be loaded; None if all can be loaded.

    PyOpenGL does not report it: it continues without the library and fails later, on an attribute of None.
    """
    for names in _LIBRARIES.get(backend, ()):
        failures = [_load_failure(name) for name in names]
        if None not in failures:
            broken = [failure for failure in failures if failure]
            return f"PyOpenGL cannot load {broken[0]}" if broken else f"PyOpenGL cannot find {names[0]}"
    return None


def _load_failure(name: str) -> str | None:
    """The loader's message about a library that is installed but broken; empty if not installed, None if it loads."""
    try:
        ctypes.CDLL(name)
    except OSError as error:
        message = " ".join(str(error).split())
        return "" if message.startswith(f"{name}: cannot open shared object file") else message
    return None


def _check_loaded(backend: str) -> None:
    """Raise PlatformError if mujoco was imported with another backend, which cannot be changed afterwards."""
    mujoco = sys.modules.get("mujoco")
    if mujoco is None:
        return
    context = getattr(mujoco, "GLContext", None)
    loaded = "none" if context is None else context.__module__.rpartition(".")[2]
    if loaded != backend:
        raise PlatformError(
            f"mujoco was already imported with GL backend {loaded}, not {backend}: "
            f"set MUJOCO_GL={backend} before starting"
        )


def _use(backend: str) -> None:
    global _set_here
    _set_here = _set_here or not os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = backend
    if backend != "glfw":
        os.environ["PYOPENGL_PLATFORM"] = backend
    # A 48x48 frame is too small to split among threads of Mesa's software rasterizer.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    _load_triton()


def _load_triton() -> None:
    """Load the library of triton, which comes with torch for CUDA, before Mesa's.

    Both bring an LLVM and export its symbols. Mesa's are global: if they come first, triton's library binds to them
    and the process crashes when torch imports triton. In this order each keeps its own. Takes 0.1 s, once.
    """
    if "triton" in sys.modules or (spec := importlib.util.find_spec("triton")) is None:
        return
    for folder in spec.submodule_search_locations or ():
        for library in Path(folder, "_C").glob("libtriton*.so"):
            with suppress(OSError):  # A triton that does not load is for torch to report.
                ctypes.CDLL(str(library))


def _cache_path() -> Path | None:
    folder = os.environ.get("XDG_CACHE_HOME")
    if folder:
        return Path(folder) / "ifo" / "gl-backend"
    try:
        return Path.home() / ".cache" / "ifo" / "gl-backend"
    except RuntimeError:  # No home folder: nothing is cached.
        return None


def _cache_key() -> list[str]:
    """Everything that the result of a probe depends on."""
    boot = ""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    variables = (
        "DISPLAY",
        "WAYLAND_DISPLAY",
        "MUJOCO_EGL_DEVICE_ID",
        "CUDA_VISIBLE_DEVICES",
        "LD_LIBRARY_PATH",
    )
    values = [os.environ.get(name, "") for name in variables]
    return [metadata.version("mujoco"), sys.prefix, platform.node(), boot, *values]


def _read_cache() -> list[str]:
    path = _cache_path()
    try:
        kept = json.loads(path.read_text()) if path is not None else {}
        if kept.get("key") != _cache_key():
            return []
        # Libraries may have been removed in the meantime.
        return [name for name in kept["works"] if name in BACKENDS and missing_library(name) is None]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []


def _write_cache(works: set[str]) -> None:
    path = _cache_path()
    if path is None:
        return
    with suppress(OSError):  # The cache only saves time.
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f"{path.name}.{os.getpid()}")
        partial.write_text(json.dumps({"key": _cache_key(), "works": sorted(works)}))
        partial.replace(path)
