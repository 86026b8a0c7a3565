"""Models in files: which format a file is in, by its suffix; whole files are read and written, or none."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from kb.exceptions import DuplicateName, KnowledgeBaseError, ModelError, UnknownName

if TYPE_CHECKING:
    from kb.model import Model

__all__ = [
    "DuplicateInFile",
    "ModelFileError",
    "Place",
    "SUFFIXES",
    "load_model",
    "read_text",
    "save_model",
    "write_text",
]

MOST: Final = 256 << 20
"""The largest file that is read [bytes]."""
_MARK: Final = "\ufeff"
"""What some editors put before everything else."""


class ModelFileError(ModelError):
    """A file is not a model that can be read or written.

    Args:
        message: what stands there, and what was expected.
        file: as it was given.
        line: counted from 1; None where the file is wrong as a whole.
        column: counted from 1, in characters.
    """

    def __init__(self, message: str, file: str, line: int | None = None, column: int | None = None) -> None:
        self.file, self.line, self.column = file, line, column
        super().__init__(f"{file}: {message}" if line is None else f"{file}:{line}:{column}: {message}")


class DuplicateInFile(ModelFileError, DuplicateName):
    """A name is given twice within one kind of element."""


class Place(NamedTuple):
    """Where something is written."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"

    def error(self, message: str) -> ModelFileError:
        """Say what is wrong here."""
        return ModelFileError(message, *self)

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Give this place to whatever the model refuses."""
        try:
            yield
        except ModelFileError:
            raise
        except DuplicateName as error:
            raise DuplicateInFile(str(error), *self) from None
        except KnowledgeBaseError as error:
            raise self.error(str(error)) from None


def load_model(cls: "type[Model]", paths: str | Path | Iterable[str | Path], name: str | None) -> "Model":
    """Read a model from files; see `Model.load`."""
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not files:
        raise ModelError("no file is given to load a model from; give one path or several, in order")
    for file in files:
        if not _is_folder(file):
            _known_suffix(file)
    owl = [file for file in files if file.suffix.lower() == ".owl"]
    if owl and len(owl) < len(files):
        others = ", ".join(str(file) for file in files if file not in owl)
        raise ModelFileError(f"files of one model are all in one format; {others} is in another", str(owl[0]))
    if owl:
        from kb.owl import load_owl

        return load_owl(cls, files, name)
    from kb.typeql import load_typeql

    return load_typeql(cls, files, name)


def save_model(model: "Model", path: str | Path) -> None:
    """Write a model to a file; see `Model.save`."""
    file = Path(path)
    write_text(file, _WRITERS[_known_suffix(file)](model))


def read_text(file: Path) -> str:
    """Return what a file says."""
    try:
        if file.stat().st_size > MOST:
            raise ModelFileError(
                f"this is larger than {MOST >> 20} MB, more than any model; give it in parts", str(file)
            )
        content = file.read_bytes()
    except FileNotFoundError:
        raise ModelFileError(_missing(file), str(file)) from None
    except IsADirectoryError:
        raise ModelFileError("this is a folder; give the model file in it", str(file)) from None
    except (OSError, ValueError) as error:
        raise ModelFileError(f"the file cannot be read: {error}", str(file)) from None
    try:
        return content.decode("utf-8").removeprefix(_MARK)
    except UnicodeDecodeError as error:
        raise _undecodable(file, content, error.start) from None


def write_text(file: Path, text: str) -> None:
    """Replace a file in one step, so that nothing half-written is ever found there."""
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        part.replace(file)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        why = "there is no such folder" if isinstance(error, FileNotFoundError) else error.strerror
        raise ModelFileError(f"the file cannot be written: {why}", str(file)) from None


def _typeql(model: "Model") -> str:
    from kb.typeql import typeql_text

    return typeql_text(model)


def _owl(model: "Model") -> str:
    from kb.rdfxml import owl_text

    return owl_text(model)


_WRITERS: Final[Mapping[str, Callable[["Model"], str]]] = {".tql": _typeql, ".owl": _owl}

SUFFIXES: Final = tuple(_WRITERS)
"""Of the files that models can be in."""


def _is_folder(file: Path) -> bool:
    try:
        return file.is_dir()
    except (OSError, ValueError):
        return False


def _known_suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in _WRITERS:
        given = f"the suffix {file.suffix!r}" if file.suffix else "no suffix"
        raise ModelFileError(f"{given} says no format of models; there are {', '.join(_WRITERS)}", str(file))
    return suffix


def _missing(file: Path) -> str:
    beside = sorted(one.name for suffix in _WRITERS for one in file.parent.glob(f"*{suffix}"))
    if not beside:
        return "there is no such file, and no other model in that folder"
    return str(UnknownName("file", file.name, beside))


def _undecodable(file: Path, content: bytes, offset: int) -> ModelFileError:
    before = content[:offset]
    line = before.count(b"\n") + 1
    column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8").removeprefix(_MARK)) + 1
    likely = "UTF-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "Latin-1 or Windows-1252"
    return ModelFileError(
        f"byte {content[offset]:#04x} at offset {offset} is no UTF-8, which is expected; "
        f"the file may be {likely}: save it as UTF-8",
        str(file),
        line,
        column,
    )
