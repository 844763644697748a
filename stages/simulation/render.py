"""Renders frames of many simulations at once: tiles of one offscreen buffer, in several processes.

Several threads in one process are no faster than one, because Mesa's software rasterizer and the driver serialize them
with locks. Several processes are faster.
"""

from __future__ import annotations

import multiprocessing.connection
import os
import signal
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from artifacts import PlatformError
from stages.simulation.gl import check_not_forked, forget_backend

if TYPE_CHECKING:
    import mujoco

    from stages.simulation.task import Task

DEAD_WORKER = "a render process died: run `ifo doctor`, or reduce --workers if memory is short"
TILES = (8, 8)  # columns, rows of the buffer: larger is no faster
PIECE = TILES[0] * TILES[1]
# Fields of MjModel.vis.quality for pictures: MuJoCo's own values, except that its shadows of 4096 pixels would take two
# to three times as long without a GPU (results/LOG.md, "Pictures of policies").
FINE = {"offsamples": 4, "shadowsize": 1024, "numslices": 28, "numstacks": 16, "numquads": 4}


def pieces(n_videos: int, n_frames: int, most: int = PIECE) -> list[tuple[slice, slice]]:
    """Split V videos of T frames into pieces of at most `most` frames, which fit the buffer: slices of both.

    A frame's tile affects the rounding at its edges. The split therefore depends only on the shape, never on the number
    of processes: the same request gives the same bytes everywhere.
    """
    if n_frames <= most:
        step = most // n_frames
        return [(slice(k, min(k + step, n_videos)), slice(0, n_frames)) for k in range(0, n_videos, step)]
    cuts = [slice(k, min(k + most, n_frames)) for k in range(0, n_frames, most)]
    return [(slice(v, v + 1), cut) for v in range(n_videos) for cut in cuts]


class TileRenderer:
    """Renders frames of one model into tiles of one buffer, which is read back when it is full.

    Not thread-safe: use and `close` it in the thread that created it.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        height: int,
        width: int,
        camera: str | int = "context",
        oversampling: int = 1,
        fine: bool = False,
    ):
        """Prepare to render.

        Args:
            model: The model; it is copied.
            height, width: Size of a frame, pixels.
            camera: Name or id of the camera.
            oversampling: Each pixel averages `oversampling` squared samples.
            fine: Render as for people: with shadows, multisampling and finer meshes.
        """
        import mujoco

        check_not_forked()
        self._mujoco = mujoco
        self._model = mujoco.MjModel.__copy__(model)
        self._data = mujoco.MjData(self._model)
        self._size, self._oversampling = (height, width), oversampling
        self._height, self._width = height * oversampling, width * oversampling
        # If the buffer is not read back after each frame, some shadows have specks (Mesa 22.3).
        self._columns, self._rows = (1, 1) if fine else TILES
        full_width, full_height = self._columns * self._width, self._rows * self._height
        self._model.vis.global_.offwidth = full_width
        self._model.vis.global_.offheight = full_height
        if fine:
            quality = self._model.vis.quality
            for name, value in FINE.items():
                setattr(quality, name, value)
        self._gl: Any = None
        try:
            self._gl = mujoco.GLContext(full_width, full_height)
            self._gl.make_current()
            self._render_context: Any = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_50)
        except (RuntimeError, ImportError, mujoco.FatalError) as error:
            forget_backend()
            reason = " ".join(str(error).split())
            raise PlatformError(
                f"rendering no longer works here ({reason}): `ifo doctor` lists what to install"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._render_context)
        self._scene = mujoco.MjvScene(self._model, maxgeom=max(64, 2 * self._model.ngeom))
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = fine
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._options = mujoco.MjvOption()
        self._perturb = mujoco.MjvPerturb()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = self._model.camera(camera).id
        # A camera that tracks a body needs centers of mass.
        self._follows = self._model.cam_mode[self._camera.fixedcamid] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        self._buffer = np.empty((full_height, full_width, 3), np.uint8)

    def render(self, fields: dict[str, np.ndarray], qpos: np.ndarray) -> np.ndarray:
        """Render V videos of T frames.

        Args:
            fields: MjModel fields of each video's context, name -> (V, *shape).
            qpos: Joint positions (V, T, nq).

        Returns:
            Frames (V, T, H, W, 3), uint8 RGB.
        """
        n_videos, n_frames = qpos.shape[:2]
        out = np.empty((n_videos, n_frames, *self._size, 3), np.uint8)
        check_not_forked()
        self._gl.make_current()
        for videos, frames in pieces(n_videos, n_frames, self._columns * self._rows):
            out[videos, frames] = self._draw({k: v[videos] for k, v in fields.items()}, qpos[videos, frames])
        return out

    def _draw(self, fields: dict[str, np.ndarray], qpos: np.ndarray) -> np.ndarray:
        """Render one piece, which fits the buffer, starting at the first tile."""
        mujoco, model, data = self._mujoco, self._model, self._data
        viewport = mujoco.MjrRect(0, 0, self._width, self._height)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        tile = 0
        for video, positions in enumerate(qpos):
            for name, values in fields.items():
                getattr(model, name)[:] = values[video]
            for position in positions:
                data.qpos[:] = position
                mujoco.mj_kinematics(model, data)
                if self._follows or model.ntendon:
                    mujoco.mj_comPos(model, data)
                if model.ntendon:
                    mujoco.mj_tendon(model, data)
                mujoco.mj_camlight(model, data)
                mujoco.mjv_updateScene(model, data, self._options, self._perturb, self._camera, everything, self._scene)
                viewport.left = (tile % self._columns) * self._width
                viewport.bottom = (tile // self._columns) * self._height
                mujoco.mjr_render(viewport, self._scene, self._render_context)
                tile += 1
        return reduced(self._read_back(tile), self._oversampling).reshape(*qpos.shape[:2], *self._size, 3)

    def _read_back(self, tiles: int) -> np.ndarray:
        """Frames (tiles, H, W, 3) of the buffer's first tiles. The buffer's rows run upward."""
        rows = -(-tiles // self._columns)
        used = self._mujoco.MjrRect(0, 0, self._columns * self._width, rows * self._height)
        pixels = self._buffer[: rows * self._height]
        self._mujoco.mjr_readPixels(pixels, None, used, self._render_context)
        grid = pixels.reshape(rows, self._height, self._columns, self._width, 3)[:, ::-1]
        return grid.swapaxes(1, 2).reshape(-1, self._height, self._width, 3)[:tiles]

    def close(self) -> None:
        """Free the GL context. Otherwise the interpreter prints ignored exceptions at exit."""
        if self._gl is not None:
            self._render_context.free()
            self._gl.free()
            self._gl = None


def reduced(frames: np.ndarray, factor: int) -> np.ndarray:
    """Downscale frames by `factor` along each side to (n, H, W, 3), uint8, by averaging blocks, as cameras do."""
    if factor == 1:
        return frames
    n, height, width, _ = frames.shape
    blocks = frames.reshape(n, height // factor, factor, width // factor, factor, 3)
    return ((blocks.sum(axis=(2, 4), dtype=np.uint32) + factor**2 // 2) // factor**2).astype(np.uint8)


def _serve(
    connection: Connection, model: mujoco.MjModel, height: int, width: int, camera: str | int, oversampling: int
) -> None:
    """Main function of a render process: answers (fields, qpos) with frames until it receives None."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process, which ends this one.
    try:
        renderer = TileRenderer(model, height, width, camera, oversampling)
    except PlatformError as error:
        connection.send(str(error))
        return
    connection.send(None)
    try:
        while (request := connection.recv()) is not None:
            connection.send_bytes(renderer.render(*request).tobytes())
    except (EOFError, OSError):
        pass  # The parent process is gone.
    finally:
        renderer.close()


