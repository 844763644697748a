"""What a file records of an environment, and what of it is used only with the user's permission."""

import numpy as np
import pytest

from artifacts import ArtifactError, UsageError, read_artifact, write_artifact
from stages.config.demonstrations import Crop
from stages.config.environments import check_success, parse_kwargs, parse_viewpoint, permission_needed
from stages.environments.spec import EnvironmentSpec
from stages.environments.viewpoints import Viewpoint

VIEW, CROP = Viewpoint(1, -2, 0.5), Crop(1, 2, 90, 80)
FULL = EnvironmentSpec("Reacher-v5", {"width": 96, "reward_dist_weight": 0.5}, 3, 50, 25, (48, 64), CROP, VIEW)


@pytest.fixture
def recorded(tmp_path):
    """A function (environment, changed fields) -> a file that records it."""

    def write(spec, **changed):
        config = {"environment": {**spec.described(), **changed}}
        frames = np.zeros((4, 2, 8, 8, 3), np.uint8)
        path = tmp_path / "x.demos.h5"
        return write_artifact(path, "demos", {"frames": frames}, config=config, seed=0, command="ifo")

    return write


def test_a_file_records_all_of_it(recorded):
    assert EnvironmentSpec.of(read_artifact(recorded(FULL))) == FULL


def test_files_without_environment_have_none(tmp_path):
    frames = np.zeros((4, 2, 8, 8, 3), np.uint8)
    path = write_artifact(tmp_path / "x.demos.h5", "demos", {"frames": frames}, config={}, seed=0, command="ifo")
    assert EnvironmentSpec.of(read_artifact(path)) is None


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"name": "my_code:Env"}, "the file names 'my_code:Env'"),
        ({"success": "my_code:good"}, "the file names 'my_code:good'"),
        ({"kwargs": {"xml_file": "/etc/passwd"}}, "the file passes xml_file='/etc/passwd' to environment 'Reacher-v5'"),
        ({"kwargs": {"render_kwargs": {"path": ["a", "../b"]}}}, "which may open other files"),
        ({"kwargs": {"xml_file": "model.xml"}}, "which may open other files"),
    ],
)
def test_code_and_paths_in_a_file_need_permission(recorded, changed, words, monkeypatch):
    monkeypatch.delenv("IFO_ENVS", raising=False)
    path = recorded(FULL, **changed)
    with pytest.raises(UsageError) as caught:
        EnvironmentSpec.of(read_artifact(path))
    assert words in str(caught.value) and "export IFO_ENVS=" in str(caught.value)
    monkeypatch.setenv("IFO_ENVS", "other:Env, my_code:Env,Reacher-v5,my_code:good")
    assert EnvironmentSpec.of(read_artifact(path)) is not None


def test_what_must_still_be_permitted_is_added_to_what_is(recorded, monkeypatch):
    monkeypatch.setenv("IFO_ENVS", "b:Env")
    with pytest.raises(UsageError, match=r"export IFO_ENVS=a:Env,b:Env$"):
        EnvironmentSpec.of(read_artifact(recorded(FULL, name="a:Env")))
    assert permission_needed("b:Env", {}, "") == "" == permission_needed("Reacher-v5", {"width": 3}, "")
    assert permission_needed("a:Env", {}, "c:good").endswith("export IFO_ENVS=a:Env,c:good")


@pytest.mark.parametrize(
    "changed",
    [
        {"seed": -1},
        {"seed": 2**40},
        {"control_steps": 0},
        {"frames": 1},
        {"size": [48]},
        {"size": [0, 48]},
        {"crop": [1, 2, 3]},
        {"viewpoint": [1.0, float("inf"), 1.0]},
        {"name": ""},
        {"name": 3},
        {"kwargs": []},
        {"success": None},
        {"other": 1},
        {"frames": 200},
    ],
)
def test_a_record_that_is_none_is_refused_with_the_file(recorded, changed):
    with pytest.raises(ArtifactError, match=r"x\.demos\.h5"):
        EnvironmentSpec.of(read_artifact(recorded(FULL, **changed)))


def test_options_are_parsed():
    assert parse_kwargs(["a=1", "b=two", "c=true", 'd={"e": [0.5]}', "f="]) == {
        "a": 1,
        "b": "two",
        "c": True,
        "d": {"e": [0.5]},
        "f": "",
    }
    assert parse_viewpoint("") is None and parse_viewpoint("30,-10,0.5") == (30, -10, 0.5)
    check_success("")
    check_success("reacher:reached")


@pytest.mark.parametrize("text", ["30", "a,b,c", "nan,0,1", "0,0,0", "0,0,-1", "400,0,1", "0,95,1", "1,2,3,4"])
def test_what_is_no_viewpoint_is_refused(text):
    with pytest.raises(UsageError, match=f"--viewpoint {text}: expected AZIMUTH,ELEVATION,DISTANCE"):
        parse_viewpoint(text)


@pytest.mark.parametrize("words", [["a"], ["1a=2"], ["=2"], ["a=1", "a=2"]])
def test_what_is_no_keyword_argument_is_refused(words):
    with pytest.raises(UsageError, match="--env-kwargs"):
        parse_kwargs(words)


@pytest.mark.parametrize("name", ["reached", "reacher:", ":reached", "reacher:a.b"])
def test_what_is_no_function_is_refused(name):
    with pytest.raises(UsageError, match="expected MODULE:ATTR"):
        check_success(name)
