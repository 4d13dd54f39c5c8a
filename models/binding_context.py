"""What binding needs everywhere: the three parts that are joined, and messages that name the YAML's line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import NoReturn

from ..specs.errors import SpecificationError
from ..specs.specification import Bounds, Specification
from .closed_loop import Plant
from .plant import suggestion
from .policy import Policy


@dataclass(frozen=True)
class Context:
    """A specification with the plant and the policy it is bound to."""

    specification: Specification
    plant: Plant
    policy: Policy

    @property
    def observations(self) -> tuple[str, ...]:
        """Names of the observation's components."""
        observe = self.specification.controller.observe
        return tuple(observe) if observe is not None else self.plant.states

    def fail(self, key: str, message: str, remedy: str | None = None) -> NoReturn:
        """Raise a `SpecificationError` at the line of a dotted key."""
        raise SpecificationError(message, where=place_of(self.specification, key), remedy=remedy)

    def require_names(self, key: str, names: Iterable[str], known: Iterable[str], what: str) -> None:
        """Every name must be known; `what` is the singular of what they are."""
        known = tuple(known)
        for name in names:
            if name not in known:
                self.fail(f"{key}.{name}", f"{name} is no {what}", suggestion(name, known, f"the plant's {what}s"))

    def require_order(self, key: str, bounds: Bounds) -> None:
        """An interval must not be empty."""
        if not bounds.lower <= bounds.upper:
            self.fail(key, f"[{shown(bounds.lower)}, {shown(bounds.upper)}] is empty", "write the lower bound first")


def place_of(specification: Specification, key: str) -> str | None:
    """``file:line`` of a dotted key, or of the closest entry around it that has a line."""
    parts = key.split(".")
    for count in range(len(parts), 0, -1):
        line = specification.lines.get(".".join(parts[:count]), 0)
        if line:
            return f"{specification.source}:{line}" if specification.source else f"line {line}"
    return specification.source or None


def shown(number: Fraction) -> str:
    """A rational for a message: as a decimal where that is short."""
    short = f"{float(number):.12g}"
    return short if Fraction(short) == number else str(number)
