"""What later stages read of the configuration in a file, with its types and bounds; anyone may have written the file.

A value that is missing is noticed by whoever needs it (`artifacts.schema.Config`); all other values are not read.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue

Text = Annotated[str, Field(max_length=1000)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Size = Annotated[int, Field(ge=1, lt=2**31)]


class EnvironmentConfiguration(BaseModel):
    """The Gymnasium environment that a learner lives in."""

    model_config = ConfigDict(strict=True, extra="forbid")

    name: Annotated[str, Field(min_length=1, max_length=1000)]
    kwargs: Annotated[dict[Text, JsonValue], Field(max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    control_steps: Annotated[int, Field(ge=1, le=1_000_000)]
    frames: Annotated[int, Field(ge=2, le=1_000_000)]
    size: Annotated[list[Size], Field(min_length=2, max_length=2)]
    crop: Annotated[list[Count], Field(min_length=4, max_length=4)] | None
    viewpoint: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None
    success: Text


class Configuration(BaseModel):
    """Values that every kind may have."""

    model_config = ConfigDict(strict=True, extra="allow")

    stage: Text = ""
    preset: Text = ""
    task: Text | None = None
    contexts: Text = ""
    vary: Text = ""
    context_seed: Annotated[int, Field(ge=-1, lt=2**128)] = -1
    environment: EnvironmentConfiguration | None = None


class LearnedConfiguration(Configuration):
    """An expert or a policy."""

    learner: Text = ""
    hidden: Size = 1
    observation_size: Size = 1
    action_size: Size = 1
    reward: Text = ""
    without: list[Text] = []
    layer: Text = ""
    weights: Text = ""
    ramp: Text = ""
    translation_metrics: dict[Text, float | None] = {}


class TranslatorConfiguration(Configuration):
    """A translator."""

    arch: Text = ""
    size: Annotated[list[Size], Field(min_length=2, max_length=2)] = [1, 1]
    demonstrations: Count = 0
    held_out_demonstrations: Count = 0
    steps: Count = 0
    without: list[Text] = []
    align: Text = ""
