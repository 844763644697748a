"""Fields of configuration classes. Each field defines a command-line option: its default, help, bounds and effect.

Light imports only, so that `ifo --help` answers at once.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from artifacts.errors import UsageError

MOST = (1 << 63) - 1  # largest whole number of an option
ANY = object()  # stands for any value that is not empty, zero or off


@dataclass(frozen=True)
class Only:
    """Condition: the option has an effect only with certain values of another option (if empty: any nonempty value)."""

    other: str
    values: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Not:
    """Condition: the option has no effect if another option has, or (if it is repeatable) includes, a certain value."""

    other: str
    value: Any = ANY


Condition = Only | Not


def option(
    default: Any,
    text: str,
    choices: tuple[str, ...] = (),
    low: float | None = None,
    high: float | None = None,
    *,
    effect: tuple[Condition, ...] = (),
    off: Any = ANY,
    **more: Any,
) -> Any:
    """Return a dataclass field that is also a command-line option.

    Args:
        default: Default value.
        text: Help text.
        choices: Allowed values; empty: any.
        low: Lower bound.
        high: Upper bound.
        effect: Conditions under which the option has an effect. If they are not met, a given option is refused.
        off: The value that switches the option off, which is never refused for having no effect.
        more: Presentation on the command line: `names`, `metavar`, `complete`, `show`; and `tag`, the prefix (may be
            empty) under which a value other than the default becomes part of the default file name.
    """
    about = {"help": text, "choices": choices, "low": low, "high": high, "effect": effect, "off": off, **more}
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class Config:
    """Base of all configuration classes.

    Attributes:
        RUN_EFFECTS: Conditions under which options of the run, such as `device`, have an effect in this stage.
        VARIANT: The field whose values have their own defaults for other fields, such as the learner; empty: none.
    """

    RUN_EFFECTS: ClassVar[Mapping[str, tuple[Condition, ...]]] = {}
    VARIANT: ClassVar[str] = ""

    def validate(self, given: Collection[str] = ()) -> None:
        """Refuse values out of bounds, contradictory options, and given options that have no effect.

        Args:
            given: Names of the options that the user gave. Values from a preset or a task are never refused for having
                no effect.

        Raises:
            UsageError: One line that names the option and what to do.
        """
        for item in dataclasses.fields(self):
            if complaint := wrong_value(item, getattr(self, item.name)):
                raise UsageError(f"{shown(item.name, getattr(self, item.name))}: {complaint}")
        self.check_together()
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name in given and value != item.metadata.get("off", ANY):
                self._check_effect(shown(item.name, value), item.name, item.metadata.get("effect", ()))
        for name, conditions in self.RUN_EFFECTS.items():
            if name in given:
                self._check_effect(flag(name), name, conditions)

    def check_together(self) -> None:
        """Refuse contradictory options, whatever their origin.

        Raises:
            UsageError: Options contradict each other.
        """

    def _check_effect(self, own: str, name: str, conditions: tuple[Condition, ...]) -> None:
        for condition in conditions:
            value = getattr(self, condition.other)
            held = shown(condition.other, value)
            if isinstance(condition, Not):
                if _matches(value, condition.value):
                    held = held if condition.value is ANY else shown(condition.other, condition.value)
                    raise UsageError(f"{own} has no effect with {held}: leave one of the two out")
            elif not condition.values and not value:
                other = flag(condition.other)
                raise UsageError(
                    f"{own} has no effect without {other}: give {other} as well, or leave {flag(name)} out"
                )
            elif condition.values and value not in condition.values:
                offered = self._offered(condition.other)
                wanted = [str(one) for one in condition.values if not offered or one in offered]
                raise UsageError(
                    f"{own} has no effect with {held}: expected {flag(condition.other)} {one_of(wanted)}; "
                    f"otherwise leave {flag(name)} out"
                )

    def _offered(self, name: str) -> tuple[Any, ...]:
        return next(item.metadata.get("choices", ()) for item in dataclasses.fields(self) if item.name == name)


def _matches(value: Any, unwanted: Any) -> bool:
    if unwanted is ANY:
        return bool(value)
    return unwanted in value if isinstance(value, tuple) else value == unwanted


def wrong_value(item: dataclasses.Field[Any], value: Any) -> str:
    """Describe what is wrong with a field's value, in a text that begins with `expected`; empty: nothing."""
    about = item.metadata
    if isinstance(value, float) and not math.isfinite(value):
        return "expected a finite number"
    if isinstance(value, int) and not -MOST <= value <= MOST:
        return f"expected at most {MOST}"
    choices = about.get("choices") or ()
    values = value if isinstance(value, tuple) else (value,)
    if choices and value != item.default and any(one not in choices for one in values):
        return f"expected {one_of(choices)}"
    low, high = about.get("low"), about.get("high")
    if isinstance(value, int | float) and not isinstance(value, bool):
        if low is not None and high is not None and not low <= value <= high:
            return f"expected {low:g} to {high:g}"
        if low is not None and value < low:
            return f"expected {low:g} or more"
    return ""


def one_of(words: Collection[str]) -> str:
    """Join words as text: `a`, `a or b`, `a, b or c`."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else str(last)


def flag(name: str) -> str:
    """Return the command-line option of a field."""
    return f"--{name.replace('_', '-')}"


def shown(name: str, value: Any) -> str:
    """Return an option with its value, as a user would type it."""
    if isinstance(value, bool):
        return flag(name) if value else f"--no-{name.replace('_', '-')}"
    if isinstance(value, tuple):
        return " ".join(f"{flag(name)} {one}" for one in value) or flag(name)
    if isinstance(value, float):
        return f"{flag(name)} {value:g}"
    return f"{flag(name)} {value}" if value != "" else flag(name)
