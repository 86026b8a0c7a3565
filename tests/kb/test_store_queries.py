"""Queries in SPARQL see the model, all that was told and what follows from it, and change nothing."""

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from kept import Life, robot
from models import Clock, Twins, stories
from test_files import odd_models

from kb import (
    InvalidValue,
    KnowledgeBase,
    KnowledgeBaseError,
    Memory,
    Model,
    PriorityPlanner,
    Status,
    UnknownName,
)
from kb.facts import StatusFact
from kb.owl import BASE
from kb.owl.files import inconsistency
from kb.owl.queries import METAMODEL, ROSA

CLASSES = {
    "action": "Action",
    "function": "Function",
    "design": "FunctionDesign",
    "component": "Component",
    "configuration": "ComponentConfiguration",
}


@pytest.fixture(params=["memory", "store"])
def base(request, tmp_path):
    def make(model, clock):
        store = tmp_path / "m.sqlite3" if request.param == "store" else None
        made.append(KnowledgeBase(model, clock=clock, store=store))
        return made[-1]

    made = []
    yield make
    for kb in made:
        kb.close()


def named(kb, what):
    """Return kind, name and what is asked of all elements of the five kinds that have a status."""
    every = " UNION ".join(
        f"{{ ?x a :{name} ; :name ?name ; {what} BIND('{kind}' AS ?kind) }}"
        for kind, name in CLASSES.items()
    )
    rows = kb.query(f"SELECT ?kind ?name ?what {{ {every} }}")
    assert len(rows) == sum(len(getattr(kb, f"{kind}s")) for kind in CLASSES)
    return rows


@given(story=stories(max_size=8))
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_inferred_statuses_are_those_of_the_base(story):
    model, events = story
    twins = Twins(model)
    for number, event in enumerate(events):
        twins.happen(event)
        if number % 3 == 0:
            told = {
                (kind, name, str(status))
                for (kind, name), status in twins.statuses().items()
                if kind in CLASSES
            }
            assert set(named(twins.kb, ":status ?what")) == told
    twins.kb.close()


def test_comments_in_a_query_are_passed_over(base):
    kb = base(robot(), Clock(0.0))
    query = "# which\nSELECT ?n { # of all }\n ?x a :Action ; :name ?n ; # INSERT\r\n :status 'feasible' } ORDER BY ?n#"
    assert kb.query(query) == [("explore",), ("rest",)]
    (row,) = kb.query("SELECT (COUNT(?x) AS ?n) { ?x a <http://www.w3.org/2002/07/owl#Class> }")
    assert row > (0,)


@given(model=odd_models())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_names_are_exact(model):
    kb = KnowledgeBase(model, clock=Clock())
    rows = sorted(named(kb, ":position ?what"), key=lambda row: row[2])
    for kind in CLASSES:
        assert [name for of, name, _ in rows if of == kind] == list(getattr(kb, f"{kind}s"))
    kb.close()


def test_history_can_be_asked(base):
    clock = Clock(0.0)
    kb = base(robot(), clock)
    for clock.now, light in ((1.0, 0.9), (2.0, 0.3), (3.0, 0.8)):
        kb.measure("light", light)
        kb.request_action("explore", {"energy": 2.0})
        if plan := PriorityPlanner().plan(kb):
            kb.finish_plan(plan, "failed" if light == 0.3 else "completed")
    clock.now = 4.0
    kb.cancel_action("explore", "completed", "enough")
    failed = kb.query(
        'SELECT ?s ?e { ?p a :ReconfigurationPlan ; :result "failed" ; :start ?s ; :end ?e }'
    )
    assert failed == [(2.0, 2.0)]
    selected = kb.query(
        'SELECT ?s ?e { ?c :name "day" . ?x a :Selection ; :about ?c ; :start ?s . OPTIONAL { ?x :end ?e } }'
    )
    assert sorted(selected, key=str) == [(1.0, 2.0), (3.0, None)]
    (mean,) = kb.query(
        """SELECT (AVG(?v) AS ?mean) {
        ?r a :RequiredAction ; :about ?x ; :start ?s ; :end ?e . ?x a :Action ; :name "explore" .
        ?m a :Measurement ; :measures ?a ; :value ?v ; :time ?t . ?a :name "light" . FILTER(?t >= ?s && ?t < ?e) }"""
    )
    assert mean[0] == pytest.approx((0.9 + 0.3 + 0.8) / 3)
    assert kb.query(
        "SELECT ?n ?w { ?r :hasPreference ?p . ?p :prefers ?a ; :weight ?w . ?a :name ?n }"
    ) == [("energy", 2.0)]
    assert kb.query("SELECT ?why { ?r a :RequiredAction ; :reason ?why }") == [("enough",)]


