"""What can go wrong in the simulated sea; every error derives from `SuaveEnvError`."""

import difflib
from collections.abc import Iterable


class SuaveEnvError(Exception):
    """The base of every error that this package raises: it says what was given, what is allowed and what exists."""


def unknown_name(kind: str, name: object, known: Iterable[str]) -> SuaveEnvError:
    """Make the error for a name that does not exist; it lists the nearest known names, or all if none is near."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=3)
    hint = f"the nearest are {', '.join(near)}" if near else f"known are {', '.join(names) or 'none'}"
    return SuaveEnvError(f"there is no {kind} {name!r}; {hint}")
