"""Every public name of specs, models and verify is documented, and its documentation matches its signature."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("numpydoc", reason="numpydoc is part of the extra `dev`")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from numpydoc.docscrape import NumpyDocString

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("specs", "models", "verify", "train", "commands")


def modules() -> list[str]:
    files = [file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    return [".".join(("setrl", *f.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__") for f in files]


def own_members(holder: ModuleType | type, module: str) -> Iterator[tuple[str, Any]]:
    for name, value in vars(holder).items():
        function = getattr(value, "__func__", value) if isinstance(value, classmethod | staticmethod) else value
        if isinstance(value, property):
            function = value.fget
        if not name.startswith("_") and (inspect.isfunction(function) or inspect.isclass(function)):
            if function.__module__ == module:
                yield name, function


def methods_of_protocols(value: type) -> set[str]:
    """Methods that the class owes to a protocol of ours: the protocol says what they do."""
    asked: set[str] = set()
    for module in modules():
        for _, protocol in own_members(importlib.import_module(module), module):
            if getattr(protocol, "_is_protocol", False):
                methods = {name for name, _ in own_members(protocol, module)}
                asked |= methods if all(hasattr(value, name) for name in methods) else set()
    return asked


def public(module: str) -> Iterator[tuple[str, Any, bool]]:
    """Name, object, and whether it needs a docstring of its own: a protocol's methods and overriding ones do not."""
    for name, value in own_members(importlib.import_module(module), module):
        yield name, value, True
        if inspect.isclass(value):
            documented_elsewhere = methods_of_protocols(value)
            for method, function in own_members(value, module):
                inherited = any(hasattr(base, method) for base in value.__mro__[1:])
                yield f"{name}.{method}", function, not inherited and method not in documented_elsewhere


def names_of(entries: list[Any]) -> list[str]:
    """Names of a numpydoc section; ``a, b : float`` documents two, ``*rest`` is called ``rest``."""
    return [name.strip().lstrip("*") for entry in entries for name in entry.name.split(",") if name.strip()]


def complaints(name: str, value: Any, needs: bool) -> Iterator[str]:
    text = value.__doc__
    if inspect.isclass(value) and dataclasses.is_dataclass(value) and text and text.startswith(f"{value.__name__}("):
        text = None  # written by dataclasses
    if not text or not text.strip():
        if needs:
            yield f"{name}: no docstring"
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            sections = NumpyDocString(inspect.cleandoc(text))
        except (ValueError, UserWarning) as error:
            yield f"{name}: {error}"
            return
    documented = names_of(sections["Parameters"])
    call = value.__init__ if inspect.isclass(value) else value
    signature = [parameter for parameter in inspect.signature(call).parameters if parameter not in ("self", "cls")]
    if documented and documented != [parameter for parameter in signature if parameter in documented]:
        yield f"{name}: documents {documented}, takes {signature}"
    if inspect.isclass(value):
        has = {*dir(value), *(f for base in value.__mro__ for f in getattr(base, "__annotations__", {}))}
        has |= set(re.findall(r"self\.(\w+)", inspect.getsource(value)))
        if unknown := [attribute for attribute in names_of(sections["Attributes"]) if attribute not in has]:
            yield f"{name}: documents {unknown}, which it does not have"


@pytest.mark.parametrize("module", modules())
def test_public_names_are_documented_as_they_are(module: str) -> None:
    found = [line for entry in public(module) for line in complaints(*entry)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("module", [*modules(), "setrl", "setrl.cli", "setrl.train"])
def test_a_module_says_what_it_is_for(module: str) -> None:
    assert (importlib.import_module(module).__doc__ or "").strip()


def _undocumented() -> None: ...


def _renamed(lower: float) -> None:
    """Do it.

    Parameters
    ----------
    upper : float
        The bound.
    """


def _misspelt(lower: float) -> None:
    """Do it.

    Arguments
    ---------
    lower : float
        The bound.
    """


@pytest.mark.parametrize("value", [_undocumented, _renamed, _misspelt])
def test_a_wrong_docstring_is_seen(value: Any) -> None:
    assert list(complaints(value.__name__, value, True))
