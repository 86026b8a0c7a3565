"""The ontology says what the model and the base say; rdflib and the naive twin are its judges."""

import json
from decimal import Decimal

import pytest
from clocks import Clock
from hypothesis import HealthCheck, Phase, given, settings
from kept import Life, robot
from models import Twins, stories
from test_files import odd_models

from kb import (
    InvalidValue,
    KnowledgeBase,
    KnowledgeBaseError,
    Model,
    ModelFileError,
    PriorityPlanner,
    UnknownName,
)
from kb.elements import StatusFact
from kb.ontology import ROSA, WORDS, owl_text
from kb.status import Status
from missions.engine.mission import MISSIONS, find_mission

rdflib = pytest.importorskip("rdflib")
RDFS = "http://www.w3.org/2000/01/rdf-schema#"
SLOW = settings(
    max_examples=8,
    suppress_health_check=[HealthCheck.too_slow],
    phases=set(Phase) - {Phase.explain, Phase.shrink},  # slow
)
CLASSES = {
    "action": "Action",
    "function": "Function",
    "design": "FunctionDesign",
    "component": "Component",
    "configuration": "ComponentConfiguration",
}


def named(kb, what):
    """Return kind, name and what is asked of all elements of the five kinds that have a status."""
    rows = []
    for kind, word in CLASSES.items():
        asked = kb.query(f"SELECT ?name ?what {{ ?x a :{word} ; :name ?name ; {what} }}")
        rows += [(kind, *row) for row in asked]
    return rows


# ---------------------------------------------------------------- files


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("owl")


@given(model=odd_models())
@SLOW
def test_random_model_is_equal_after_a_round_trip(model, folder):
    model.save(folder / "there.owl")
    assert Model.load(folder / "there.owl") == model


@pytest.mark.parametrize("name", MISSIONS)
def test_mission_is_read_by_others_in_declared_words(name):
    model = find_mission(name).model()
    text = owl_text(model)
    assert owl_text(model) == text
    graph = rdflib.Graph().parse(data=text, format="xml")
    declared = set(graph.subjects(rdflib.RDF.type))
    used = {word for triple in graph for word in triple if str(word).startswith(ROSA)}
    assert used <= declared
    assert {str(word).removeprefix(ROSA) for word in declared if ROSA in str(word)} == WORDS
    actions = graph.subjects(rdflib.RDF.type, rdflib.URIRef(f"{ROSA}Action"))
    assert {str(*graph.objects(action, rdflib.RDFS.label)) for action in actions} == set(
        model.actions
    )


def test_file_of_another_editor_is_read(tmp_path):
    (tmp_path / "edited.owl").write_text(
        f'''<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [ <!ENTITY rosa "{ROSA}" > ]>
<rdf:RDF xmlns="http://x/y#" xml:base="http://x/y" xmlns:rosa="{ROSA}"
  xmlns:owl="http://www.w3.org/2002/07/owl#" xmlns:rdfs="{RDFS}"
  xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <owl:Ontology rdf:about="http://x/y"><owl:imports rdf:resource="{ROSA[:-1]}"/></owl:Ontology>
  <rosa:FunctionDesign rdf:about="#d">
    <rosa:name>by camera</rosa:name>
    <rosa:realises rdf:resource="#f"/>
    <rosa:uses rdf:resource="#c2"/> <rosa:uses rdf:resource="#c1"/>
    <rosa:priority rdf:datatype="http://www.w3.org/2001/XMLSchema#int">2</rosa:priority>
    <rdfs:comment xml:lang="en">someone's note</rdfs:comment>
  </rosa:FunctionDesign>
  <owl:NamedIndividual rdf:about="#f">
    <rdf:type rdf:resource="&rosa;Function"/><rosa:name>see</rosa:name>
  </owl:NamedIndividual>
  <rosa:Component rdf:about="#c1"><rosa:name>camera</rosa:name></rosa:Component>
  <rosa:ProcessComponent rdf:about="#c2"><rosa:name xml:lang="en">driver</rosa:name>
  </rosa:ProcessComponent>
  <owl:Class rdf:about="#Other"/>
</rdf:RDF>'''
    )
    model = Model.load(tmp_path / "edited.owl")
    assert model.name == "edited"
    assert model.designs["by camera"].components == ("camera", "driver")
    assert model.designs["by camera"].priority == 2
    assert model.components["driver"].kind == "process"