def test_history_goes_on_after_reopening(tmp_path):
    query = 'SELECT ?s { ?c :name "camera" . ?f a :Failure ; :about ?c ; :start ?s }'
    clock = Clock(1.0)
    for number in range(3):
        clock.now += 1.0
        kb = KnowledgeBase(robot(), clock=clock, store=tmp_path / "m.sqlite3")
        kb.component_failed("camera")
        kb.component_recovered("camera")
        assert len(kb.query(query)) == number + 1
        kb.close()


def test_stated_failure_has_ended_once_the_component_is_recovered(base):
    model = robot()
    model.add_fact(StatusFact(model.components["camera"], Status.FAILURE))
    kb = base(model, Clock(5.0))
    query = (
        "SELECT ?status ?end { ?a a :AssertedStatus ; :status ?status . OPTIONAL { ?a :end ?end } }"
    )
    assert kb.query(query) == [("failure", None)]
    kb.component_recovered("camera")
    assert kb.query(query) == [("failure", 5.0)]


def test_amended_model_is_the_one_that_is_asked(base):
    model = robot()
    kb = base(model, Clock(1.0))
    names = "SELECT ?n { ?x a :Action ; :name ?n }"
    assert sorted(kb.query(names)) == [("explore",), ("rest",)]
    model.remove(model.actions["rest"])
    model.action("sing")
    assert sorted(kb.query(names)) == [("explore",), ("sing",)]


def test_answer_is_renewed_when_something_is_told(base):
    kb = base(robot(), Clock(1.0))
    count = "SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }"
    for number in range(3):
        assert kb.query(count) == kb.query(count) == [(number,)]
        kb.measure("load", 1.0)


@pytest.mark.parametrize(
    "update",
    [
        "INSERT { ?x :name 'a' } WHERE { ?x a :Action }",
        "DELETE { ?x :name ?n } WHERE { ?x a :Action ; :name ?n }",
        "PREFIX x: <http://x#> INSERT DATA { x:a x:b x:c }",
        "# harmless\nDELETE WHERE { ?s ?p ?o }",
        "LOAD <http://x/y>",
        "DROP ALL",
        "WITH <http://x> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o }",
    ],
)
def test_query_that_would_change_something_is_refused(update, base):
    kb = base(robot(), Clock(1.0))
    everything = "SELECT ?s ?p ?o { ?s ?p ?o FILTER(!isBlank(?s) && !isBlank(?o)) }"
    before = kb.query(everything)
    with pytest.raises(InvalidValue, match="begins with SELECT"):
        kb.query(update)
    assert sorted(map(str, kb.query(everything))) == sorted(map(str, before))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "a query is a text in SPARQL, not None"),
        ("", "there is none"),
        ("PREFIX x: <http://x#>", "there is none"),
        ("what can it do?", "a query begins with SELECT, .*not with what"),
        ("SELECT", "line 1, column 7 of the query, after 'SELECT': the query ends too early"),
        (
            "SELECT ?x {\n?x a :Action ;",
            "line 2, column 15 of the query, after .*: the query ends too early",
        ),
        (
            "SELECT ?x {\n?x a :Action } }",
            "line 2, column 17 of the query, after .* } }': .* this cannot stand here",
        ),
        (
            "SELECT ?x { ?x a :Action FILTER(1 > 0] }",
            "line 1, column 41 of the query, after .*1 > 0\\] }': ",
        ),
        (
            "SELECT ?x { ?x :name 'explore }",
            "line 1, column 32 of the query, after .*: the query ends too early",
        ),
        (
            r"SELECT ?x { ?x :name 'a\c' }",
            "line 1, column 25 of the query, after .*: from .* this is not understood",
        ),
        (
            "SELECT ?x { ?x a nope:Action }",
            "column 29 of the query, after .* a nope:Action': Prefix not found",
        ),
        (
            "SELECT ?n (COUNT(?x) AS ?c) { ?x :name ?n }",
            "The SELECT contains a variable that is unbound",
        ),
        ("SELECT ?x {\n ?x a :Action } ; DROP ALL", "line 2, column .* of the query, after "),
        (
            "SELECT ?x { SERVICE <http://x> { ?x a :Component } }",
            "SERVICE is not supported; leave it out",
        ),
        ("SELECT ?x { ?x a :Action } # \ud800", "cannot be answered"),
    ],
)
def test_what_is_no_query_is_an_error_that_says_where(text, message, base):
    with pytest.raises(InvalidValue, match=message):
        base(robot(), Clock(1.0)).query(text)


