"""Each --reward is made of the files behind a translation, and of the options that it has."""

import dataclasses
from contextlib import closing

import numpy as np
import pytest
import torch

from artifacts import ArtifactError, read_artifact, write_artifact
from stages.config.stages import PolicyConfig
from stages.environments.simulated import Camera, SimulatedEnvironment
from stages.environments.timing import Timing
from stages.rewards import adversarial, factory, negatives
from stages.rewards.adversarial import GailReward, TpilReward
from stages.rewards.factory import Simulated, make_reward
from stages.rewards.joints import JointsReward
from stages.rewards.pretrained import PretrainedReward
from stages.rewards.projected import BEYOND, ProjectedTrackingReward
from stages.rewards.state import GoalReward, OracleReward
from stages.rewards.tracking import TrackingTarget
from stages.rewards.translation import BatchTranslationReward
from stages.runtime.seeding import generator
from stages.simulation.contexts import repeat
from stages.simulation.registry import distribution, learner_context, make_task
from stages.simulation.render import RenderPool
from stages.translation.networks import CompactTranslator, load_translator

pytestmark = pytest.mark.gl
SEED = 3
TASK = "push-real"  # brings its own demonstrator, so that no expert needs to be trained


@pytest.fixture(scope="module")
def task():
    return make_task(TASK)


@pytest.fixture(scope="module")
def context(task):
    return learner_context(task, 5, distribution("paper"))


@pytest.fixture(scope="module")
def lineage(tmp_path_factory, task, context):
    """A function (fields of the demonstrations' configuration) -> a translation made from them."""
    rng = np.random.default_rng(0)
    height, width = task.frame_size
    frames = np.repeat(rng.integers(0, 60, (4, 1, height, width, 3), dtype=np.uint8), task.frames, axis=1)
    for t in range(task.frames):
        frames[:, t, 10:16, t : t + 6] = 240
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = CompactTranslator((height, width))
    weights = {f"weights/{name}": value.numpy() for name, value in network.state_dict().items()}
    features = rng.normal(size=(4, task.frames, len(network.encode(torch.zeros(1, 3, height, width))[0])))
    arrays = {
        "context_frame": frames[0, 0],
        "features": features.astype(np.float32),
        "images": frames,
        "target_features": features.mean(axis=0).astype(np.float32),
        "target_images": frames.mean(axis=0).astype(np.float32),
        "expert_frames": frames[0],
        "expert_features": features[1].astype(np.float32),
        "feature_scale": np.float32(40.0),
        "image_scale": np.float32(900.0),
        **{f"contexts/{name}": values for name, values in context.items()},
    }

    def make(expert=True, **fields):
        folder = tmp_path_factory.mktemp("files")
        config = {"stage": "collect-demos", "preset": "toy", "task": TASK, "contexts": "paper", "vary": "", **fields}
        about = {"seed": 0, "command": "ifo"}
        still = {"frames": frames, "initial_distance": np.ones(4), "final_distance": np.zeros(4)}
        still |= {f"contexts/{name}": np.repeat(values, 4, axis=0) for name, values in context.items()}
        demos = write_artifact(folder / "x.demos.h5", "demos", still, config=config, **about)
        about_network = {"arch": "compact", "size": [height, width]}
        translator = write_artifact(
            folder / "x.translator.h5", "translator", weights, config=about_network, parents=[demos], **about
        )
        kept = {name: value for name, value in arrays.items() if expert or not name.startswith("expert")}
        path = write_artifact(
            folder / "x.translation.h5", "translation", kept, config={"task": TASK}, parents=[translator], **about
        )
        return read_artifact(path, "translation")

    return make


@pytest.fixture(scope="module")
def source(lineage):
    return lineage()


@pytest.fixture(scope="module")
def camera(task, context):
    with closing(Camera(task, context, RenderPool.of(task, 1))) as opened:
        yield opened


@pytest.fixture
def made(task, context, camera):
    """A function that makes the reward of some options; closed at the end."""
    rewards = []

    def make(source, **options):
        simulated = Simulated(task, context, camera)
        rewards.append(make_reward(PolicyConfig(**options), source, simulated, SEED, "cpu"))
        return rewards[-1]

    yield make
    for reward in rewards:
        reward.close()


@pytest.fixture(scope="module")
def films(task):
    """Frames (2, H, W, 3) of some simulations."""
    return np.random.default_rng(1).integers(0, 256, (2, *task.frame_size, 3), dtype=np.uint8)


def test_the_oracle_needs_no_frames(made, source):
    assert type(made(source, reward="oracle")) is OracleReward
    assert type(made(source, reward="oracle", learner="gps")) is GoalReward


def kinesthetic(task, contexts, ramp):
    """The cost of a demonstration of joint angles in given contexts."""
    reward = JointsReward(task, task.kinesthetic(contexts), ramp)
    return reward.targets, reward.cost_weights


