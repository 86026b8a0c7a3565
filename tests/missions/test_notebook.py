"""Models, bases, trees, plans and explanations show themselves in a notebook."""

from xml.etree import ElementTree

import pytest
from test_page import Rover

from kb import KnowledgeBase, Model

EVIL = "<script>alert('x')</script>"


def parsed(shown):
    """Return all texts of a piece of HTML, which has to be well formed."""
    return [
        text for text in ElementTree.fromstring(f"<div>{shown}</div>").itertext() if text.strip()
    ]


@pytest.fixture
def rover():
    rover = Rover()
    rover.kb.measure("light", 0.2)
    rover.kb.measure("energy", 0.1)
    rover.work(1.0)
    return rover


def test_model_shows_its_elements_with_what_is_declared_of_them(rover):
    texts = parsed(rover.kb.model._repr_html_())
    assert "model rover" in texts
    assert (
        texts.index("attribute") < texts.index("component configuration") < texts.index("action")
    )  # after what it refers to
    assert "component: camera; parameters: {'exposure_s': 0.2}; priority: 2" in texts


def test_knowledge_base_shows_statuses_and_values(rover):
    texts = parsed(rover.kb._repr_html_())
    assert texts[0] == "rover: 1 of 2 actions feasible, required: charge"
    assert texts[texts.index("explore") + 1] == "unfeasible"
    assert texts[texts.index("light") + 1] == "0.2"


def test_explanation_is_unfolded_down_to_the_facts_and_ends_with_what_would_help(rover):
    texts = parsed(rover.kb.explain("explore")._repr_html_())
    assert texts[0].startswith("explore is unfeasible because")
    assert any(text.startswith("energy 0.1 violates >= 0.2") for text in texts)
    assert texts[-1] == "it would be feasible with energy >= 0.2"


def test_names_are_text_and_nothing_else():
    model = Model(EVIL)
    component = model.component("camera")
    component.configuration("day", {"a": EVIL}, priority=1)
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    kb.component_failed("camera", EVIL)
    for one in (model, kb, kb.explain("camera")):
        assert "<script>" not in one._repr_html_()
        assert parsed(one._repr_html_())
