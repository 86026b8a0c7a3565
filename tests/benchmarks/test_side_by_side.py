"""The calls of a knowledge base beside those of an earlier commit, at several sizes, in one run.

`BESIDE` names the commit (97772600 by default), `SIZES` the numbers of elements.
"""

import io
import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from figures import table

pytestmark = pytest.mark.benchmark(group="knowledge base")

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
BESIDE = os.environ.get("BESIDE", "97772600")
SIZES = tuple(map(int, os.environ.get("SIZES", "100,1000,10000").split(",")))
ROUNDS = 3


def one_side(checkout, size):
    path = os.pathsep.join((str(checkout), str(HERE)))
    command = [sys.executable, str(HERE / "one_side.py"), str(size)]
    run = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, check=True, text=True
    )
    return json.loads(run.stdout)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    folder = tmp_path_factory.mktemp("earlier")
    archive = subprocess.run(
        ["git", "-C", str(ROOT), "archive", BESIDE, "kb"], capture_output=True, check=True
    )
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize("size", SIZES)
def test_calls_beside_an_earlier_commit(size, earlier, tables):
    sides = {earlier: {}, ROOT: {}}
    for _ in range(ROUNDS):
        for checkout, best in sides.items():
            for title, microseconds in one_side(checkout, size).items():
                best[title] = min(microseconds, best.get(title, microseconds))
    then, now = sides.values()
    rows = [
        (title, f"{then[title]:.3g}", f"{now[title]:.3g}", f"{now[title] / then[title]:.2f}")
        for title in then
    ]
    head = ("call [us of processor time]", BESIDE, "now", "times")
    tables[f"calls at {size:6}"] = lambda: table(f"Calls at {size} elements", head, rows)
    assert then.keys() == now.keys()
