"""A model that is written as OWL is read back as it was, and others' readers understand what is written."""

import shutil
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from models import models
from test_files import odd_models

from kb import KnowledgeBase, Model, ModelError
from kb.files import ModelFileError
from kb.owl import (
    CLASSES,
    GENERAL,
    MODEL,
    PARAMETER,
    PREFERENCE,
    Ref,
    individuals,
    property_of,
)
from kb.owl.files import owl_text, plain_text
from kb.owl.queries import METAMODEL, ROSA
from missions.engine.mission import MISSIONS, find_mission
from missions.suave_extended.model import suave_extended_model

rdflib = pytest.importorskip("rdflib")

OWL = rdflib.OWL
WORDS = rdflib.Namespace(ROSA)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("owl")


def parsed(text):
    graph = rdflib.Graph()
    graph.parse(data=text, format="xml")
    return graph


@given(model=odd_models())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_model_is_the_same_after_a_way_through_owl_and_typeql(model, folder):
    model.save(folder / "there.owl")
    Model.load(folder / "there.owl").save(folder / "back.tql")
    Model.load(folder / "back.tql").save(folder / "again.owl")
    assert Model.load(folder / "again.owl") == model
    assert (folder / "again.owl").read_bytes() == (folder / "there.owl").read_bytes()


class Mode(StrEnum):
    QUIET = "quiet"


def test_parameters_that_are_special_numbers_and_texts_are_written_as_what_they_are_of(tmp_path):
    model = Model("rover")
    given = {
        "angle": np.float64(0.5),
        "angles": [np.float64(1.0), 2.0, 3],
        "mode": Mode.QUIET,
        "lamp": True,
    }
    model.component("camera").configuration("night", given)
    model.save(tmp_path / "saved.owl")
    model.save(tmp_path / "saved.tql")
    assert Model.load(tmp_path / "saved.owl") == model == Model.load(tmp_path / "saved.tql")
    types = KnowledgeBase(model).query(
        "SELECT ?key ?type { ?x :key ?key ; :parameterType ?type } ORDER BY ?key"
    )
    assert types == [
        ("angle", "double"),
        ("angles", "double_array"),
        ("lamp", "boolean"),
        ("mode", "string"),
    ]