class RenderPool:
    """Renders frames of one model in `workers` parallel processes. A single worker renders in this process."""

    def __init__(
        self,
        model: mujoco.MjModel,
        height: int,
        width: int,
        workers: int,
        camera: str | int = "context",
        oversampling: int = 1,
    ):
        self._size = (height, width)
        self._local: TileRenderer | None = None
        self._connections: list[Connection] = []
        self._processes: list[Any] = []
        if workers <= 1:
            self._local = TileRenderer(model, height, width, camera, oversampling)
            return
        os.environ.setdefault("LP_NUM_THREADS", "1")
        spawn = multiprocessing.get_context("spawn")
        try:
            for _ in range(workers):
                ours, theirs = spawn.Pipe()
                process = spawn.Process(
                    target=_serve, args=(theirs, model, height, width, camera, oversampling), daemon=True
                )
                process.start()
                theirs.close()
                self._connections.append(ours)
                self._processes.append(process)
            for connection in self._connections:
                if (problem := connection.recv()) is not None:
                    raise PlatformError(problem)
        except (EOFError, OSError) as error:
            self.close()
            raise PlatformError(DEAD_WORKER) from error
        except PlatformError:
            self.close()
            raise

    @classmethod
    def of(cls, task: Task, workers: int) -> RenderPool:
        """Create a pool that renders the task's frames."""
        return cls(task.model, *task.frame_size, workers, task.camera, task.oversampling)

    def render(self, fields: dict[str, np.ndarray], qpos: np.ndarray) -> np.ndarray:
        """Render frames (V, T, H, W, 3) of V videos, as `TileRenderer.render` does."""
        if self._local is not None:
            return self._local.render(fields, qpos)
        try:
            return self._render(fields, qpos)
        except (EOFError, OSError) as error:
            raise PlatformError(DEAD_WORKER) from error

    def _render(self, fields: dict[str, np.ndarray], qpos: np.ndarray) -> np.ndarray:
        """Distribute the pieces over the free processes."""
        cuts = pieces(*qpos.shape[:2])
        out = np.empty((*qpos.shape[:2], *self._size, 3), np.uint8)
        waiting = list(reversed(range(len(cuts))))
        drawing: dict[Any, int] = {}

        def send_next(connection: Connection) -> None:
            """Send one piece to a process. Sending two could deadlock, with both ends waiting for the other to read."""
            if waiting:
                drawing[connection] = index = waiting.pop()
                videos, frames = cuts[index]
                connection.send(({k: v[videos] for k, v in fields.items()}, qpos[videos, frames]))

        for connection in self._connections:
            send_next(connection)
        while drawing:
            for ready in cast("list[Connection]", multiprocessing.connection.wait(list(drawing))):
                frames_of_piece = out[cuts[drawing.pop(ready)]]
                pixels = np.frombuffer(ready.recv_bytes(), np.uint8)
                send_next(ready)
                frames_of_piece[:] = pixels.reshape(frames_of_piece.shape)
        return out

    def close(self) -> None:
        """End the processes and free their GL contexts."""
        if self._local is not None:
            self._local.close()
        for connection in self._connections:
            try:
                connection.send(None)
                connection.close()
            except OSError:
                pass  # The process has already ended.
        for process in self._processes:
            process.join(timeout=5)
            if process.is_alive():
                process.terminate()
        self._connections, self._processes = [], []

    def __enter__(self) -> RenderPool:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
