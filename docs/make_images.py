"""Make the animated picture of the README and the documentation from the artifacts of a run.

    python docs/make_images.py runs/reach-c0.policy.h5

Four panels side by side, in a loop: a demonstration, the robot's context, the translation of this demonstration into
this context, and the learned policy. The policy's file leads to the others: they must be where they were made, or in
the same place relative to it.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont  # Pillow comes with matplotlib.

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

from artifacts import Artifact, read_artifact  # noqa: E402
from artifacts.atomic import write_bytes  # noqa: E402
from stages.environments.spec import EnvironmentSpec  # noqa: E402
from stages.runtime.seeding import generator  # noqa: E402
from stages.simulation.gl import choose_backend  # noqa: E402

LABELS = ("demonstration", "robot's context", "translation", "learned policy")
HEIGHT = 160  # pixels of a panel
GAP = 8  # pixels between panels
CAPTION = 24  # pixels above the panels
HOLD = 8  # times that the last frame is shown
MILLISECONDS = 100  # of a frame
MOST_BYTES = 1_000_000
QUALITIES = (90, 80, 70, 60, 50, 40, 30)


def source_index(translation: Artifact, translator: Artifact) -> np.ndarray:
    """Return the indices of the demonstrations that `ifo translate` chose, in the order of the dataset `images`."""
    count, held_out = translator.config["demonstrations"], translator.config["held_out_demonstrations"]
    candidates = np.arange(0 if translation.config["split"] == "all" else count - held_out, count)
    chosen = generator(translation.manifest.seed, "translate").permutation(candidates)
    return np.sort(chosen[: translation.config["n"]])


def policy_frames(policy: Artifact, shape: tuple[int, ...]) -> np.ndarray:
    """Return pictures of one deterministic episode, finely drawn, with the aspect ratio of frames (T, H, W, 3)."""
    from stages.reporting.judging import Foreign, Judge, Simulated

    spec = EnvironmentSpec.of(policy)
    judge: Judge = Simulated(policy.config["task"]) if spec is None else Foreign([spec], 1)
    film = judge.video(policy, 0)
    return film[:, : film.shape[2] * shape[1] // shape[2]]  # without the caption


def panels(policy: Artifact, which: int) -> list[np.ndarray]:
    """Return the four videos (T, H, W, 3); `which` of the translated demonstrations is shown."""
    translation = policy.parent("translation", check=True)
    translator = translation.parent("translator", check=True)
    demos = translator.parent("demos", check=True)
    index = source_index(translation, translator)
    if not 0 <= which < len(index):
        raise SystemExit(f"--demonstration {which}: {translation.path} has {len(index)}, from 0 on")
    demonstration = demos.read("frames", int(index[which]))
    context = np.broadcast_to(translation["context_frame"], demonstration.shape)
    return [demonstration, context, translation.read("images", which), policy_frames(policy, demonstration.shape)]


def enlarged(frame: np.ndarray, resampling: Image.Resampling) -> Image.Image:
    """Return a frame (H, W, 3) as an image of `HEIGHT` pixels."""
    height, width = frame.shape[:2]
    return Image.fromarray(frame).resize((round(HEIGHT * width / height), HEIGHT), resampling)


def composed(videos: list[np.ndarray], resampling: Image.Resampling) -> list[Image.Image]:
    """Return the pictures of the animation; shorter videos repeat their last frame."""
    font = ImageFont.load_default(14)
    pictures = []
    for at in [*range(max(map(len, videos))), *[-1] * HOLD]:
        cells = [enlarged(video[at if -1 <= at < len(video) else -1], resampling) for video in videos]
        width = sum(cell.width for cell in cells) + GAP * (len(cells) - 1)
        picture = Image.new("RGB", (width, HEIGHT + CAPTION), "white")
        draw, left = ImageDraw.Draw(picture), 0
        for label, cell in zip(LABELS, cells, strict=True):
            draw.text((left + cell.width / 2, CAPTION / 2), label, fill="black", font=font, anchor="mm")
            picture.paste(cell, (left, CAPTION))
            left += cell.width + GAP
        pictures.append(picture)
    return pictures


def encoded(pictures: list[Image.Image], suffix: str) -> bytes:
    """Return the looping animation as WebP or GIF, of the highest quality that fits into `MOST_BYTES`."""
    for quality in QUALITIES:
        options = {"quality": quality, "method": 4} if suffix == ".webp" else {"optimize": True}
        data = io.BytesIO()
        first, *others = pictures
        form = suffix.removeprefix(".")
        first.save(data, form, save_all=True, append_images=others, duration=MILLISECONDS, loop=0, **options)
        if data.tell() < MOST_BYTES:
            return data.getvalue()
    raise SystemExit(f"the animation has {data.tell()} bytes, more than {MOST_BYTES}: show fewer or smaller frames")


def main(words: list[str] | None = None) -> Path:
    """Write the animation and return its path."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", type=Path, help="policy artifact")
    parser.add_argument("--out", type=Path, default=DOCS / "images" / "pipeline.webp", help=".webp or .gif")
    parser.add_argument("--demonstration", type=int, default=0, help="which of the translated demonstrations is shown")
    parser.add_argument("--nearest", action="store_true", help="enlarge pixels without interpolation")
    arguments = parser.parse_args(words)
    if arguments.out.suffix not in (".webp", ".gif"):
        parser.error(f"--out {arguments.out}: expected .webp or .gif")
    choose_backend()
    resampling = Image.Resampling.NEAREST if arguments.nearest else Image.Resampling.LANCZOS
    pictures = composed(panels(read_artifact(arguments.policy, "policy"), arguments.demonstration), resampling)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    return write_bytes(arguments.out, encoded(pictures, arguments.out.suffix))


if __name__ == "__main__":
    print(main())
