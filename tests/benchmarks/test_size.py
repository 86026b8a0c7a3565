"""What an event costs in a small robot and in a large one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from figures import shown, table

pytestmark = pytest.mark.benchmark

PATIENCE = 240
"""How long one size may take [s]: several times what it needs, so that what grows faster than the size is seen."""
SIZES = (100, 1_000, 10_000, 100_000, 1_000_000)
NAMES = {
    "measured": "measure across a threshold",
    "failed": "component failed, recovered",
    "active": "component active, inactive",
    "requested": "action cancelled, requested",
    "selected": "design unselected, selected",
    "plan": "selection and plan after a failure",
    "situation": "situation of two values, is_feasible",
    "explain": "explain",
    "is_feasible": "is_feasible",
}


def measured(size):
    program = Path(__file__).with_name("one_size.py")
    command = [sys.executable, str(program), str(size)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_event_consults_as_many_elements_in_a_robot_of_any_size(tables):
    found = {size: measured(size) for size in SIZES}
    tables["2"] = lambda: "\n".join([*written(found)])
    for size in SIZES:
        assert found[size]["visited"] == found[SIZES[0]]["visited"]


def written(found):
    head = ("elements", *(f"{size:,}" for size in found))
    yield table(
        "Building",
        head,
        [
            ("model", *(shown(one["model_s"]) for one in found.values())),
            ("model and knowledge base", *(shown(one["build_s"]) for one in found.values())),
            (
                "peak memory of the process [MB]",
                *(round(one["memory"] / 1e6) for one in found.values()),
            ),
        ],
    )
    yield table(
        "p50, and its ratio to that of 100 elements measured in turn with it",
        head,
        [
            (
                words,
                *(
                    f"{shown(one['p50'][name])} ({one['ratio'][name]:.2f})"
                    for one in found.values()
                ),
            )
            for name, words in NAMES.items()
        ],
    )
    yield table(
        "Elements consulted by one event, on average",
        head,
        [
            (NAMES[kind], *(f"{one['visited'][kind]:.3f}" for one in found.values()))
            for kind in found[SIZES[0]]["visited"]
        ],
    )
