"""Models in files: which format a file is in, by its suffix."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from kb.model import Model

__all__ = ["load_model", "save_model"]


def load_model(cls: "type[Model]", paths: str | Path | Iterable[str | Path], name: str | None) -> "Model":
    """Read a model from files; see `Model.load`."""
    raise NotImplementedError


def save_model(model: "Model", path: str | Path) -> None:
    """Write a model to a file; see `Model.save`."""
    raise NotImplementedError
