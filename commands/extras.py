"""Optional parts of the installation, asked for before anything is read."""

from __future__ import annotations


def require_training() -> None:
    """The extra that only trainers need, before anything is read."""
    from importlib.util import find_spec

    from ..specs.errors import UsageError

    missing = [module for module in ("torch", "safetensors", "gymnasium", "tensorboard") if find_spec(module) is None]
    if missing:
        raise UsageError(
            f"training needs {', '.join(missing)}, which is not installed",
            where="train",
            remedy="install the extra: pip install 'setrl[train]'",
        )