def test_every_kind_of_question_is_answered(base):
    kb = base(robot(), Clock(1.0))
    assert kb.query("ASK { ?x a :Action }") == [(True,)]
    assert kb.query("ASK { ?x a :Failure }") == [(False,)]
    made = kb.query("CONSTRUCT { ?x :name ?n } WHERE { ?x a :Action ; :name ?n }")
    assert sorted(name for _, _, name in made) == ["explore", "rest"]
    assert {word for _, word, _ in made} == {f"{ROSA}name"}
    assert kb.query("DESCRIBE ?x { ?x a :Action }")
    own = "PREFIX : <http://x#> SELECT ?x { ?x a :Nothing }"
    assert kb.query(own) == []
    assert (
        kb.query("SELECT ?service { ?service a :Action # SERVICE\n; :name 'SERVICE :what' }") == []
    )


def awkward():
    return (
        "it's",
        'say "hi"',
        "back\\slash",
        "tab\tx",
        "new\nline",
        "''",
        "é",
        "x' OR '1'='1",
        "\\n",
        "?x",
        "#",
        "??1",
    )


@pytest.mark.parametrize("name", awkward())
def test_text_of_any_characters_is_found_as_it_is(name):
    model = Model("odd")
    for other in awkward():
        model.action(other)
    kb = KnowledgeBase(model, clock=Clock(1.0))
    written = json.dumps(name)
    assert kb.query(f"SELECT ?n {{ ?x a :Action ; :name {written} ; :name ?n }}") == [(name,)]
    assert kb.query(f"SELECT ?n {{ ?x a :Action ; :name ?n FILTER(?n = {written}) }}") == [(name,)]
    assert kb.query(f"SELECT ?n {{ ?x a :Action ; :name ?n FILTER(?n IN ({written}, 'z')) }}") == [
        (name,)
    ]
    others = kb.query(
        f"SELECT ?n {{ ?x a :Action ; :name ?n FILTER NOT EXISTS {{ ?x :name {written} }} }}"
    )
    assert sorted(others) == sorted((one,) for one in awkward() if one != name)
    kb.close()


