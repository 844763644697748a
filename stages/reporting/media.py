"""What there is to see of one artifact: curves, pictures and videos, for its page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from artifacts import Artifact, ArtifactError, UsageError, contact_sheet, mp4_bytes, overview, png_bytes, sibling
from stages.reporting import videos
from stages.reporting.description import CURVE
from stages.reporting.environment_runs import read_environment_runs, summarise_environments
from stages.reporting.grids import SHOWN, translation_grid
from stages.reporting.page import Section, sections_of
from stages.reporting.plots import LABELS, draw, draw_environments, plot_curves, plot_learning_curves, plot_quality
from stages.reporting.records import of_environment
from stages.reporting.rows import read_runs
from stages.reporting.summary import summarise
from stages.reporting.tables import environment_table, summary_table
from stages.reporting.videos import Video

MOST_READ = 2**26  # bytes of frames that are decoded for a picture
MOST_DRAWN = 2**28  # bytes of the frames of a video before it is encoded
SIDE = 192  # pixels; smaller frames are enlarged to about this height
FIRST, SPREAD = 24, 20  # demonstrations in the video, and in the contact sheet


@dataclass
class Media:
    """Curves and pictures, videos, and one line on each that cannot be shown."""

    sections: list[Section] = field(default_factory=list)
    videos: list[Video] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def draw(self, heading: str, caption: str, png: bytes) -> None:
        """Add a plot or picture."""
        if self._has_room(heading, png):
            self.sections.append(Section(heading, caption, png))

    def show(self, title: str, frames: np.ndarray) -> None:
        """Add a video of frames (T, H, W, 3)."""
        data = mp4_bytes(frames)
        if self._has_room(title, data):
            self.videos.append(Video("", title, None, data))

    def _has_room(self, title: str, data: bytes) -> bool:
        """Whether the page has room for a file; if not, says so."""
        if self.size + len(data) <= videos.MOST_BYTES:
            return True
        self.notes.append(f"Left out because a page holds at most {videos.MOST_BYTES / 1e6:.0f} MB: {title}.")
        return False

    def read(self, title: str, artifact: Artifact) -> None:
        """Add the MP4 next to an artifact."""
        found = videos.read_videos([("", title, sibling(artifact.path, ".mp4"))], self.size)
        self.videos += found.shown
        self.notes += found.notes

    @property
    def size(self) -> int:
        """Size of all pictures and videos."""
        pictures = sum(len(section.png or b"") for section in self.sections)
        return pictures + sum(len(video.data) for video in self.videos)


def media_of(artifact: Artifact) -> Media:
    """Draw the curves, pictures and videos of an artifact.

    No code that a file names is imported, and policies are not run: their videos are read from the MP4s beside them.

    Raises:
        ArtifactError: The data is damaged.
    """
    media = Media()
    OF_KIND[artifact.kind](artifact, media)
    return media


def _of_learning(artifact: Artifact, media: Media) -> None:
    """The learning curve of an expert or a policy."""
    curve = next((name for name in LABELS if f"{CURVE}/{name}" in artifact), None)
    if curve is None or not _fits(artifact, f"{CURVE}/samples", f"{CURVE}/{curve}"):
        media.notes.append("The file has no learning curve.")
        return
    drawn = plot_learning_curves([artifact], None, curve, LABELS[curve])
    media.draw("Learning curve", f"{LABELS[curve]}, over samples.".capitalize(), drawn)


def _of_policy(artifact: Artifact, media: Media) -> None:
    _of_learning(artifact, media)
    media.read("The target that the policy tracks, and one episode of the policy", artifact)


def _of_demos(artifact: Artifact, media: Media) -> None:
    """A contact sheet of demonstrations from all of the file, and a video of the first ones."""
    count, length, height, width = artifact.describe()["frames"][0][:4]
    size = length * height * width * 3
    affordable = min(MOST_READ // size, MOST_DRAWN // (size * _scale(height) ** 2))
    if not affordable:
        media.notes.append("The demonstrations are too large to be shown here: see the MP4 next to the file.")
        return
    spread = np.unique(np.linspace(0, count - 1, min(SPREAD, count, affordable)).round().astype(int))
    sheet = contact_sheet(np.stack([artifact.read("frames", int(k)) for k in spread]), n=SPREAD)
    caption = "Demonstrations from all of the file, each as a strip of frames from its first to its last."
    media.draw("Demonstrations", caption, png_bytes(sheet))
    first = artifact.read("frames", slice(min(FIRST, affordable)))
    media.show("The first demonstrations", overview(first))


def _of_translator(artifact: Artifact, media: Media) -> None:
    """Losses, and errors on held-out videos, over the steps of training."""
    prefix = f"{CURVE}/"
    names = [name for name in artifact.names(prefix) if name not in (f"{prefix}step", f"{prefix}seconds")]
    shown = [name for name in names if _fits(artifact, f"{prefix}step", name)]
    if not shown:
        media.notes.append("The file has no training curves.")
        return
    drawn = plot_curves(artifact[f"{prefix}step"], {name.removeprefix(prefix): artifact[name] for name in shown})
    caption = "Losses on training and held-out videos, and errors on held-out videos, over training steps."
    media.draw("Training curves", caption, drawn)


def _of_translation(artifact: Artifact, media: Media) -> None:
    """Source, translation and target side by side, and how well the reward ranks progress."""
    quality = artifact.group("quality")
    if _is_quality(quality):
        caption = "Both terms of the reward, and the distance, of the expert, with noise, and of random actions."
        media.draw("The reward before learning", caption, plot_quality(quality))
    length, height, width = artifact.describe()["target_images"][0][:3]
    scale = _scale(height)
    if (SHOWN + 1) * 4 * length * height * width * 3 * scale**2 > MOST_DRAWN:
        media.notes.append("The translations are too large to be shown here: see the MP4 next to the file.")
        return
    arrays = {name: artifact[name] for name in ("context_frame", "target_images", "expert_frames") if name in artifact}
    count, sources = 0, []
    if "images" in artifact and "demonstrations" in artifact:
        arrays["images"] = artifact.read("images", slice(SHOWN))
        arrays["demonstrations"] = artifact["demonstrations"].ravel()
        count = artifact.describe()["images"][0][0]
        sources = _sources(artifact, arrays["demonstrations"][: len(arrays["images"])], media)
    else:
        arrays |= {"images": np.empty(0), "demonstrations": np.empty(0)}
    untranslated = bool(artifact.config.get("untranslated"))
    grid = translation_grid(sources, arrays, count, untranslated, scale)
    media.show("Demonstrations, the learner's context, their translations, and the mean, which is the target", grid)


def _sources(artifact: Artifact, numbers: np.ndarray, media: Media) -> list[np.ndarray | str]:
    """The demonstrations with these numbers, each (T, H, W, 3), or texts in their place."""
    try:
        demos = artifact.parent("translator", check=True).parent("demos", check=True)
        found = demos.describe()["frames"][0]
        if numbers.dtype.kind not in "iu" or not all(0 <= number < found[0] for number in numbers):
            raise ArtifactError(f"{artifact.path}: names demonstrations that {demos.path} does not have")
        if found[1] * found[2] * found[3] * 3 * len(numbers) > MOST_READ:
            raise ArtifactError(f"{demos.path}: its videos are too large to be shown here")
        return [demos.read("frames", int(number)) for number in numbers]
    except ArtifactError as error:
        media.notes.append(f"Source videos are not shown: {error}")
        return ["not available"] * len(numbers)


def _of_evaluation(artifact: Artifact, media: Media) -> None:
    """Success rates and learning curves as `ifo report` shows them, and the video of the first policies."""
    try:
        if of_environment(artifact):
            environments = summarise_environments(read_environment_runs(artifact))
            tables, plots = {"environments": environment_table(environments)}, draw_environments(environments)
        else:
            summaries = summarise(read_runs(artifact))
            tables, plots = {"success": summary_table(summaries)}, draw(summaries)
        media.sections += sections_of(tables, plots)
    except (ArtifactError, UsageError) as error:
        media.notes.append(f"No table and no curves: {error}")
    media.read("One episode of each of the first policies", artifact)


OF_KIND: dict[str, Callable[[Artifact, Media], None]] = {
    "expert": _of_learning,
    "demos": _of_demos,
    "translator": _of_translator,
    "translation": _of_translation,
    "policy": _of_policy,
    "evaluation": _of_evaluation,
}


def _fits(artifact: Artifact, over: str, name: str) -> bool:
    """Whether two datasets can be drawn as a curve."""
    found = artifact.describe()
    shapes = [found[each] for each in (over, name) if each in found]
    return len(shapes) == 2 and all(
        len(shape) == 1 and shape == shapes[0][0] and dtype.kind in "fiu" for shape, dtype in shapes
    )


def _is_quality(curves: dict[str, Any]) -> bool:
    """Whether `curves` are what `plot_quality` draws."""
    names = [f"{kind}/{name}" for kind in ("expert", "noisy", "random") for name in ("feat", "img", "distance")]
    return all(name in curves and curves[name].ndim == 2 and curves[name].dtype.kind == "f" for name in names)


def _scale(height: int) -> int:
    return max(1, SIDE // height)
