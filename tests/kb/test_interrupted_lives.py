"""A life of a knowledge base in which any call may be interrupted at any instruction, beside its uninterrupted twin."""

import pytest
from interrupted_lives import Interrupted, spent


@pytest.mark.parametrize("seed", range(4))
def test_interrupted_life_is_that_of_a_twin_that_was_told_its_log(seed):
    life = Interrupted(seed)
    counts = spent(life, 120)
    assert counts["lies"] == 0, life.lies[0]
    assert counts["leaks"] == 0
    assert counts["interrupts"] > 20
    assert counts["in"] > 0 < counts["out"], "some were told, some were not"


def test_twin_finds_a_lie():
    life = Interrupted(0)
    spent(life, 10)
    life.twin.component_failed("camera", "nobody else knows")
    assert spent(life, 5)["lies"] > 0