QUESTIONS = [
    "SELECT ?n { ?x a :Component ; :name ?n FILTER NOT EXISTS { ?f a :Failure ; :about ?x } }",
    "SELECT ?n { ?x a :Component ; :name ?n FILTER EXISTS { ?f a :Failure ; :about ?x } }",
    "SELECT ?n { ?a a :Action ; :requires/:name ?n }",
    "SELECT ?n { ?a a :Action ; :requires/^:realises/:uses/:name ?n }",
    "SELECT ?n { ?a :requires|:uses ?b . ?b :name ?n }",
    "SELECT DISTINCT ?n { ?c rdfs:subClassOf* :Element . ?x a ?c ; :name ?n }",
    "SELECT ?c { ?c rdfs:subClassOf+ :Fact }",
    "SELECT ?n { { ?x a :Action } UNION { ?x a :Function } ?x :name ?n }",
    "SELECT ?n ?s { ?x a :Component ; :name ?n OPTIONAL { ?f a :Failure ; :about ?x ; :start ?s } } ORDER BY ?n",
    "SELECT ?n (COUNT(?m) AS ?c) { ?m :measures ?a . ?a :name ?n } GROUP BY ?n HAVING (COUNT(?m) > 1)",
    "SELECT ?n (COUNT(?m) AS ?c) { ?m :measures ?a . ?a :name ?n } GROUP BY ?n ORDER BY DESC(?c) ?n",
    "SELECT (SUM(?v) AS ?sum) (MIN(?v) AS ?least) (MAX(?v) AS ?most) { ?m a :Measurement ; :value ?v }",
    'SELECT ?x { VALUES ?n { "explore" "rest" } ?x :name ?n }',
    "SELECT ?d { ?m a :Measurement ; :value ?v BIND(?v * 2 + 1 AS ?d) }",
    "SELECT ?n { ?x a :Component ; :name ?n FILTER(REGEX(?n, '^C', 'i')) }",
    "SELECT ?n { ?x a :Component ; :name ?n FILTER REGEX(?n, 'a(m|z)') }",
    "SELECT (REPLACE(?n, 'a(.)', '<$1>') AS ?other) { ?x a :Component ; :name ?n }",
    "SELECT ?v { ?m a :Measurement ; :value ?v } ORDER BY DESC(?v) LIMIT 2 OFFSET 1",
    "SELECT ?s { ?f a :Failure ; :about [ :name 'camera' ] ; :start ?s }",
    "SELECT (IF(?v > 0.5, 'bright', 'dark') AS ?word) { ?m a :Measurement ; :value ?v }",
    "SELECT ?n ?required { ?x a :Action ; :name ?n ; :isRequired ?required }",
    "SELECT ?n ?v { ?m :measures ?x ; :value ?v ; :time ?t . ?x :name ?n"
    " FILTER NOT EXISTS { ?later :measures ?x ; :time ?u FILTER(?u > ?t) } }",
    "SELECT ?n (COUNT(?f) AS ?c) { ?x a :Action ; :name ?n OPTIONAL { ?x :requires ?f } } GROUP BY ?n",
    "SELECT ?n { ?x a :Action ; :name ?n OPTIONAL { ?x :requires ?f } FILTER(!BOUND(?f)) }",
    "SELECT ?n { ?x a :Component ; :name ?n MINUS { ?f a :Failure ; :about ?x } }",
    "SELECT ?n { ?x a :Action ; :name ?n } VALUES ?n { 'rest' 'sing' }",
    "SELECT ?n { ?x a :Action ; :name ?n FILTER(STRLEN(?n) > 0 && NOT EXISTS { ?x :requires ?f }) }",
    "SELECT ?n ?most { { SELECT ?a (MAX(?v) AS ?most) { ?m :measures ?a ; :value ?v } GROUP BY ?a } ?a :name ?n }",
    "SELECT ?n ?m { ?x a :Action ; :name ?n ; (:requires/^:realises/:uses)+/:name ?m }",
    "SELECT ?n { OPTIONAL { ?x a :Action ; :name ?n } }",
    "SELECT (COUNT(*) AS ?n) { ?x a :Action FILTER(?nowhere = 3) }",
]


def as_graph(kb):
    """Return all that a base tells, as another library holds it."""
    rdflib = pytest.importorskip("rdflib")
    graph = rdflib.Graph()
    for triple in kb.query("SELECT ?s ?p ?o { ?s ?p ?o }"):
        iris = (str(one).startswith(("http://", "_:")) for one in triple)
        graph.add(
            tuple(
                rdflib.URIRef(one) if iri else rdflib.Literal(one)
                for one, iri in zip(triple, iris, strict=True)
            )
        )
    return graph