@pytest.mark.parametrize("ramp", ["quadratic", "none", "task"])
def test_joints_are_those_of_one_demonstration_in_another_context(made, source, task, ramp):
    reward = made(source, reward="joints", ramp=ramp)
    contexts = task.draw_contexts(generator(SEED, "kinesthetic"), 1, distribution("paper"))
    for found, expected in zip(
        (reward.targets, reward.cost_weights),
        kinesthetic(task, contexts, task.ramp if ramp == "task" else ramp),
        strict=True,
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("context_seed", [0, 7])
def test_joints_of_demonstrations_in_one_context_are_those_in_that_context(made, lineage, task, context_seed):
    """Seed 0 is a context, too; -1 says that each demonstration has its own."""
    reward = made(lineage(context_seed=context_seed, contexts="narrow"), reward="joints", ramp="none")
    contexts = learner_context(task, context_seed, distribution("narrow"))
    np.testing.assert_array_equal(reward.targets, kinesthetic(task, contexts, "none")[0])


def test_what_varied_in_the_demonstrations_varies_in_their_likes(made, lineage, task):
    reward = made(lineage(vary="goal", context_seed=-1), reward="joints", ramp="none")
    contexts = task.draw_contexts(generator(SEED, "kinesthetic"), 1, distribution("paper", "goal"))
    np.testing.assert_array_equal(reward.targets, kinesthetic(task, contexts, "none")[0])


def by_hand(task, source, expert=False, ramp="none", blur=4.0, **options):
    """The translation's reward, made from its parts."""
    target = TrackingTarget.of(source, blur, "cpu", expert)
    model = load_translator(source.parent("translator"))
    return BatchTranslationReward(
        Timing.regular(task.control_steps, task.frame_every), model, target, ramp=ramp, **options
    )


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({}, {"image_weight": 2.0}),
        ({"image_weight": 0.5, "blur": 0.0}, {"image_weight": 0.5, "blur": 0.0}),
        ({"without": ("feat",)}, {"image_weight": 2.0, "without": ("feat",)}),
        ({"ramp": "quadratic"}, {"image_weight": 2.0, "ramp": "quadratic"}),
        ({"reward": "video"}, {"image_weight": 2.0, "expert": True}),
    ],
)
def test_the_translation_is_tracked_as_the_options_say(made, source, task, context, films, options, parts):
    reward = made(source, **{"ramp": "none", **options})
    expected = by_hand(task, source, **parts)
    for frame in (1, task.frames - 1):
        np.testing.assert_allclose(reward.judge(frame, films), expected.judge(frame, films), rtol=1e-6)


def test_without_the_experts_video_there_is_none_to_track(made, lineage):
    with pytest.raises(ArtifactError, match="no video of the expert") as caught:
        made(lineage(expert=False), reward="video")
    assert "x.translation.h5" in str(caught.value) and "\n" not in str(caught.value)


def test_negatives_tune_the_features_every_so_many_iterations(made, source, films, monkeypatch):
    monkeypatch.setattr(negatives, "STEPS", 1)
    monkeypatch.setattr(negatives, "BATCH", 4)
    plain, tuned = made(source), made(source, negatives=2)
    assert plain.state() == {}
    assert tuned._tuning.every == 2 and tuned._tuning._seed == SEED
    np.testing.assert_array_equal(tuned._tuning._positives, source["images"])
    before = tuned.judge(3, films)
    np.testing.assert_allclose(before, plain.judge(3, films), rtol=1e-6)
    tuned.iterate()
    np.testing.assert_array_equal(tuned.judge(3, films), before)
    tuned.iterate()
    assert not np.array_equal(tuned.judge(3, films), before)


@pytest.mark.parametrize(
    ("options", "beyond", "fine"),
    [
        ({}, BEYOND, None),
        ({"fine_blur": 1.5}, BEYOND, 1.5),
        ({"without": ("img",)}, 0.0, None),
        ({"without": ("img",), "fine_blur": 1.5}, 0.0, None),
        ({"reward": "video", "fine_blur": 1.5}, BEYOND, 1.5),
    ],
)
def test_guided_policy_search_tracks_few_numbers_and_then_a_finer_target(made, source, films, options, beyond, fine):
    reward = made(source, learner="gps", ramp="none", image_weight=0.5, **options)
    assert type(reward) is ProjectedTrackingReward and reward._beyond == beyond
    assert (reward.finer is None) == (fine is None)
    expert = options.get("reward") == "video"
    exact = TrackingTarget.of(source, 4.0, "cpu", expert)
    model = load_translator(source.parent("translator"))
    error = 0.0
    if "img" not in options.get("without", ()):
        error = 0.5 * exact.image_error((torch.from_numpy(films).movedim(-1, 1) / 127.5 - 1), 3).numpy()
    error = error + exact.feature_error(model.encode(torch.from_numpy(films).movedim(-1, 1) / 127.5 - 1), 3).numpy()
    seen = reward._embed(films) - reward._embedded_target[3]
    np.testing.assert_allclose(np.square(seen).sum(axis=1), error, rtol=1e-4)
    if fine is not None:
        assert reward.finer._beyond == 1.0 and reward.finer.finer is None
        sharper = TrackingTarget.of(source, fine, "cpu", expert)
        shown = torch.from_numpy(films).movedim(-1, 1) / 127.5 - 1
        error = 0.5 * sharper.image_error(shown, 3) + sharper.feature_error(model.encode(shown), 3)
        seen = reward.finer._embed(films) - reward.finer._embedded_target[3]
        np.testing.assert_allclose(np.square(seen).sum(axis=1), error.numpy(), rtol=1e-4)


