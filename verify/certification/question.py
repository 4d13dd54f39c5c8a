"""One row's question, complete: it can be decided on another machine, from nothing but this."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from ...models.input_files import InputFiles
from ...specs.manifest import Search
from ..options import Options


@dataclass(frozen=True)
class Question:
    """A policy, a specification, a perturbation radius, and how much may be spent on the answer.

    Attributes
    ----------
    policy_name : str
        File name.
    policy : bytes
    inputs : InputFiles
        The specification and its plant.
    epsilon : Fraction or None
        Radius of the observation perturbation; None is the specification's own.
    search : Search or None
        Whether the certified radius is searched instead.
    options : dict of str
        Numerical options that differ from the defaults.
    timeout : float
        Seconds.
    spread : int
        Parts that a hard row is cut into; 1 is none.
    """

    policy_name: str
    policy: bytes
    inputs: InputFiles
    epsilon: Fraction | None
    search: Search | None
    options: dict[str, Any] = field(default_factory=dict)
    timeout: float = 300.0
    spread: int = 1

    def numerics(self, **changes: Any) -> Options:
        """Options of the engine."""
        return Options(**{**self.options, "timeout": self.timeout, **changes})

    @property
    def chosen(self) -> dict[str, Any]:
        """Options that differ from the defaults, for a report."""
        usual = asdict(Options())
        return {name: value for name, value in self.options.items() if usual[name] != value}

    @contextmanager
    def files(self) -> Iterator[tuple[str, str]]:
        """Unpack the files into a folder of their own, which is the current one meanwhile: paths of both, relative.

        Messages name files as the manifest does, not where they happen to lie. What a broken invariant leaves behind
        for its report is kept.
        """
        before = Path.cwd()
        with tempfile.TemporaryDirectory(prefix="setrl-") as name:
            folder = Path(name)
            specification = self.inputs.write(folder)
            policies = folder / ".policy"
            policies.mkdir()
            (policies / self.policy_name).write_bytes(self.policy)
            os.chdir(folder)
            try:
                yield f".policy/{self.policy_name}", str(specification.relative_to(folder))
            finally:
                os.chdir(before)
                for bundle in folder.glob("setrl-bug-*.zip"):
                    shutil.move(str(bundle), before / bundle.name)