def test_all_that_a_life_tells_is_in_the_words_of_the_ontology_and_contradicts_nothing(tmp_path):
    rdflib = pytest.importorskip("rdflib")
    life = Life(tmp_path / "m.sqlite3", 4)
    for _ in zip(range(400), life.moves(), strict=False):
        pass
    graph, kinds = as_graph(life.kb), set()
    declared = set(graph.subjects(rdflib.RDF.type))
    words = {one for triple in graph for one in triple if str(one).startswith(ROSA)}
    assert words <= declared
    for kind in life.kb.query("SELECT DISTINCT ?k { ?x a ?k . ?k rdfs:subClassOf+ :Fact }"):
        kinds.add(kind[0].removeprefix(ROSA))
    assert kinds == {
        *(
            "Measurement",
            "RequiredAction",
            "ReconfigurationPlan",
            "Attempt",
            "VetoAnswer",
            "ComponentProcess",
        ),
        *(
            "Activity",
            "Failure",
            "Selection",
            "AssertedStatus",
            "AssertedRequirement",
            "ParametersInForce",
        ),
    }
    if shutil.which("java"):
        told = rdflib.Graph().parse(data=METAMODEL.read_text(encoding="utf-8"), format="xml")
        for triple in graph:
            if triple[0].startswith(BASE):
                told.add(triple)
        assert inconsistency(told.serialize(format="xml")) is None
    life.kb.close()


@pytest.fixture(scope="module", params=["memory", "store"])
def told(request, tmp_path_factory):
    """A base that was told something, and all of it as another library holds it; nothing changes either."""
    clock = Clock(0.0)
    store = tmp_path_factory.mktemp("told") / "m.sqlite3" if request.param == "store" else None
    kb = KnowledgeBase(robot(), clock=clock, store=store)
    for clock.now, light in ((1.0, 0.75), (2.0, 0.25), (3.0, 0.5)):
        kb.measure("light", light)
        kb.measure("energy", 1.0 - light)
        kb.request_action("explore")
        kb.component_failed("camera")
        kb.component_recovered("camera")
    yield kb, as_graph(kb)
    kb.close()


@pytest.mark.parametrize("question", QUESTIONS)
def test_answers_are_those_of_an_independent_engine(question, told):
    kb, graph = told
    words = {"": ROSA, "rdfs": "http://www.w3.org/2000/01/rdf-schema#"}
    expected = sorted(
        (tuple(map(plain, row)) for row in graph.query(question, initNs=words)), key=str
    )
    found = sorted(kb.query(question), key=str)
    assert expected
    assert found == expected
    assert [[type(one) for one in row] for row in found] == [
        [type(one) for one in row] for row in expected
    ]


def plain(term):
    """Return what a query answers for a term of rdflib, whose arithmetic is in decimals."""
    if term is None or not hasattr(term, "toPython"):
        return term
    value = term.toPython()
    return (
        float(value)
        if isinstance(value, Decimal)
        else value
        if isinstance(value, int | float)
        else str(value)
    )


def test_query_cannot_change_what_is_asked_even_by_a_trick(base):
    kb = base(robot(), Clock(1.0))
    with pytest.raises(InvalidValue):
        kb.query("SELECT ?x { ?x :name 'a''; DELETE FROM objs; --' }")
    kb.query('SELECT ?x { ?x :name "a\'; DELETE FROM objs; --" }')
    assert sorted(kb.query("SELECT ?n { ?x a :Action ; :name ?n }")) == [("explore",), ("rest",)]


def test_misspelt_word_is_an_error_that_says_which_are_near(base):
    with pytest.raises(UnknownName, match="unknown word of ROSA 'Acton'; did you mean 'Action'"):
        base(robot(), Clock(1.0)).query("SELECT ?x { ?x a :Acton }")


