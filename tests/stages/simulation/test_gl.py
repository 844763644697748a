"""Which GL backend is chosen, and what a user is told when there is none."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from artifacts import PlatformError, UsageError
from stages.simulation import gl


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine on which nothing was chosen yet; `works`: what draws there, `probed`: what was tried."""
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "LP_NUM_THREADS"):
        monkeypatch.setenv(name, "")  # So that what is set from here on is taken back afterwards.
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setattr(gl, "_proven", set())
    monkeypatch.setattr(gl, "_set_here", False)
    state = SimpleNamespace(works={"egl", "osmesa", "glfw"}, probed=[], cache=tmp_path / "ifo" / "gl-backend")
    monkeypatch.setattr(gl, "missing_library", lambda backend: None)

    def probe(backend):
        state.probed.append(backend)
        return None if backend in state.works else "cannot open display"

    monkeypatch.setattr(gl, "probe", probe)
    return state


def new_process(monkeypatch):
    """Forget what this process knows; the cache folder stays."""
    monkeypatch.setattr(gl, "_proven", set())
    monkeypatch.setattr(gl, "_set_here", False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)


@pytest.mark.parametrize(
    ("works", "chosen"),
    [({"egl", "osmesa", "glfw"}, "egl"), ({"osmesa", "glfw"}, "osmesa"), ({"glfw"}, "glfw")],
)
def test_the_first_backend_that_draws_is_chosen(machine, works, chosen):
    machine.works = works
    assert gl.choose_backend() == chosen
    assert os.environ["MUJOCO_GL"] == chosen
    assert os.environ["LP_NUM_THREADS"] == "1"


@pytest.mark.parametrize("value", ["osmesa", " OSMesa "])
def test_mujoco_gl_decides(machine, monkeypatch, value):
    monkeypatch.setenv("MUJOCO_GL", value)
    assert gl.choose_backend() == "osmesa"
    assert machine.probed == ["osmesa"]
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == "osmesa"


def test_mujoco_gl_that_does_not_draw_is_not_replaced(machine, monkeypatch):
    machine.works = {"egl"}
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    with pytest.raises(PlatformError, match=r"MUJOCO_GL=glfw does not work here .*cannot open display") as error:
        gl.choose_backend()
    assert "\n" not in str(error.value)


