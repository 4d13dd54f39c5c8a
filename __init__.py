"""setrl: does a policy network keep a system within its specification?

Nothing is imported until it is asked for: ``import setrl`` costs a millisecond, ``setrl.verify`` loads the engine.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .models.onnx_reader import read_policy as read_policy
    from .models.plant import load_plant as load_plant
    from .specs.errors import SetrlError as SetrlError
    from .specs.reader import read_specification as read_specification
    from .verify.options import Options as Options
    from .verify.result import Result as Result
    from .verify.result import Verdict as Verdict
    from .verify.verifier import verify_radii as verify_radii

__version__ = "0.1.0"

# Public name -> the module that has it. Strings, so that neither Python nor
# the import contracts see an import here: the rooms below may read `__version__` without depending on the rooms above.
_PUBLIC = {
    "Options": "verify.options",
    "Result": "verify.result",
    "SetrlError": "specs.errors",
    "Verdict": "verify.result",
    "load_plant": "models.plant",
    "read_policy": "models.onnx_reader",
    "read_specification": "specs.reader",
    "verify_radii": "verify.verifier",
}
_ROOMS = ("models", "specs", "train", "verify")

__all__ = ["__version__", *_PUBLIC, *_ROOMS]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _ROOMS:
        return import_module(f".{name}", __name__)
    if name in _PUBLIC:
        value = getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
