"""A process is killed at any instant, and files are damaged in any way: nothing acknowledged is missed in silence."""

import os

import pytest
from store_faults import Damages, survives_a_kill

KILLS, DAMAGES = int(os.environ.get("KILLS", "5")), int(os.environ.get("DAMAGES", "40"))


@pytest.mark.parametrize("number", range(KILLS))
def test_all_that_was_acknowledged_is_there_after_a_kill(number, tmp_path):
    survives_a_kill(tmp_path, number)


def test_damaged_files_are_refused_or_nothing_is_missing(tmp_path):
    damages = Damages(tmp_path, 5, lives=2)
    for number in range(DAMAGES):
        damages.one(number)
    answered = {answer for _, answer in damages.kinds}
    assert "opened, nothing is missing" in answered
    assert "made" in answered
    assert any(one.startswith("refused: the store is damaged") for one in answered)