TQL = Path(__file__).parent / "typeql_files"
MODELS = {
    **{name: find_mission(name).model for name in MISSIONS},
    **{
        one: partial(Model.load, TQL / f"{one}.tql")
        for one in ("underwater", "mobile_robot", "asserted")
    },
    "underwater, extended": partial(
        Model.load, [TQL / "underwater.tql", TQL / "underwater_extended.tql"]
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_every_model_there_is_goes_through_owl_and_typeql_and_is_understood_by_others(
    name, tmp_path
):
    model = MODELS[name]()
    model.save(tmp_path / "one.owl")
    model.save(tmp_path / "one.tql")
    Model.load(tmp_path / "one.owl").save(tmp_path / "two.tql")
    Model.load(tmp_path / "one.tql").save(tmp_path / "two.owl")
    for form in (".owl", ".tql"):
        assert Model.load(tmp_path / f"one{form}") == Model.load(tmp_path / f"two{form}") == model
    assert (tmp_path / "one.owl").read_bytes() == (tmp_path / "two.owl").read_bytes()
    graph = parsed((tmp_path / "one.owl").read_text())
    for kind, table in (
        ("Action", model.actions),
        ("Component", model.components),
        ("Attribute", model.attributes),
    ):
        found = {
            str(label)
            for one in graph.subjects(rdflib.RDF.type, WORDS[kind])
            for label in names_of(graph, one)
        }
        assert found == set(table)


def names_of(graph, one):
    """Return what a viewer such as Protege shows for an individual."""
    return list(graph.objects(one, rdflib.RDFS.label))


def test_every_file_of_typeql_is_among_the_models_that_are_tried():
    assert {one.stem for one in TQL.glob("*.tql")} == {*MODELS} - {
        *MISSIONS,
        "underwater, extended",
    } | {"underwater_extended"}


@given(model=odd_models())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_an_independent_reader_finds_the_exact_names_and_values_in_words_of_the_ontology(model):
    graph = parsed(owl_text(model))
    nothing_lacks(graph)
    for one in individuals(model):
        (subject,) = (
            each
            for each in graph.subjects(rdflib.RDF.type, WORDS[one.kind])
            if each.endswith(f"#{one.id}")
        )
        assert (subject, rdflib.RDF.type, OWL.NamedIndividual) in graph
        for name, values in one.values.items():
            read = set(graph.objects(subject, WORDS[name]))
            assert len(read) == len(set(values))
            for value in values:
                if isinstance(value, Ref):
                    assert any(each.endswith(f"#{value.id}") for each in read)
                elif isinstance(value, str):
                    assert {plain_text(str(each)) for each in read} == {value}
                else:
                    assert {each.toPython() for each in read} == {value}


def nothing_lacks(graph):
    """Assert that no individual is told of in words that the ontology lacks."""
    declared = {
        kind: set(graph.subjects(rdflib.RDF.type, kind)) for kind in (OWL.Class, OWL.ObjectProperty)
    }
    declared[OWL.DatatypeProperty] = set(graph.subjects(rdflib.RDF.type, OWL.DatatypeProperty))
    for subject in graph.subjects(rdflib.RDF.type, OWL.NamedIndividual):
        for _, predicate, value in graph.triples((subject, None, None)):
            if predicate == rdflib.RDF.type:
                assert value in declared[OWL.Class] or value == OWL.NamedIndividual
            elif isinstance(value, rdflib.Literal) and predicate != rdflib.RDFS.label:
                assert predicate in declared[OWL.DatatypeProperty]
                sort = value.datatype or rdflib.XSD.string  # as RDF has it
                (wanted,) = (*graph.objects(predicate, rdflib.RDFS.range), sort)[:1]
                assert sort == wanted
            elif predicate != rdflib.RDFS.label:
                assert predicate in declared[OWL.ObjectProperty]


def test_ontology_has_a_label_and_a_comment_for_everything_in_it():
    graph = parsed(METAMODEL.read_text(encoding="utf-8"))
    things = {
        one
        for kind in (OWL.Class, OWL.ObjectProperty, OWL.DatatypeProperty)
        for one in graph.subjects(rdflib.RDF.type, kind)
        if isinstance(one, rdflib.URIRef)
    }
    assert len(things) > 60
    for thing in things:
        assert len(list(graph.objects(thing, rdflib.RDFS.label))) == 1
        assert len(list(graph.objects(thing, rdflib.RDFS.comment))) == 1


def test_ontology_has_a_class_for_everything_in_a_model():
    graph = parsed(METAMODEL.read_text(encoding="utf-8"))
    for kind in (*CLASSES.values(), *GENERAL, MODEL, PARAMETER, PREFERENCE):
        assert (WORDS[kind], rdflib.RDF.type, OWL.Class) in graph
    for special, general in GENERAL.items():
        assert (WORDS[special], rdflib.RDFS.subClassOf, WORDS[general]) in graph
    assert property_of(type("X", (), {}), "max_age") == "maxAge"


def test_saved_file_is_one_ontology_that_imports_nothing():
    graph = parsed(owl_text(suave_extended_model()))
    (ontology,) = graph.subjects(rdflib.RDF.type, OWL.Ontology)
    assert str(ontology) == "http://rosa-taca/model/RobotModel.suave_extended"
    assert not list(graph.objects(None, OWL.imports))


@given(model=models())
@settings(max_examples=20)
def test_what_is_saved_twice_is_the_same_text(model):
    assert owl_text(model) == owl_text(model)


def test_names_that_differ_in_one_character_only_are_different_individuals(tmp_path):
    model = Model("odd.one")
    for name in (
        "a b",
        "a_b",
        "a.b",
        "a%20b",
        "a/b",
        "a#b",
        "a~b",
        "ab ",
        "A_B",
        "é",
        "e\u0301",
        "\x00",
        "\\u0000",
    ):
        model.action(name)
    model.save(tmp_path / "odd.owl")
    assert list(Model.load(tmp_path / "odd.owl").actions) == list(model.actions)


def test_file_as_an_editor_may_leave_it_is_read(tmp_path):
    (tmp_path / "edited.owl").write_text(
        f'''<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [ <!ENTITY rosa "{ROSA}" > ]>
<rdf:RDF xmlns="http://x/y#" xml:base="http://x/y" xmlns:rosa="{ROSA}"
  xmlns:owl="http://www.w3.org/2002/07/owl#" xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#"
  xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <owl:Ontology rdf:about="http://x/y"/>
  <rosa:FunctionDesign rdf:about="#d">
    <rosa:name>by camera</rosa:name>
    <rosa:realises rdf:resource="#f"/>
    <rosa:uses rdf:resource="#c2"/> <rosa:uses rdf:resource="#c1"/>
    <rosa:priority rdf:datatype="http://www.w3.org/2001/XMLSchema#int">2</rosa:priority>
    <rdfs:comment xml:lang="en">someone's note</rdfs:comment>
  </rosa:FunctionDesign>
  <owl:NamedIndividual rdf:about="#f"><rdf:type rdf:resource="&rosa;Function"/><rosa:name>see</rosa:name>
  </owl:NamedIndividual>
  <rosa:Component rdf:about="#c1"><rosa:name>camera</rosa:name></rosa:Component>
  <rosa:ProcessComponent rdf:about="#c2"><rosa:name xml:lang="en">driver</rosa:name></rosa:ProcessComponent>
  <owl:Class rdf:about="#Other"/>
</rdf:RDF>'''
    )
    model = Model.load(tmp_path / "edited.owl")
    assert model.name == "edited"
    assert model.designs["by camera"].components == ("camera", "driver")
    assert model.designs["by camera"].priority == 2
    assert model.components["driver"].kind == "process"


def test_model_may_be_spread_over_several_files(tmp_path):
    whole = suave_extended_model()
    text = owl_text(whole)
    head, _, individuals_text = text.partition("  <!-- the model -->")
    blocks = [
        one for one in individuals_text.split("\t</owl:NamedIndividual>\n") if "<owl:Named" in one
    ]
    for number in (0, 1):
        part = "".join(f"{one}\t</owl:NamedIndividual>\n" for one in blocks[number::2])
        (tmp_path / f"{number}.owl").write_text(f"{head}{part}</rdf:RDF>")
    assert Model.load([tmp_path / "0.owl", tmp_path / "1.owl"]) == whole


HEAD = f'<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns="{ROSA}">'
HALF = owl_text(Model("half")).partition("  <!-- data properties")[0]
NAMED = f'{HEAD}<Action rdf:about="http://x#a"><name>go</name>{{}}</Action></rdf:RDF>'


@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ("", "the file is empty", None),
        ("insert $a isa Action;", "this is not RDF/XML: syntax error", 1),
        (HALF, "this is not RDF/XML: no element found", HALF.count("\n") + 1),
        (f"{HEAD}\n<Action>\n</Function></rdf:RDF>", "this is not RDF/XML: mismatched tag", 3),
        ("<html><body/></html>", "this is not RDF/XML: XML namespaces are required", None),
        (METAMODEL.read_text(encoding="utf-8"), "nothing in it is described in the words", None),
        (
            NAMED.format('<priorty rdf:datatype="x">1</priorty>'),
            "http://x#a: unknown property of Action 'priorty'",
            None,
        ),
        (
            NAMED.format('<requires rdf:resource="http://x#b"/>'),
            "unknown Function 'http://x#b'",
            None,
        ),
        (NAMED.format("<name>went</name>"), "name has one value, not 2", None),
        (
            NAMED.replace("Action", "Acton").format(""),
            "unknown class 'Acton'; did you mean 'Action'",
            None,
        ),
        (NAMED.replace("<name>go</name>", "").format(""), "it has no name", None),
        (
            NAMED.replace("Action", "Attribute").format(""),
            "a QualityAttribute or an EnvironmentalAttribute",
            None,
        ),
        (
            NAMED.format(f'<rdf:type rdf:resource="{ROSA}Function"/>'),
            "is Action and Function; it can be only one",
            None,
        ),
    ],
)
def test_file_that_is_no_model_is_an_error_that_says_where(text, message, line, tmp_path, capfd):
    path = tmp_path / "foreign.owl"
    path.write_text(text)
    with pytest.raises(ModelFileError) as caught:
        Model.load(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    if line:
        assert caught.value.line == line
    assert capfd.readouterr() == ("", "")


def test_formats_are_not_mixed(tmp_path):
    model = Model("x")
    model.save(tmp_path / "a.owl")
    model.save(tmp_path / "b.tql")
    with pytest.raises(ModelError, match="all in one format"):
        Model.load([tmp_path / "a.owl", tmp_path / "b.tql"])


@pytest.mark.skipif(shutil.which("java") is None, reason="HermiT needs Java")
class TestReasoner:
    def test_a_model_with_the_ontology_that_is_in_its_file_is_consistent(self):
        from kb.owl.files import inconsistency

        assert inconsistency(owl_text(suave_extended_model())) is None

    @given(
        model=odd_models().filter(
            lambda model: model.actions and model.designs and model.configurations
        )
    )
    @settings(max_examples=1, suppress_health_check=[HealthCheck.filter_too_much])
    def test_odd_model_is_consistent(self, model):
        from kb.owl.files import inconsistency

        assert inconsistency(owl_text(model)) is None

    def test_contradiction_is_found(self):
        from kb.owl.files import inconsistency

        wrong = (
            f'<owl:NamedIndividual rdf:about="http://x#a"><rdf:type rdf:resource="{ROSA}Action"/>'
        )
        wrong += f'<rdf:type rdf:resource="{ROSA}Component"/></owl:NamedIndividual></rdf:RDF>'
        assert "inconsistent" in inconsistency(
            METAMODEL.read_text(encoding="utf-8").replace("</rdf:RDF>", wrong)
        )
