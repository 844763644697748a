"""The training loop: what its curve holds, when it checkpoints, what it resumes, and where it gives up."""

import dataclasses

import numpy as np
import pytest
import torch

from artifacts import Interrupted, UsageError, read_artifact, write_artifact
from stages.config.stages import TranslatorConfig
from stages.runtime.checkpoints import Checkpoints
from stages.runtime.progress import Progress
from stages.runtime.run import RunOptions
from stages.train_translator import train_translator
from stages.translation.loop import train
from stages.translation.training import TranslatorTraining

CONFIG = TranslatorConfig(steps=10, videos=3, frames=2, evaluate_every=4, checkpoint_every=3)
FRAMES = torch.randint(0, 256, (5, 4, 16, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))


class Recorded(Checkpoints):
    """Checkpoints that remember the steps they were written at."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.steps = []

    def save(self, state):
        super().save(state)
        self.steps.append(state["training"]["step"])


@pytest.fixture
def loop(tmp_path):
    """A function that trains: (training, curve, steps evaluated at, steps checkpointed at)."""

    def run(
        name="x",
        config=CONFIG,
        stop=None,
        resume=True,
        seed=3,
        change=None,
        progress=None,
        evaluation=None,
        errors=None,
        draw=None,
    ):
        training = TranslatorTraining(config, FRAMES, seed, "cpu")
        if change is not None:
            change(training)
        evaluated = []
        options = RunOptions(
            seed=seed, resume=resume, progress=progress or Progress(quiet=True), command="ifo train-translator x"
        )
        out = tmp_path / f"{name}.translator.h5"
        checkpoints = Recorded(options, out, "train-translator", {"steps": config.steps}, [])

        def evaluate(model):
            assert model is training.average
            if stop is not None and training.step >= stop:
                raise KeyboardInterrupt
            evaluated.append(training.step)
            if evaluation is not None:
                evaluation()
            trans = (errors or {}).get(training.step, 20.0 - training.step)
            return {"psnr": 10.0 + training.step, "copy_psnr": 9.0, "ssim": 0.5, "feature_ratio": 0.7, "trans": trans}

        try:
            curve = train(training, evaluate, options, out, checkpoints, draw)
        except Interrupted as error:
            curve = error
        return training, curve, evaluated, checkpoints.steps

    return run


def test_evaluates_regularly_and_at_the_end_and_keeps_checkpoints_on_the_way(loop):
    training, curve, evaluated, kept = loop()
    assert training.step == 10
    assert evaluated == [4, 8, 10]
    assert kept == [3, 6, 9]
    losses, metrics = ("trans", "rec", "align"), ("psnr", "copy_psnr", "ssim", "feature_ratio", "trans")
    assert set(curve) == {"step", "seconds", *(f"train/{n}" for n in losses), *(f"held_out/{n}" for n in metrics)}
    assert curve["step"] == [4.0, 8.0, 10.0]
    assert curve["held_out/psnr"] == [14.0, 18.0, 20.0]
    assert all(0 < seconds < 60 for seconds in curve["seconds"])
    again = TranslatorTraining(CONFIG, FRAMES, 3, "cpu")
    told = [again.train_step() for _ in range(10)]
    for name in losses:
        assert curve[f"train/{name}"] == [float(told[step - 1][name]) for step in (4, 8, 10)]


def test_translations_are_drawn_at_some_evaluations_and_at_the_end(loop, tmp_path, monkeypatch):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    def draw(model):
        drawn.append(model)
        return np.zeros((4, 4, 3), np.uint8)

    for name, pictures, steps, expected in (("all", 20, 10, [4, 8, 10]), ("few", 2, 10, [8, 10]), ("none", 20, 0, [0])):
        drawn = []
        monkeypatch.setattr("stages.translation.loop.PICTURES", pictures)
        training, _, _, _ = loop(name, config=dataclasses.replace(CONFIG, steps=steps), draw=draw)
        assert all(model is training.average for model in drawn)
        found = EventAccumulator(str(tmp_path / f"{name}.translator.tensorboard")).Reload()
        assert [event.step for event in found.Images("held-out translations")] == expected
        assert found.Tags()["tensors"] == ["configuration/text_summary"]


def test_the_last_step_is_not_checkpointed_since_the_artifact_follows(loop):
    assert loop(config=dataclasses.replace(CONFIG, steps=6))[3] == [3]


def test_no_steps_are_measured_once(loop):
    training, curve, evaluated, kept = loop(config=dataclasses.replace(CONFIG, steps=0))
    assert (training.step, evaluated, kept) == (0, [0], [])
    assert curve["step"] == [0.0] and curve["held_out/psnr"] == [10.0] and "train/rec" not in curve


def test_an_interrupted_training_resumes_with_the_same_weights_and_curve(loop):
    whole, curve, _, _ = loop("whole")
    _, interrupted, evaluated, kept = loop("parts", stop=8)
    assert "interrupted after 8 of 10 steps" in str(interrupted)
    assert (evaluated, kept) == ([4], [3, 6])
    resumed, continued, evaluated, kept = loop("parts")
    assert (evaluated, kept) == ([8, 10], [9]), "it goes on from step 6"
    for name, values in curve.items():
        assert len(continued[name]) == 3
        if name != "seconds":
            assert continued[name] == values, name
    for name, value in whole.average.state_dict().items():
        assert torch.equal(value, resumed.average.state_dict()[name]), name


def test_seconds_are_those_since_the_last_evaluation_whatever_happened_in_between(loop, monkeypatch):
    """Of a clock by which a step takes one second, an evaluation ten and everything else nothing."""
    now = [100.0]
    monkeypatch.setattr("stages.translation.loop.time.monotonic", lambda: now[0])

    def slow(training):
        step = training.train_step

        def taking_a_second():
            now[0] += 1
            return step()

        training.train_step = taking_a_second

    def evaluation():
        now[0] += 10

    _, curve, _, _ = loop("whole", change=slow, evaluation=evaluation)
    assert curve["seconds"] == [14.0, 14.0, 12.0]
    loop("parts", change=slow, evaluation=evaluation, stop=8)
    now[0] += 5000
    _, curve, _, _ = loop("parts", change=slow, evaluation=evaluation)
    assert curve["seconds"] == [14.0, 14.0, 12.0], "steps that are done again count once"


def test_losses_that_are_no_numbers_stop_the_training(loop):
    def spoil(training):
        next(training.model.parameters()).data.fill_(float("nan"))

    with pytest.raises(UsageError, match=r"^--learning-rate 0\.001: .* 4 steps, .* lower learning rate$") as caught:
        loop(change=spoil)
    assert "\n" not in str(caught.value)


def test_says_how_long_it_took_and_how_far_it_is(loop, capsys):
    loop("told", progress=Progress())
    said = capsys.readouterr().err
    assert "train-translator (compact): 10/10 steps" in said
    assert ", trans " in said and ", rec " in said and "psnr 20" in said and "ssim 0.5" in said
    assert "translator: 10 steps in" in said
    loop("parts", stop=8)
    loop("parts", progress=Progress())
    assert "translator: 4 steps in" in capsys.readouterr().err


def weights(training):
    return torch.cat([value.flatten() for value in training.average.state_dict().values()])


def test_the_best_weights_are_kept_also_over_an_interruption(loop):
    before = TranslatorTraining(CONFIG, FRAMES, 3, "cpu")
    for _ in range(4):
        before.train_step()
    rising = {4: 1.0, 8: 2.0, 10: float("nan")}
    training, curve, _, _ = loop("whole", errors=rising)
    assert training.best.step == 4 and torch.equal(weights(training), weights(before))
    assert curve["held_out/trans"][:2] == [1.0, 2.0]
    loop("parts", errors=rising, stop=8)
    resumed, _, evaluated, _ = loop("parts", errors=rising)
    assert evaluated == [8, 10] and torch.equal(weights(resumed), weights(before))


@pytest.mark.parametrize("change", [{"keep": "last"}, {"without": ("trans",)}])
def test_the_last_weights_are_kept_if_asked_for_or_if_images_are_not_learned(loop, change):
    config = dataclasses.replace(CONFIG, **change)
    training, *_ = loop(config=config, errors={4: 1.0, 8: 2.0, 10: 3.0})
    last = TranslatorTraining(config, FRAMES, 3, "cpu")
    for _ in range(10):
        last.train_step()
    assert training.best.step == 0 and torch.equal(weights(training), weights(last))


@pytest.mark.parametrize("wrong", [{"weights": {}}, {"weights": 3}, {"step": "x"}, {"error": None}])
def test_best_weights_that_do_not_fit_are_refused(loop, wrong):
    training, *_ = loop(errors={4: 1.0})
    state = training.best.state()
    other = TranslatorTraining(CONFIG, FRAMES, 4, "cpu")
    with pytest.raises((KeyError, RuntimeError, TypeError, ValueError)):
        other.best.restore({**state, **wrong}, other.average)
    other.best.restore(state, other.average)
    assert other.best.error == 1.0


def test_the_number_of_threads_that_share_the_groups_changes_no_bit(tmp_path, monkeypatch):
    frames = torch.randint(0, 256, (12, 4, 16, 16, 3), dtype=torch.uint8).numpy()
    demos = write_artifact(tmp_path / "x.demos.h5", "demos", {"frames": frames}, config={}, seed=0, command="ifo test")
    config = TranslatorConfig(steps=6, videos=3, frames=2, groups=2)
    pools = []
    step = TranslatorTraining._in_threads
    monkeypatch.setattr(
        TranslatorTraining, "_in_threads", lambda self: pools.append(self._pool._max_workers) or step(self)
    )
    found = []
    for workers in (1, 2, 3):
        run = RunOptions(seed=3, device="cpu", workers=workers, out=tmp_path / f"{workers}.translator.h5")
        train_translator(config, run, demos)
        found.append(read_artifact(run.out, "translator").group("weights"))
    assert pools == [2] * 12, "one worker needs no threads, and two groups no third"
    assert torch.get_num_threads() == 1
    for other in found[1:]:
        assert all(np.array_equal(value, other[name]) for name, value in found[0].items())
