"""Written by `python -m tests.ifo.make_stub`: the stages of the pipeline, with the types of all options."""

from collections.abc import Sequence
from os import PathLike
from typing import Literal, TypedDict, Unpack

from stages.runtime.run import StageResult as StageResult

AnyPath = str | PathLike[str]

class CommonOptions(TypedDict, total=False):
    preset: Literal["toy", "quick", "paper"] | None
    overwrite: bool | None
    out: AnyPath | None
    quiet: bool | None

class TrainExpertOptions(CommonOptions, total=False):
    seed: int | None
    workers: int | None
    resume: bool | None
    learner: Literal["trpo", "ppo", "sac"] | None
    iterations: int | None
    episodes: int | None
    hidden: int | None
    kl: float | None
    discount: float | None
    gae_lambda: float | None
    log_std: float | None
    critic_rate: float | None
    updates: float | None
    patience: int | None
    checkpoint_every: int | None
    contexts: Literal["paper", "narrow", "fixed"] | None
    vary: str | None
    test_contexts: int | None
    test_episodes: int | None

def train_expert(task: str, **options: Unpack[TrainExpertOptions]) -> StageResult: ...

class CollectDemosOptions(CommonOptions, total=False):
    expert: AnyPath | None
    seed: int | None
    workers: int | None
    n: int | None
    contexts: Literal["paper", "narrow", "fixed"] | None
    vary: str | None
    context_seed: int | None
    keep_failures: bool | None
    jitter: float | None
    videos: str | None
    crf: int | None
    demonstrator: str | None
    env_kwargs: Sequence[str] | None
    success: str | None
    episode_steps: int | None
    frames: int | None
    size: str | None
    crop: str | None
    viewpoint: str | None
    azimuth: float | None
    elevation: float | None
    distance: float | None

def collect_demos(task: str, **options: Unpack[CollectDemosOptions]) -> StageResult: ...

class ImportDemosOptions(CommonOptions, total=False):
    preview: bool | None
    frames: int | None
    size: str | None
    start: float | None
    end: float | None
    fps: float | None
    crop: str | None
    crop_file: str | None
    task: str | None
    strict: bool | None
    camera: str | None

def import_demos(videos: AnyPath | Sequence[AnyPath], **options: Unpack[ImportDemosOptions]) -> StageResult: ...

class TrainTranslatorOptions(CommonOptions, total=False):
    base: AnyPath | None
    seed: int | None
    workers: int | None
    device: str | None
    resume: bool | None
    arch: Literal["compact", "paper", "real"] | None
    steps: int | None
    videos: int | None
    frames: int | None
    pairings: int | None
    groups: int | None
    rec_frames: int | None
    trans_frames: int | None
    learning_rate: float | None
    schedule: Literal["cosine", "constant"] | None
    weight_decay: float | None
    lambda_rec: float | None
    lambda_align: float | None
    without: Sequence[Literal["trans", "rec", "align"]] | None
    align: Literal["none", "dtw"] | None
    motion_weight: float | None
    mirror: bool | None
    swap_colours: bool | None
    augment: bool | None
    ema: float | None
    keep: Literal["best", "last"] | None
    held_out: int | None
    evaluate_every: int | None
    checkpoint_every: int | None
    amp: bool | None
    compile: bool | None

def train_translator(demos: AnyPath, **options: Unpack[TrainTranslatorOptions]) -> StageResult: ...

class TranslateOptions(CommonOptions, total=False):
    seed: int | None
    workers: int | None
    device: str | None
    n: int | None
    split: Literal["held-out", "all"] | None
    align: Literal["none", "dtw"] | None
    context_seed: int | None
    contexts: Literal["paper", "narrow", "fixed"] | None
    vary: str | None
    context_image: str | None
    env: str | None
    env_kwargs: Sequence[str] | None
    env_seed: int | None
    viewpoint: str | None
    success: str | None
    episode_steps: int | None
    demonstrator: str | None
    untranslated: bool | None
    crop: str | None

def translate(translator: AnyPath, **options: Unpack[TranslateOptions]) -> StageResult: ...

class LearnPolicyOptions(CommonOptions, total=False):
    seed: int | None
    workers: int | None
    device: str | None
    resume: bool | None
    learner: Literal["trpo", "ppo", "sac", "gps"] | None
    iterations: int | None
    episodes: int | None
    hidden: int | None
    kl: float | None
    discount: float | None
    gae_lambda: float | None
    log_std: float | None
    critic_rate: float | None
    updates: float | None
    patience: int | None
    checkpoint_every: int | None
    reward: Literal["translation", "oracle", "video", "pretrained", "gail", "tpil", "joints"] | None
    without: Sequence[Literal["feat", "img"]] | None
    image_weight: float | None
    blur: float | None
    fine_blur: float | None
    starts: int | None
    negatives: int | None
    layer: str | None
    weights: str | None
    discriminator_steps: int | None
    discriminator_rate: float | None
    ramp: Literal["task", "none", "quadratic"] | None

def learn_policy(translation: AnyPath, **options: Unpack[LearnPolicyOptions]) -> StageResult: ...

class EvaluateOptions(CommonOptions, total=False):
    seed: int | None
    workers: int | None
    episodes: int | None

def evaluate(policies: AnyPath | Sequence[AnyPath], **options: Unpack[EvaluateOptions]) -> StageResult: ...