def test_model_in_two_files_is_one_model(tmp_path):
    text = owl_text(find_mission("suave_extended").model())
    head, mark, individuals = text.partition("<owl:NamedIndividual ")
    first, *rest = (mark + individuals).split("\n\n")
    (tmp_path / "most.owl").write_text(head + "\n".join(rest))
    (tmp_path / "rest.owl").write_text(f"{head}{first}</rdf:RDF>")
    loaded = Model.load([tmp_path / "most.owl", tmp_path / "rest.owl"])
    assert loaded == find_mission("suave_extended").model()


HEAD = f'<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns="{ROSA}">'
NAMED = f'{HEAD}<Action rdf:about="http://x#a"><name>go</name>{{}}</Action></rdf:RDF>'
TYPE = f'<rdf:type rdf:resource="{ROSA}'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "nothing in it is described in the words"),
        (f"insert {ROSA}", "this is not RDF/XML: syntax error: line 1"),
        (f"{HEAD}\n<Action>\n</Function></rdf:RDF>", "not RDF/XML: mismatched tag: line 3"),
        (f"{HEAD}\n<odd:Action/></rdf:RDF>", "not RDF/XML: unbound prefix: line 2"),
        (NAMED.format('<position rdf:datatype="http://x#odd">0</position>'), "literal of datatype"),
        (NAMED.format("<priorty>1</priorty>"), "unknown word of ROSA 'priorty'; did you mean"),
        (NAMED.format('<requires rdf:resource="http://x#b"/>'), "unknown individual 'http"),
        (NAMED.replace("Action", "Acton"), "unknown word of ROSA 'Acton'"),
        (NAMED.replace("<name>go</name>", ""), "http://x#a: the action's name is"),
    ],
)
def test_file_that_is_no_model_is_an_error(text, message, tmp_path, capfd):
    path = tmp_path / "foreign.owl"
    path.write_text(text.replace("{}", ""))
    with pytest.raises(ModelFileError) as caught:
        Model.load(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")


# ---------------------------------------------------------------- what is known now


@given(story=stories(max_size=8))
@SLOW
def test_statuses_are_those_of_the_naive_twin(story):
    model, events = story
    twins = Twins(model)
    for number, event in enumerate(events):
        twins.happen(event)
        if number % 3 == 0:
            statuses = twins.statuses().items()
            expected = {(*key, str(status)) for key, status in statuses if key[0] in CLASSES}
            assert set(named(twins.kb, ":status ?what")) == expected
    twins.kb.close()


def test_history_can_be_asked():
    clock = Clock(0.0)
    kb = KnowledgeBase(robot(), clock=clock)
    for clock.now, light in ((1.0, 0.9), (2.0, 0.3), (3.0, 0.8)):
        kb.measure("light", light)
        kb.request_action("explore", {"energy": 2.0})
        kb.query("SELECT ?x { ?x a :Action }")
        if plan := PriorityPlanner().plan(kb):
            kb.finish_plan(plan, "failed" if light == 0.3 else "completed")
    clock.now = 4.0
    kb.cancel_action("explore", "completed", "enough")
    assert kb.query(
        'SELECT ?s ?e { ?p a :ReconfigurationPlan ; :result "failed" ; :start ?s ; :end ?e }'
    ) == [(2.0, 2.0)]
    selected = kb.query(
        'SELECT ?s ?e { ?c :name "day" . ?x a :Selection ; :about ?c ; :start ?s '
        "OPTIONAL { ?x :end ?e } } ORDER BY ?s"
    )
    assert selected == [(1.0, 2.0), (3.0, None)]
    (mean,) = kb.query(
        """SELECT (AVG(?v) AS ?mean) {
        ?r a :RequiredAction ; :about ?x ; :start ?s ; :end ?e . ?x a :Action ; :name "explore" .
        ?m a :Measurement ; :measures ?a ; :value ?v ; :time ?t . ?a :name "light"
        FILTER(?t >= ?s && ?t < ?e) }"""
    )
    assert mean[0] == pytest.approx((0.9 + 0.3 + 0.8) / 3)
    weights = "SELECT ?n ?w { ?r :hasPreference ?p . ?p :prefers ?a ; :weight ?w . ?a :name ?n }"
    assert kb.query(weights) == [("energy", 2.0)]
    assert kb.query("SELECT ?why { ?r a :RequiredAction ; :reason ?why }") == [("enough",)]


def test_model_that_changes_is_the_one_that_is_asked():
    model = robot()
    kb = KnowledgeBase(model, clock=Clock(1.0))
    names = "SELECT ?n { ?x a :Action ; :name ?n } ORDER BY ?n"
    assert kb.query(names) == [("explore",), ("rest",)]
    model.action("sing")
    assert kb.query(names) == [("explore",), ("rest",), ("sing",)]


def test_what_goes_on_is_told_though_its_events_are_forgotten(monkeypatch):
    monkeypatch.setattr("kb.records._MOST_EVENTS", 100)
    clock = Clock(1.0)
    kb = KnowledgeBase(robot(), clock=clock)
    kb.measure("light", 0.9)
    kb.request_action("explore")
    PriorityPlanner().plan(kb)
    attempt = kb.record_attempt(1, "camera", "configure", "day", {"exposure": 0.5})
    kb.finish_attempt(attempt, "completed")
    kb.component_active("camera", True)
    kb.component_failed("lidar", "dust")
    kb.assert_status("rest", "unfeasible", "holiday")
    kb.assert_required("see", True)
    clock.now = 2.0
    for _ in range(200):
        kb.component_failed("camera")
        kb.component_recovered("camera")
    kb.request_action("explore")
    about = "SELECT ?n { ?f a :%s ; :about ?x . ?x :name ?n FILTER NOT EXISTS { ?f :end ?e } }"
    for word, names in {
        "Failure": {"lidar"},
        "Activity": {"camera"},
        "Selection": {"by camera", "day"},
        "AssertedStatus": {"rest"},
        "AssertedRequirement": {"see"},
        "RequiredAction": {"explore"},
    }.items():
        assert {name for (name,) in kb.query(about % word)} == names, word
    given = "{ ?f a :ParametersInForce ; :hasParameter ?p . ?p :key ?k ; :parameterValue ?v }"
    assert kb.query(f"SELECT ?k ?v {given}") == [("exposure", "0.5")]


def test_world_begins_anew_with_the_newest(monkeypatch):
    monkeypatch.setattr("kb.ontology.HISTORY", 8)
    monkeypatch.setattr("kb.ontology.RECORDS", 3)
    clock = Clock(0.0)
    kb = KnowledgeBase(robot(), clock=clock)
    count = "SELECT (COUNT(?m) AS ?n) (MIN(?t) AS ?first) { ?m a :Measurement ; :time ?t }"
    for clock.now, held in ((1.0, (3, 1.0)), (2.0, (6, 1.0)), (3.0, (9, 1.0)), (4.0, (3, 4.0))):
        for load in range(4):
            kb.measure("load", load)
        assert kb.query(count) == [held]
    kb.component_failed("camera")
    failed = "SELECT ?t { ?e a :Event ; :subject 'camera' ; :text ?t }"
    assert kb.query(failed) == [("camera has failed",)]


def test_status_that_lapses_is_no_longer_answered():
    model = robot()
    model.add_fact(StatusFact(model.components["camera"], Status.FAILURE))
    clock = Clock(1.0)
    kb = KnowledgeBase(model, clock=clock)
    kb.assert_status("rest", "unfeasible", "holiday", until=2.0)
    status = "SELECT ?s { ?x a :Action ; :name 'rest' ; :status ?s }"
    assert kb.query(status) == [("unfeasible",)]
    clock.now = 3.0
    assert kb.query(status) == [("feasible",)]
    ends = "SELECT ?s ?e { ?a a :AssertedStatus ; :status ?s OPTIONAL { ?a :end ?e } }"
    assert set(kb.query(ends)) == {("unfeasible", 2.0), ("failure", None)}
    kb.component_recovered("camera")
    assert set(kb.query(ends)) == {("unfeasible", 2.0), ("failure", 3.0)}


def test_life_is_told_in_declared_words_without_contradiction(tmp_path):
    life = Life(tmp_path / "m.sqlite3", 4)
    for _ in zip(range(400), life.moves(), strict=False):
        life.kb.query("SELECT ?x { ?x a :Action }")
    graph = as_graph(life.kb)
    words = {one for triple in graph for one in triple if str(one).startswith(ROSA)}
    assert words <= set(graph.subjects(rdflib.RDF.type))
    told = life.kb.query("SELECT DISTINCT ?k { ?x a ?k . ?k rdfs:subClassOf+ :Fact }")
    assert {kind.removeprefix(ROSA) for (kind,) in told} >= {
        *("Measurement", "RequiredAction", "ReconfigurationPlan", "Attempt", "VetoAnswer"),
        *("ComponentProcess", "Activity", "Failure", "Selection", "AssertedStatus"),
        *("AssertedRequirement", "ParametersInForce"),
    }
    life.kb.close()


def test_objects_of_owlready2_are_brought_up_to_date():
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    rosa = kb.ontology.get_namespace(ROSA)
    (rest,) = [instance for instance in rosa.Action.instances() if instance.rosa_name == "rest"]
    assert rest.status == "feasible"
    kb.assert_status("rest", "unfeasible", "holiday")
    assert kb.ontology is not None
    assert rest.status == "unfeasible"


# ---------------------------------------------------------------- queries

QUESTIONS = [
    "SELECT ?n { ?x a :Component ; :name ?n FILTER NOT EXISTS { ?f a :Failure ; :about ?x } }",
    "SELECT ?n { ?x a :Component ; :name ?n FILTER EXISTS { ?f a :Failure ; :about ?x } }",
    "SELECT ?n { ?a a :Action ; :requires/:name ?n }",
    "SELECT ?n { ?a a :Action ; :requires/^:realises/:uses/:name ?n }",
    "SELECT ?n { ?a :requires|:uses ?b . ?b :name ?n }",
    "SELECT DISTINCT ?n { ?c rdfs:subClassOf* :Element . ?x a ?c ; :name ?n }",
    "SELECT ?c { ?c rdfs:subClassOf+ :Fact }",
    "SELECT ?n { { ?x a :Action } UNION { ?x a :Function } ?x :name ?n }",
    "SELECT ?n ?s { ?x :name ?n OPTIONAL { ?f a :Failure ; :about ?x ; :start ?s } }",
    "SELECT ?n (COUNT(?m) AS ?c) { ?m :measures ?a . ?a :name ?n } GROUP BY ?n"
    " HAVING (COUNT(?m) > 1)",
    "SELECT (SUM(?v) AS ?sum) (MIN(?v) AS ?least) (MAX(?v) AS ?most) { ?m :value ?v ; :time ?t }",
    'SELECT ?x { VALUES ?n { "explore" "rest" } ?x :name ?n }',
    "SELECT ?d { ?m a :Measurement ; :value ?v BIND(?v * 2 + 1 AS ?d) }",
    "SELECT ?n { ?x a :Component ; :name ?n FILTER(REGEX(?n, '^C', 'i')) }",
    "SELECT ?v { ?m a :Measurement ; :value ?v } ORDER BY DESC(?v) LIMIT 2 OFFSET 1",
    "SELECT ?s { ?f a :Failure ; :about [ :name 'camera' ] ; :start ?s }",
    "SELECT (IF(?v > 0.5, 'bright', 'dark') AS ?word) { ?m a :Measurement ; :value ?v }",
    "SELECT ?n ?required { ?x a :Action ; :name ?n ; :isRequired ?required }",
    "SELECT ?n ?v { ?m :measures ?x ; :value ?v ; :time ?t . ?x :name ?n"
    " FILTER NOT EXISTS { ?later :measures ?x ; :time ?u FILTER(?u > ?t) } }",
    "SELECT ?n { ?x a :Action ; :name ?n OPTIONAL { ?x :requires ?f } FILTER(!BOUND(?f)) }",
    "SELECT ?n { ?x a :Action ; rosa:name ?n FILTER(?n IN ('rest', 'z')) }",
    "SELECT ?n ?most { { SELECT ?a (MAX(?v) AS ?most) { ?m :measures ?a ; :value ?v } GROUP BY ?a }"
    " ?a :name ?n }",
]


def as_graph(kb):
    """Return all that a base tells, as another library holds it."""
    graph = rdflib.Graph()
    for triple in kb.query("SELECT ?s ?p ?o { ?s ?p ?o }"):
        terms = []
        for value in triple:
            is_iri = str(value).startswith(("http://", "_:"))
            terms.append(rdflib.URIRef(value) if is_iri else rdflib.Literal(value))
        graph.add(tuple(terms))
    return graph


def plain(term):
    value = term.toPython() if hasattr(term, "toPython") else term
    if isinstance(value, Decimal):
        return float(value)
    return value if value is None or isinstance(value, int | float) else str(value)


@pytest.fixture(scope="module")
def told():
    """A base that was told something, and all of it as another library holds it."""
    clock = Clock(0.0)
    kb = KnowledgeBase(robot(), clock=clock)
    for clock.now, light in ((1.0, 0.75), (2.0, 0.25), (3.0, 0.5)):
        kb.measure("light", light)
        kb.measure("energy", 1.0 - light)
        kb.request_action("explore")
    kb.component_failed("camera")
    return kb, as_graph(kb)


@pytest.mark.parametrize("question", QUESTIONS)
def test_answers_are_those_of_an_independent_engine(question, told):
    kb, graph = told
    rows = graph.query(question.replace("rosa:", ":"), initNs={"": ROSA, "rdfs": RDFS})
    expected = sorted((tuple(map(plain, row)) for row in rows), key=str)
    found = sorted(kb.query(question), key=str)
    assert expected
    assert found == expected
    kinds = [[type(value) for value in row] for row in expected]
    assert [[type(value) for value in row] for row in found] == kinds


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("what can it do?", InvalidValue, "cannot be answered"),
        ("SELECT ?x {\n?x a :Action ;", InvalidValue, "cannot be answered"),
        ("SELECT ?x { ?x a nope:Action }", InvalidValue, "nope"),
        ("SELECT ?x { ?x a :Acton }", UnknownName, "word of ROSA 'Acton'; did you mean 'Action'"),
        ("SELECT ?x { ?x :name ?n FILTER REGEX(?n, 'a') }", InvalidValue, "need flags"),
        ("SELECT ?x { SERVICE <http://x> { ?x a ?y } }", InvalidValue, "cannot be answered"),
        ("SELECT ?x { ?x a :Action MINUS { ?x :status 'a' } }", InvalidValue, "NOT EXISTS"),
        ("ASK { ?x a :Action }", InvalidValue, "ASK is not supported; SELECT instead"),
        ("CONSTRUCT { ?x a :Action } { ?x a :Action }", InvalidValue, "SELECT the subjects"),
        ("INSERT { ?x :name 'a' } WHERE { ?x a :Action }", InvalidValue, "INSERT is not"),
        ("# harmless\nDELETE WHERE { ?s ?p ?o }", InvalidValue, "DELETE is not"),
        ("DROP ALL", InvalidValue, "cannot be answered"),
        ("SELECT ?x {\n ?x a :Action } ; DROP ALL", InvalidValue, "cannot be answered"),
        ("SELECT ?x { ?x :name 'a''; DELETE FROM objs; --' }", InvalidValue, "cannot be answered"),
        ("DESCRIBE ?x { ?x a :Failure }", InvalidValue, "SELECT .property .value"),
    ],
)
def test_query_that_is_none_is_an_error(text, error, message):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    with pytest.raises(error, match=message):
        kb.query(text)


ODD = ("it's", 'say "hi"', "back\\slash", "''", "é", "x' OR '1'='1")


@pytest.mark.parametrize("name", [*ODD, "\\n", "?x", "#", "??1", ":x"])
def test_text_of_any_characters_is_found_as_it_is(name):
    model = Model("odd")
    for other in {*ODD, name}:
        model.action(other)
    kb = KnowledgeBase(model, clock=Clock(1.0))
    written = json.dumps(name)
    found = f"SELECT ?n {{ ?x a :Action ; :name {written} ; :name ?n }}"
    assert kb.query(found) == [(name,)]
    found = f"SELECT ?n {{ ?x a :Action ; :name ?n FILTER(?n = {written}) }}"
    assert kb.query(found) == [(name,)]


def test_query_without_end_is_stopped():
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    product = " ".join(f"?s{number} ?p{number} ?o{number} ." for number in range(6))
    with pytest.raises(KnowledgeBaseError, match=r"stopped after 0\.3 s"):
        kb.query(f"SELECT (COUNT(?s0) AS ?n) {{ {product} }}", timeout=0.3)
    kb.measure("load", 1.0)
    assert kb.query("SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }", timeout=1e300) == [(1,)]
