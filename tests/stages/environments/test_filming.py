"""Other people's environments are filmed with any demonstrator, each episode in its own context."""

import itertools

import numpy as np
import pytest

from artifacts import ArtifactError
from stages.config.stages import DemosConfig
from stages.environments.demonstrators import load_demonstrator
from stages.environments.filming import Context, draw_contexts, film_all, film_successes
from stages.environments.making import EnvironmentFault
from stages.environments.spec import EnvironmentSpec
from stages.environments.viewpoints import Viewpoint

HERE = "tests.stages.environments.slides"
SPEC = EnvironmentSpec(f"{HERE}:Slide", {}, 0, 10, 3, (16, 16))


class Bar:
    def update(self, done, **values):
        self.done, self.values = done, values


def contexts(n):
    return [Context(seed, Viewpoint()) for seed in range(n)]


def test_any_number_of_processes_films_the_same_videos_in_the_same_order():
    filmed = {}
    for workers in (1, 2):
        filmed[workers] = list(film_all(SPEC, f"{HERE}:go_right", iter([*contexts(5), *contexts(9)]), workers))[:5]
    for (context, one), (other, two) in zip(filmed[1], filmed[2], strict=True):
        assert context == other and one.success and two.success
        np.testing.assert_array_equal(one.frames, two.frames)
        assert one.env_return == two.env_return
    assert filmed[1][0][1].frames.shape == (3, 16, 16, 3)
    assert len({one.frames.tobytes() for _, one in filmed[1]}) == 5, "each has its own seed"


def test_failures_are_dropped_and_a_demonstrator_that_mostly_fails_is_given_up():
    config, bar = DemosConfig(n=3), Bar()
    chosen, dropped = film_successes(SPEC, f"{HERE}:go_right", iter(contexts(9)), config, 1, bar)
    assert len(chosen) == 3 and dropped == 0 and bar.done == 3
    kept, dropped = film_successes(
        SPEC, f"{HERE}:go_left", iter(contexts(9)), DemosConfig(n=3, keep_failures=True), 1, bar
    )
    assert [filmed.success for _, filmed in kept] == [False] * 3 and dropped == 0
    with pytest.raises(ArtifactError, match=r"go_left: the demonstrator failed in 64 of 64 episodes"):
        film_successes(SPEC, f"{HERE}:go_left", iter(contexts(99)), config, 1, bar)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_demonstrator_whose_code_fails_is_named_with_the_place(workers):
    with pytest.raises(EnvironmentFault) as caught:
        list(film_all(SPEC, f"{HERE}:stumble", itertools.cycle(contexts(3)), workers))
    message = str(caught.value)
    assert f"demonstrator {HERE}:stumble failed at" in message and "slides.py:" in message and "\n" not in message
    assert "IndexError: no such action" in message


def test_demonstrators_are_functions_or_objects_or_saved_models(tmp_path):
    from stable_baselines3 import PPO, SAC

    from tests.stages.environments.slides import Slide

    assert load_demonstrator(f"{HERE}:go_right").act(None).tolist() == [2.0, 0.0]
    assert load_demonstrator(f"{HERE}:Remembering").act(None) == [2.0, 0.0]
    for algorithm in (PPO, SAC):
        model = algorithm("MlpPolicy", Slide(), seed=3, device="cpu")
        path = tmp_path / "model.zip"
        model.save(path)
        observation = np.array([0.2, 1.0])
        expected = model.predict(observation, deterministic=True)[0]
        np.testing.assert_allclose(load_demonstrator(str(path)).act(observation), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("slides", "expected MODULE:ATTR"),
        (f"{HERE}:absent", "has no absent"),
        (f"{HERE}:SIDE", "is a int, expected a function of an observation"),
        ("no_such_module:policy", "No module named 'no_such_module'"),
        ("absent.zip", "cannot be loaded"),
    ],
)
def test_what_is_no_demonstrator_is_refused_in_one_line(name, words):
    with pytest.raises(EnvironmentFault) as caught:
        load_demonstrator(name)
    assert words in str(caught.value) and name in str(caught.value) and "\n" not in str(caught.value)


def test_contexts_are_drawn_around_the_middle_and_do_not_depend_on_each_other():
    middle, ranges = Viewpoint(10, -5, 0.5), Viewpoint(45, 10, 0.2)
    drawn = list(itertools.islice(draw_contexts(3, middle, ranges), 200))
    assert drawn[:7] == list(itertools.islice(draw_contexts(3, middle, ranges), 7))
    views = np.array([context.viewpoint for context in drawn])
    assert (np.abs(views - middle) < [45, 10, 0.1]).all()
    assert (np.ptp(views, axis=0) > [80, 18, 0.18]).all(), "the whole range is used"
    assert len({context.seed for context in drawn}) == 200
    assert next(draw_contexts(3, middle, None)).viewpoint == middle


@pytest.mark.parametrize("workers", [1, 2])
def test_a_demonstrator_that_cannot_be_loaded_is_named_by_any_number_of_processes(workers):
    with pytest.raises(EnvironmentFault, match=f"^demonstrator {HERE}:absent: the module {HERE} has no absent$"):
        list(film_all(SPEC, f"{HERE}:absent", iter(contexts(3)), workers))


def test_an_action_that_is_none_is_the_demonstrators_fault():
    message = f"demonstrator {HERE}:lame failed .*its action is array"
    with pytest.raises(EnvironmentFault, match=message):
        list(film_all(SPEC, f"{HERE}:lame", iter(contexts(1)), 1))


def test_a_demonstrator_is_told_that_an_episode_begins():
    same = [Context(5, Viewpoint())] * 3
    filmed = [one for _, one in film_all(SPEC, f"{HERE}:Script", iter(same), 1)]
    assert len({one.env_return for one in filmed}) == 1


@pytest.mark.gl
def test_a_viewpoint_does_not_depend_on_what_was_filmed_before():
    spec = EnvironmentSpec("Reacher-v5", {}, 0, 50, 3, (16, 16), None, Viewpoint())
    wanted = Context(7, Viewpoint(20, -5, 0.6))
    frames = []
    for before in ([], [Context(1, Viewpoint(-40, 0, 1.0))], [Context(2, Viewpoint(0, 0, 0.5))]):
        *_, (_, last) = film_all(spec, f"{HERE}:go_right", iter([*before, wanted]), 1)
        frames.append(last.frames)
    np.testing.assert_array_equal(frames[1], frames[0])
    np.testing.assert_array_equal(frames[2], frames[0])
