"""Runs the exact search in a process of its own: a task comes in pickled, the answer goes out as JSON.

It is started as a program, and imports of this package only what the search needs: the rest would take longer than
most searches do.
"""

import json
import pickle
import sys
from pathlib import Path
from types import ModuleType


def main() -> None:
    """Read one task, search, write one answer."""
    for name, folder in (("rosa_pddl", Path(__file__).parents[1]), ("rosa_pddl.planning", Path(__file__).parent)):
        package = sys.modules[name] = ModuleType(name)
        package.__path__ = [str(folder)]
    from rosa_pddl.planning.sas_search import found_in, least_uses

    try:
        task = pickle.load(sys.stdin.buffer)
        found = found_in(task)
        answer = {"least": least_uses(task)} if found is None else {"plan": [move.what for move in found.moves]}
    except MemoryError:
        answer = {}
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
