"""The error tree: what a caller may catch, and what every message must say.

::

    SetrlError                     anything wrong with what was given to setrl
    |-- InputError                 a file, a value or an argument is wrong
    |   |-- SpecificationError     a specification or plant file (has a line)
    |   |-- ExpressionError        the text of an expression (has a column)
    |   `-- PolicyError            an ONNX file
    `-- UsageError                 options that contradict each other

A message names what was required, what was received, where, and what to do. "Could not prove" is never an exception;
it is a verdict with a reason.
"""

from __future__ import annotations


class SetrlError(Exception):
    """Base of everything that wrong input can raise.

    Parameters
    ----------
    message : str
        What was required and what was received.
    where : str, optional
        File and place, for example ``nav.yaml:12``.
    remedy : str, optional
        What to do about it.
    """

    def __init__(self, message: str, *, where: str | None = None, remedy: str | None = None) -> None:
        self.message = message
        self.where = where
        self.remedy = remedy
        super().__init__(message)

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        remedy = f" ({self.remedy})" if self.remedy else ""
        return f"{place}{self.message}{remedy}"

    def at(self, where: str) -> SetrlError:
        """Return the same error with a location put in front of the one it has."""
        joined = f"{where}: {self.where}" if self.where else where
        return type(self)(self.message, where=joined, remedy=self.remedy)


class InputError(SetrlError):
    """A file, a value or an argument is wrong."""


class SpecificationError(InputError):
    """A specification or plant file is wrong; ``where`` is ``file:line``."""


class ExpressionError(InputError):
    """The text of an expression is not in the language; ``where`` names the column."""


class PolicyError(InputError):
    """An ONNX file cannot be used as a policy."""


class UsageError(SetrlError):
    """Options that contradict each other or are out of range."""