def test_query_that_never_ends_is_stopped(base):
    kb = base(robot(), Clock(1.0))
    product = " ".join(f"?s{number} ?p{number} ?o{number} ." for number in range(6))
    with pytest.raises(KnowledgeBaseError, match=r"stopped after 0\.3 s"):
        kb.query(f"SELECT (COUNT(?s0) AS ?n) {{ {product} }}", timeout=0.3)
    with pytest.raises(KnowledgeBaseError, match=r"stopped after|more than \d+ rows"):
        kb.query(f"SELECT * {{ {product} }}", timeout=0.5)
    kb.measure("load", 1.0)
    assert kb.query("SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }") == [(1,)]


@pytest.mark.parametrize("timeout", [0, -1.0, float("nan"), "long"])
def test_timeout_is_a_time(timeout):
    with pytest.raises(InvalidValue):
        KnowledgeBase(Model("x")).query("SELECT ?x { ?x a :Action }", timeout=timeout)


def test_timeout_may_be_as_long_as_one_likes_and_an_answer_too():
    kb = KnowledgeBase(robot())
    assert kb.query("ASK { ?x a :Action }", timeout=1e300) == [(True,)]
    product = "SELECT ?s ?o { ?s ?p ?o . ?t ?q ?u } LIMIT 1234"
    assert len(kb.query(product)) == 1234


def test_two_bases_do_not_see_each_other():
    one, other = KnowledgeBase(robot()), KnowledgeBase(Model("other"))
    one.component_failed("camera")
    assert one.query("SELECT ?f { ?f a :Failure }")
    assert not other.query("SELECT ?x { ?x a :Action }")
    assert not other.query("SELECT ?f { ?f a :Failure }")


def test_a_store_is_asked_as_soon_as_it_is_opened(tmp_path):
    path = tmp_path / "m.sqlite3"
    for expected in (0, 1, 1):
        kb = KnowledgeBase(robot(), store=path)
        assert kb.query("SELECT (COUNT(?f) AS ?n) { ?f a :Failure }", timeout=120.0) == [
            (expected,)
        ]
        kb.component_failed("camera")
        kb.close()


def test_query_that_cannot_be_interrupted_is_stopped_and_nobody_waits_for_it():
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    count = "SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }"
    assert kb.query(count, timeout=120.0) == [(0,)]
    product = " ".join(f"?s{number} ?p{number} ?o{number} ." for number in range(6))
    endless = f"SELECT (COUNT(?s0) AS ?n) {{ {product} }}"
    done = threading.Event()
    told = []

    def tell():
        while not done.is_set():
            kb.measure("load", 1.0)
            told.append(done.wait(0.001))

    teller = threading.Thread(target=tell)
    teller.start()
    with pytest.raises(KnowledgeBaseError, match=r"stopped after 1 s"):
        kb.query(endless, timeout=1.0)
    done.set()
    teller.join()
    assert len(told) > 5  # it would be two at most if it waited
    assert kb.query(count, timeout=120.0) == [(len(told),)]


def test_large_world_is_stopped_while_it_is_built(tmp_path):
    model = Model("large")
    for number in range(1500):
        model.action(f"a{number}", requires=[model.function(f"f{number}")])
    model.component("camera")
    kb = KnowledgeBase(model, store=tmp_path / "m.sqlite3")
    actions = "SELECT (COUNT(?x) AS ?n) { ?x a :Action }"
    for number in range(3):
        with pytest.raises(KnowledgeBaseError, match=r"stopped after 0\.02 s"):
            kb.query(actions, timeout=0.02)
        kb.component_failed("camera", f"reason {number}")
        kb.component_recovered("camera")
    assert kb.query(actions, timeout=120.0) == [(1500,)]
    assert kb.query("SELECT (COUNT(?x) AS ?n) { ?x a :Failure ; :end ?e }", timeout=120.0) == [(3,)]
    kb.close()


