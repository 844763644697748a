"""Configuration of every stage: frozen, typed classes with bounds and units, which define the command-line options.

Light imports only, so that `ifo --help` answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass

from stages.config.demonstrations import DemosConfig as DemosConfig
from stages.config.demonstrations import ExportConfig as ExportConfig
from stages.config.demonstrations import ImportConfig as ImportConfig
from stages.config.fields import Config, option
from stages.config.learning import ExpertConfig as ExpertConfig
from stages.config.learning import LearnerConfig as LearnerConfig
from stages.config.learning import PolicyConfig as PolicyConfig
from stages.config.names import *  # noqa: F403 - the names that options choose from
from stages.config.translation import TranslateConfig as TranslateConfig
from stages.config.translation import TranslatorConfig as TranslatorConfig


@dataclass(frozen=True)
class EvaluateConfig(Config):
    """Configuration of the evaluation of learned policies."""

    episodes: int = option(100, "Episodes per policy with mean actions, and as many with sampled actions.", low=1)


STAGES: dict[str, type[Config]] = {
    "train-expert": ExpertConfig,
    "collect-demos": DemosConfig,
    "train-translator": TranslatorConfig,
    "translate": TranslateConfig,
    "learn-policy": PolicyConfig,
    "evaluate": EvaluateConfig,
}
