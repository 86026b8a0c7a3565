"""`rosa check --reason` has HermiT look for contradictions, and says so when there is no Java to run it with."""

import shutil

import pytest
from typer.testing import CliRunner

from kb import Model
from kb.ontology import ROSA
from missions.cli import app

needs_java = pytest.mark.skipif(shutil.which("java") is None, reason="HermiT needs Java")


def check(*arguments):
    return CliRunner().invoke(app, ["check", "--reason", *map(str, arguments)])


@pytest.fixture
def saved(tmp_path):
    model = Model("rover")
    model.action("explore", requires=[model.function("see")])
    model.functions["see"].design("by_camera", [model.component("camera")])
    model.save(tmp_path / "rover.owl")
    return tmp_path / "rover.owl"


@needs_java
def test_consistent_model_passes(saved):
    done = check(saved)
    assert "HermiT finds no contradiction" in done.output
    assert done.exit_code == 0


@needs_java
def test_model_that_is_not_in_owl_is_reasoned_about_too():
    arguments = ["check", "--reason", "--mission", "suave"]
    assert "no contradiction" in CliRunner().invoke(app, arguments).output


@needs_java
def test_contradiction_that_another_editor_left_fails(saved):
    wrong = f'<owl:Class rdf:about="{ROSA}Function"><rdfs:subClassOf rdf:resource="{ROSA}Component"/></owl:Class>'
    saved.write_text(saved.read_text().replace("</rdf:RDF>", f"{wrong}</rdf:RDF>"))
    done = check(saved)
    assert done.exit_code == 1
    assert "rover.owl: HermiT finds the ontology inconsistent" in " ".join(done.output.split())


def test_without_java_it_is_said_what_to_install(saved, monkeypatch):
    monkeypatch.setenv("PATH", str(saved.parent))
    done = check(saved)
    assert done.exit_code != 0
    assert "needs Java" in str(done.exception)
