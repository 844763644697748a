"""What an evaluation must record of each of its runs; anyone may have written the file."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from artifacts import Artifact, ArtifactError
from artifacts.schema import Config


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


class _Translator(_Record):
    steps: int | None = None
    without: list[str] | None = None
    align: str | None = None
    minutes: float | None = None


class _Run(_Record):
    policy: str = ""
    reward: str
    without: list[str] | None = None
    seed: int
    context_seed: int
    samples: float
    learning_minutes: float
    own_context: bool | None = None
    translator: _Translator | None = None
    translation_metrics: dict[str, float | None] | None = None


class _Evaluation(_Record):
    task: str
    success_threshold: float | None = None
    runs: list[_Run]


class _Environment(_Record):
    name: str
    kwargs: dict[str, Any]
    seed: int
    control_steps: int
    success: str = ""


class _EnvironmentRun(_Run):
    samples: int
    environment: _Environment


class _EnvironmentEvaluation(_Record):
    runs: list[_EnvironmentRun]


def of_environment(evaluation: Artifact) -> bool:
    """Whether an evaluation is of policies in a Gymnasium environment, which have no distance to a goal."""
    return "env_return" in evaluation


def checked_records(evaluation: Artifact) -> list[dict[str, Any]]:
    """The records of an evaluation's runs, whose fields have the types that tables and plots need.

    Raises:
        ArtifactError: A field of the evaluation or of a run is missing or of another type.
    """
    expected: type[_Record] = _EnvironmentEvaluation if of_environment(evaluation) else _Evaluation
    try:
        expected.model_validate(dict(evaluation.config))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ArtifactError(
            f"{evaluation.path}: {where}: {first['msg'].lower()}: evaluate the policies again"
        ) from error
    return [Config(evaluation.path, run) for run in evaluation.config["runs"]]