def test_a_bad_mujoco_gl_is_a_usage_error(machine, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    for required in (True, False):
        with pytest.raises(UsageError, match="MUJOCO_GL=vulkan: expected one of egl, osmesa, glfw"):
            gl.choose_backend(required)
    assert machine.probed == []


def test_no_backend_at_all_names_the_packages(machine):
    machine.works = set()
    with pytest.raises(PlatformError) as error:
        gl.choose_backend()
    assert error.value.exit_code == 4
    assert str(error.value) == (
        "no OpenGL backend works here (EGL: cannot open display); "
        "on Debian run `apt-get install -y libegl1 libopengl0 libgl1-mesa-dri`"
    )
    assert machine.probed == ["egl", "osmesa", "glfw"]
    assert gl.choose_backend(required=False) == ""
    assert "MUJOCO_GL" not in os.environ


def test_threads_of_the_rasteriser_stay_as_the_user_set_them(machine, monkeypatch):
    monkeypatch.setenv("LP_NUM_THREADS", "3")
    gl.choose_backend()
    assert os.environ["LP_NUM_THREADS"] == "3"


def test_the_answer_is_kept_for_the_process_and_the_next(machine, monkeypatch):
    assert gl.choose_backend() == gl.choose_backend() == "egl"
    assert machine.probed == ["egl"]
    new_process(monkeypatch)
    assert gl.choose_backend() == "egl"
    assert machine.probed == ["egl"]


def test_a_failure_is_never_kept(machine, monkeypatch):
    machine.works = set()
    assert gl.choose_backend(required=False) == ""
    machine.works = {"egl"}
    assert gl.choose_backend() == "egl"


def test_a_backend_whose_libraries_were_removed_is_probed_again(machine, monkeypatch):
    gl.choose_backend()
    new_process(monkeypatch)
    monkeypatch.setattr(gl, "missing_library", lambda backend: "PyOpenGL cannot find libEGL.so.1")
    machine.works = {"osmesa"}
    assert gl.choose_backend() == "osmesa"


def test_another_machine_or_mujoco_is_probed_again(machine, monkeypatch):
    gl.choose_backend()
    new_process(monkeypatch)
    monkeypatch.setattr(gl, "_cache_key", lambda: ["another"])
    machine.works = {"osmesa"}
    assert gl.choose_backend() == "osmesa"


@pytest.mark.parametrize("damage", ["", "{", "[]", '"egl"', '{"key": 1}', "\x00\xff"])
def test_a_damaged_cache_is_ignored(machine, monkeypatch, damage):
    gl.choose_backend()
    new_process(monkeypatch)
    machine.cache.write_text(damage)
    assert gl.choose_backend() == "egl"
    assert machine.probed == ["egl", "egl"]


def test_a_cache_that_cannot_be_written_is_no_error(machine, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert gl.choose_backend() == "egl"


def test_a_backend_that_fails_later_can_be_forgotten(machine):
    gl.choose_backend()
    gl.forget_backend()
    assert "MUJOCO_GL" not in os.environ
    machine.works = {"glfw"}
    assert gl.choose_backend() == "glfw"


def test_forgetting_keeps_the_users_own_choice(machine, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    gl.choose_backend()
    gl.forget_backend()
    assert os.environ["MUJOCO_GL"] == "egl"


def test_mujoco_imported_too_early_is_told(machine, monkeypatch):
    context = type("GLContext", (), {"__module__": "mujoco.glfw"})
    monkeypatch.setitem(sys.modules, "mujoco", SimpleNamespace(GLContext=context))
    with pytest.raises(PlatformError, match="already imported with GL backend glfw, not egl: set MUJOCO_GL=egl"):
        gl.choose_backend()
    machine.works = {"glfw"}
    gl.forget_backend()
    assert gl.choose_backend() == "glfw"


def test_choosing_imports_no_mujoco():
    code = "import sys, stages.simulation.gl as gl; gl.choose_backend(False); print('mujoco' in sys.modules)"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert child.stdout == "False\n", child.stderr


@pytest.mark.gl
def test_the_probe_draws_for_real():
    assert gl.probe(os.environ["MUJOCO_GL"]) is None


def test_the_probe_says_why_not():
    reason = gl.probe("vulkan")
    assert "invalid value for environment variable MUJOCO_GL" in reason
    assert "\n" not in reason


def test_a_probe_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(gl, "_PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(gl, "PROBE_SECONDS", 0.3)
    assert gl.probe("egl") == "no image within 0.3 s"


def test_triton_is_loaded_before_mesa(machine, monkeypatch, tmp_path):
    library = tmp_path / "triton" / "_C" / "libtriton.so"
    library.parent.mkdir(parents=True)
    library.touch()
    (tmp_path / "triton" / "__init__.py").write_text("raise AssertionError('triton takes long to import')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "triton", raising=False)
    loaded = []
    monkeypatch.setattr(gl.ctypes, "CDLL", loaded.append)
    gl.choose_backend()
    assert loaded == [str(library)]


def test_a_triton_that_does_not_load_is_no_error(machine, monkeypatch, tmp_path):
    (tmp_path / "triton" / "_C").mkdir(parents=True)
    (tmp_path / "triton" / "_C" / "libtriton.so").write_text("no library")
    (tmp_path / "triton" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "triton", raising=False)
    assert gl.choose_backend() == "egl"


LOADED = {"libEGL.so.1", "libOpenGL.so.0", "libGL.so.1", "libOSMesa.so.8"}


def loader(monkeypatch, absent=(), broken=()):
    """A dynamic loader that finds LOADED only, less `absent`; `broken` ones lack a library of their own."""

    def load(name):
        if name in broken:
            raise OSError("libGLdispatch.so.0: cannot open shared object file: No such file or directory")
        if name in absent or name not in LOADED:
            raise OSError(f"{name}: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(gl.ctypes, "CDLL", load)


@pytest.mark.parametrize(
    ("backend", "absent", "reason"),
    [
        ("egl", (), None),
        ("egl", ("libEGL.so.1",), "PyOpenGL cannot find libEGL.so.1"),
        ("egl", ("libOpenGL.so.0",), None),
        ("egl", ("libGL.so.1",), None),
        ("egl", ("libOpenGL.so.0", "libGL.so.1"), "PyOpenGL cannot find libOpenGL.so.0"),
        ("osmesa", (), None),
        ("osmesa", ("libOSMesa.so.8",), "PyOpenGL cannot find libOSMesa.so.8"),
        ("glfw", tuple(LOADED), None),
    ],
)
def test_a_library_that_pyopengl_lacks_is_named(monkeypatch, backend, absent, reason):
    loader(monkeypatch, absent)
    assert gl.missing_library(backend) == reason


def test_a_library_that_is_there_but_does_not_load_is_told_apart(monkeypatch):
    loader(monkeypatch, absent={"libGL.so.1"}, broken={"libOpenGL.so.0"})
    assert gl.missing_library("egl") == (
        "PyOpenGL cannot load libGLdispatch.so.0: cannot open shared object file: No such file or directory"
    )


@pytest.mark.parametrize(
    ("backend", "absent", "display", "error", "reason"),
    [
        (
            "egl",
            LOADED,
            "",
            "AttributeError: 'NoneType' object has no attribute 'glGetError'",
            "cannot find libEGL.so.1",
        ),
        ("egl", (), "", "ImportError: Cannot initialize a EGL device display. This likely means", "no driver found"),
        ("glfw", (), "", "mujoco.FatalError: an OpenGL platform library has not been loaded", "DISPLAY is not set"),
        ("glfw", (), ":1", "mujoco.FatalError: gladLoadGL error", "mujoco.FatalError: gladLoadGL error"),
        ("egl", (), "", "OSError: something else", "OSError: something else"),
    ],
)
def test_the_probe_gives_the_reason_behind_the_exception(monkeypatch, backend, absent, display, error, reason):
    loader(monkeypatch, absent)
    monkeypatch.setattr(gl, "_PROBE", f"raise SystemExit({error!r})")
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert gl.probe(backend).endswith(reason)