def test_what_is_so_now_is_in_the_world_however_long_ago_it_was_told():
    clock = Clock(1.0)
    kb = KnowledgeBase(robot(), clock=clock, memory=Memory(events=100))
    kb.measure("light", 0.9)
    kb.request_action("explore")
    plan = PriorityPlanner().plan(kb)
    kb.component_configured("camera", {"exposure": 0.5})
    kb.component_active("camera", True)
    kb.component_failed("lidar", "dust")
    kb.assert_status("rest", "unfeasible", "holiday")
    kb.assert_required("see", True)
    clock.now = 2.0
    for _ in range(200):
        kb.component_failed("camera")
        kb.component_recovered("camera")
    events = list(kb.log.since(0, measurements=False))
    assert events[0].number > 10, "else nothing is forgotten, and this tries nothing"
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
        assert {name for (name,) in kb.query(about % word, timeout=120.0)} == names, word
    assert kb.query(
        "SELECT ?why { ?f a :Failure ; :reason ?why FILTER NOT EXISTS { ?f :end ?e } }"
    ) == [("dust",)]
    given = "SELECT ?k ?v { ?f a :ParametersInForce ; :hasParameter ?p . ?p :key ?k ; :parameterValue ?v }"
    assert kb.query(given) == [("exposure", "0.5")]
    assert kb.query(
        "SELECT ?s { ?p a :ReconfigurationPlan ; :start ?s FILTER NOT EXISTS { ?p :end ?e } }"
    ) == [(plan.start,)]
    assert kb.query("SELECT ?t { ?m :historyBegins ?t }") == [(2.0,)]


def answering_for(program):
    """Return the pids of the processes that answer queries of a program."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (folder / "cmdline").read_bytes().endswith(f"queries.py\0{program}\0".encode()):
                found.append(int(folder.name))
    return found


@pytest.fixture
def answering():
    """Give a function that returns the pids of those for this program, without those of other tests."""
    others = answering_for(os.getpid())
    return lambda: [one for one in answering_for(os.getpid()) if one not in others]


ENDLESS = (
    "SELECT (COUNT(?a) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l . ?m ?n ?o . ?p ?q ?r }"
)


def test_process_is_kept_with_its_world_until_something_is_told(base, answering):
    kb = base(robot(), Clock(1.0))
    count = "SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }"
    assert kb.query(count) == [(0,)]
    (first,) = answering()
    assert kb.query("ASK { ?x a :Action }") == [(True,)]
    with pytest.raises(UnknownName):
        kb.query("SELECT ?x { ?x a :Acton }")
    assert answering() == [first]
    kb.measure("load", 1.0)
    assert kb.query(count) == [(1,)]
    (second,) = answering()
    assert second != first
    os.kill(second, signal.SIGKILL)
    time.sleep(0.1)
    assert kb.query(count) == [(1,)]
    start = time.monotonic()
    with pytest.raises(KnowledgeBaseError, match="stopped after 2 s"):
        kb.query(ENDLESS, timeout=2.0)
    assert time.monotonic() - start < 3.0
    assert not answering()


def test_process_ends_with_its_base(answering):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    assert kb.query("ASK { ?x a :Action }") == [(True,)]
    kb.close()
    assert not answering()
    assert kb.query("ASK { ?x a :Action }") == [(True,)]  # nothing can be told any more, but asked
    assert not answering()
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    assert kb.query("ASK { ?x a :Action }") == [(True,)]
    assert answering()
    del kb
    gc.collect()
    assert not answering()


def test_no_process_is_kept_if_the_base_is_closed_while_it_answers(answering):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))

    class Kept(dict):
        def setdefault(self, *given):
            kb.close()  # as another thread may just then
            return super().setdefault(*given)

    kb._world._kept = Kept()
    assert kb.query("ASK { ?x a :Action }") == [(True,)]
    assert not answering()


@pytest.mark.parametrize("error", [TimeoutError, ConnectionError, EOFError])
def test_what_the_clock_raises_is_not_taken_for_trouble_of_the_process(error):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    kb.assert_status("rest", "unfeasible", "holiday", until=2.0)

    def raising():
        raise error("of the clock")

    kb._knowledge.clock = raising
    with pytest.raises(error, match="of the clock"):
        kb.query("ASK { ?x a :Action }")


def test_many_threads_may_ask_at_once(answering):
    kb = KnowledgeBase(robot(), clock=Clock(1.0))
    found = []

    def ask():
        for number in range(5):
            kb.measure("load", float(number))
            found.append(kb.query("ASK { ?m a :Measurement }", timeout=60.0))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert found == [[(True,)]] * 20
    kb.query("ASK { ?m a :Measurement }")
    assert len(answering()) == 1
    kb.close()
    assert not answering()


PROGRAM = """
import os, signal, sys, time
sys.path.insert(0, {folder!r})
from kept import robot
from kb import KnowledgeBase
kb = KnowledgeBase(robot())
assert kb.query("ASK {{ ?x a :Action }}") == [(True,)]
def interrupted():
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        kb.query({endless!r})
    except KeyboardInterrupt:
        assert kb.query("ASK {{ ?x a :Action }}") == [(True,)]
    else:
        raise AssertionError
