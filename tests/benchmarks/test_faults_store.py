"""Faults of stores, many: processes killed under load, and files damaged in every way; the tests have a quick part.

KILLS=500 DAMAGES=1000 pytest -n 0 -m benchmark tests/benchmarks/test_faults_store.py
"""

import os
import sys
from pathlib import Path

import pytest
from figures import table

sys.path.append(str(Path(__file__).parents[1] / "kb"))
from store_faults import Damages, survives_a_kill

pytestmark = pytest.mark.benchmark(group="faults")

KILLS, DAMAGES = int(os.environ.get("KILLS", "500")), int(os.environ.get("DAMAGES", "1000"))


def test_many_kills(tmp_path, tables):
    for number in range(KILLS):
        folder = tmp_path / str(number)
        folder.mkdir()
        survives_a_kill(folder, number)
    tables["kills"] = lambda: table(
        "Kills", ("what", "how often"), [("killed under load, nothing is missing", KILLS)]
    )


def test_many_damages(tmp_path, tables):
    damages = Damages(tmp_path, 2, lives=6)
    for number in range(DAMAGES):
        damages.one(number)
    found = [(f"{how}: {answer}", count) for (how, answer), count in sorted(damages.kinds.items())]
    tables["damages"] = lambda: table(
        "Damaged stores, and what was answered", ("what", "how often"), found
    )
    assert sum(count for (how, _), count in damages.kinds.items() if how != "repair") == DAMAGES
