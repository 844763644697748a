"""import-demos holds only the frames that it takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]


def test_memory_does_not_grow_with_the_video(tmp_path):
    size, count = (1080, 1920), 300
    path = write_large(tmp_path / "large.mp4", size, count)
    # Not getrusage's ru_maxrss, which counts the process that started this one.
    code = (
        "import sys; from ifo_cli.main import main; code = main(sys.argv[1:]);"
        "print(code, next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    words = ["import-demos", str(path), "--out", str(tmp_path / "x.demos.h5"), "--quiet"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, cwd=ROOT, check=True)
    status, peak = done.stdout.splitlines()[-1].split()
    whole = count * size[0] * size[1] * 3
    assert status == "0" and int(peak) * 1024 < 400 * 2**20 < whole / 4


def write_large(path, size, count):
    """Grey pictures of that size, quickly."""
    import av

    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=30)
        (stream.height, stream.width), stream.pix_fmt = size, "yuv420p"
        stream.options = {"preset": "ultrafast", "g": "60"}
        frames = [av.VideoFrame.from_ndarray(np.full((*size, 3), k, np.uint8), format="rgb24") for k in (0, 200)]
        frames = [frame.reformat(format="yuv420p") for frame in frames]
        for k in range(count):
            frame = frames[k // 30 % 2]
            frame.pts = k
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path