def forked():
    if not (child := os.fork()):
        kb.component_failed("camera")
        os._exit(kb.query("ASK {{ ?f a :Failure }}") != [(True,)])
    assert os.waitpid(child, 0)[1] == 0
    assert kb.query("ASK {{ ?f a :Failure }}") == [(False,)]
def killed():
    if not os.fork():
        time.sleep(30.0)  # and holds on to all that is open
    print("killed", flush=True)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
    kb.query({endless!r})
{way}()
"""


@pytest.mark.parametrize("way", ["interrupted", "forked", "killed", "str"])
def test_nothing_is_left_behind_however_a_program_ends(way):
    program = PROGRAM.format(folder=str(Path(__file__).parent), endless=ENDLESS, way=way)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.DEVNULL, start_new_session=True
    ) as asking:
        try:
            assert asking.wait(60.0) == (-signal.SIGKILL if way == "killed" else 0)
            deadline = time.monotonic() + 10.0
            while left := answering_for(asking.pid):
                assert time.monotonic() < deadline, left
                time.sleep(0.05)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(asking.pid, signal.SIGKILL)


def test_no_event_is_missing_if_memory_forgets_it_while_the_store_is_read(tmp_path, monkeypatch):
    kb = KnowledgeBase(
        robot(), clock=Clock(1.0), store=tmp_path / "m.sqlite3", memory=Memory(events=100)
    )

    def fail(times):
        for number in range(times):
            kb.component_failed("camera")
            kb.component_recovered("camera")
            assert number % 20 or kb.flush(60.0)

    def events(*args, **kwargs):
        found = stored(*args, **kwargs)
        fail(80)
        return found

    stored = kb.store.events
    fail(300)
    assert kb.log.begins > 1, "else the store is not read"
    monkeypatch.setattr(kb.store, "events", events)
    assert kb.query("SELECT (COUNT(?f) AS ?n) { ?f a :Failure }", timeout=60.0) == [(300,)]
    kb.close()


def test_what_has_lapsed_meanwhile_is_not_answered():
    clock = Clock(1.0)
    kb = KnowledgeBase(robot(), clock=clock)
    kb.assert_status("rest", "unfeasible", "holiday", until=2.0)
    status = "SELECT ?s { ?x a :Action ; :name 'rest' ; :status ?s }"
    assert kb.query(status) == [("unfeasible",)]
    clock.now = 3.0
    assert kb.query(status) == [("feasible",)]
    assert kb.query("SELECT ?e { ?a a :AssertedStatus ; :end ?e }") == [(2.0,)]
    kb.close()


def test_what_a_model_states_later_is_not_answered():
    model = robot()
    model.add_fact(StatusFact(model.components["camera"], Status.FAILURE))
    kb = KnowledgeBase(model, clock=Clock(1.0))
    model.add_fact(StatusFact(model.components["lidar"], Status.FAILURE))
    named = "SELECT ?n { ?x a :AssertedStatus ; :about [ :name ?n ] }"
    assert kb.query(named) == [("camera",)]
    kb.close()