def test_discriminators_learn_from_the_demonstrations_as_scheduled(made, source, monkeypatch):
    monkeypatch.setattr(factory, "EXPERTS", 3)
    reward = made(source, reward="gail", discriminator_steps=7, discriminator_rate=2e-3)
    assert type(reward) is GailReward
    assert reward._schedule == adversarial.Schedule(7, 2e-3) and reward._seed == SEED
    np.testing.assert_array_equal(reward._experts, source.parent("translator").parent("demos")["frames"][:3])


def test_third_person_imitation_also_sees_random_actions_in_the_demonstrations_contexts(
    made, lineage, task, monkeypatch
):
    monkeypatch.setattr(factory, "UNSKILLED", 5)
    asked = []
    draw = factory._contexts_like
    monkeypatch.setattr(factory, "_contexts_like", lambda *given: asked.append(draw(*given)) or asked[-1])
    reward = made(lineage(context_seed=0), reward="tpil")
    assert type(reward) is TpilReward
    videos = reward._unskilled
    assert videos.shape == (5, task.frames, *task.frame_size, 3) and videos.dtype == np.uint8
    assert len(np.unique(videos.reshape(5, -1), axis=0)) > 1, "they move differently, where the camera sees the arm"
    for name, values in repeat(learner_context(task, 0, distribution("paper")), 5).items():
        np.testing.assert_array_equal(asked[0][name], values)
    again = made(lineage(context_seed=0), reward="tpil")
    np.testing.assert_array_equal(again._unskilled, videos, "the actions follow from the seed")


def test_imported_videos_show_no_simulated_contexts(lineage, context, camera):
    source = lineage(stage="import-demos", task="reach")
    with pytest.raises(ArtifactError, match="not filmed in simulated contexts"):
        make_reward(PolicyConfig(reward="tpil"), source, Simulated(make_task("reach"), context, camera), SEED, "cpu")


def test_pretrained_features_are_averaged_over_the_demonstrations(made, source, task, films, monkeypatch):
    from stages.rewards.networks import load_network
    from stages.rewards.pretrained import track

    monkeypatch.setattr(factory, "TRACKED", 3)
    reward = made(source, reward="pretrained", layer="block2", ramp="none")
    assert type(reward) is PretrainedReward
    network = load_network()
    target = track(network, source.parent("translator").parent("demos")["frames"][:3], "block2", "cpu")
    *_, (_, features) = network.features(torch.from_numpy(films).movedim(-1, 1) / 127.5 - 1, "block2")
    np.testing.assert_allclose(reward.judge(3, films), -target.error(features, 3).numpy() / task.frames, rtol=1e-5)


def test_pretrained_features_are_projected_for_guided_policy_search(made, source, task, films, monkeypatch):
    monkeypatch.setattr(factory, "COMPONENTS", 7)
    reward = made(source, reward="pretrained", learner="gps", layer="block2")
    assert type(reward) is ProjectedTrackingReward
    assert reward.targets.shape == (task.control_steps + 1, 7) and reward._beyond == 0


def test_a_changed_file_behind_the_translation_is_told(made, lineage):
    source = lineage()
    demos = source.parent("translator").parent("demos").path
    write_artifact(
        demos,
        "demos",
        {"frames": np.zeros((2, 3, 4, 4, 3), np.uint8), "final_distance": np.zeros(2)},
        config={},
        seed=0,
        command="",
    )
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5"):
        made(source, reward="gail")


def test_rewards_run_in_the_learners_environment(made, source, task, context, camera):
    reward = made(source, image_weight=1.0)
    small = dataclasses.replace(PolicyConfig(), episodes=2)
    env = SimulatedEnvironment(
        task, small.episodes, 0, lambda rng, n: repeat(context, n), reward, nthread=1, camera=camera
    )
    env.reset()
    paid = [env.step(np.zeros((2, task.action_size)))[1] for _ in range(task.frame_every)]
    assert not np.any(paid[:-1]) and (paid[-1] < 0).all()
