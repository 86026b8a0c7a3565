"""Runs the exact search in a process of its own: a task comes in pickled, the answer goes out as a line of numbers.

It is started as a program, with the folders of this package and of its part for planning, and imports of them only what
the search needs: the rest would take longer than most searches do.
"""

import pickle
import sys
from types import ModuleType


def main() -> None:
    """Read one task, search, write one answer."""
    for name, folder in zip(("rosa_pddl", "rosa_pddl.planning"), sys.argv[1:], strict=True):
        package = sys.modules[name] = ModuleType(name)
        package.__path__ = [folder]
    from rosa_pddl.planning.sas_search import found_in, least_uses

    task = pickle.load(sys.stdin.buffer)
    found = found_in(task)
    if found is None:
        print("least", *least_uses(task))
    else:
        print("plan", *(move.what for move in found.moves))


if __name__ == "__main__":
    main()
