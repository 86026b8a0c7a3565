"""Queries in SPARQL see the model, all that was told and what follows from it, and change nothing."""

import pytest
from hypothesis import HealthCheck, given, settings
from kept import robot
from models import Clock, Twins, stories
from test_files import odd_models

from kb import InvalidValue, KnowledgeBase, KnowledgeBaseError, Model, PriorityPlanner, UnknownName

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


def statuses(kb):
    found = set()
    for kind, name in CLASSES.items():
        rows = kb.query(f"SELECT ?name ?status {{ ?x a :{name} ; :name ?name ; :status ?status }}")
        assert len(rows) == len(getattr(kb, f"{kind}s"))
        found |= {(kind, *row) for row in rows}
    return found


@given(story=stories(max_size=8))
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_inferred_statuses_are_those_of_the_base(story):
    model, events = story
    twins = Twins(model)
    for number, event in enumerate(events):
        twins.happen(event)
        if number % 3 == 0:
            told = {(kind, name, str(status)) for (kind, name), status in twins.statuses().items() if kind in CLASSES}
            assert statuses(twins.kb) == told


@given(model=odd_models())
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_names_are_exact(model):
    kb = KnowledgeBase(model, clock=Clock())
    for kind, name in CLASSES.items():
        rows = kb.query(f"SELECT ?name ?place {{ ?x a :{name} ; :name ?name ; :position ?place }}")
        assert [row[0] for row in sorted(rows, key=lambda row: row[1])] == list(getattr(kb, f"{kind}s"))


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
    failed = kb.query('SELECT ?s ?e { ?p a :ReconfigurationPlan ; :result "failed" ; :start ?s ; :end ?e }')
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
    assert kb.query("SELECT ?n ?w { ?r :hasPreference ?p . ?p :prefers ?a ; :weight ?w . ?a :name ?n }") == [
        ("energy", 2.0)
    ]
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
    before = kb.query("SELECT ?s ?p ?o { ?s ?p ?o }")
    with pytest.raises(InvalidValue, match="begins with SELECT"):
        kb.query(update)
    assert sorted(map(str, kb.query("SELECT ?s ?p ?o { ?s ?p ?o }"))) == sorted(map(str, before))


@pytest.mark.parametrize(
    "text", ["", "what can it do?", "SELECT", "SELECT ?x { ?x a", "SELECT ?x { ?x a nope:Action }"]
)
def test_what_is_no_query_is_an_error(text, base):
    with pytest.raises(InvalidValue):
        base(robot(), Clock(1.0)).query(text)


def test_misspelt_word_is_an_error_that_says_which_are_near(base):
    with pytest.raises(UnknownName, match="unknown word of ROSA 'Acton'; did you mean 'Action'"):
        base(robot(), Clock(1.0)).query("SELECT ?x { ?x a :Acton }")


def test_query_that_never_ends_is_stopped(base):
    kb = base(robot(), Clock(1.0))
    product = " ".join(f"?s{number} ?p{number} ?o{number} ." for number in range(6))
    with pytest.raises(KnowledgeBaseError, match=r"stopped after 0\.3 s"):
        kb.query(f"SELECT (COUNT(?s0) AS ?n) {{ {product} }}", timeout=0.3)
    with pytest.raises(KnowledgeBaseError, match=r"stopped after|more than \d+ rows"):
        kb.query(f"SELECT * {{ {product} }}", timeout=3.0)
    kb.measure("load", 1.0)
    assert kb.query("SELECT (COUNT(?m) AS ?n) { ?m a :Measurement }") == [(1,)]


@pytest.mark.parametrize("timeout", [0, -1.0, float("nan"), "long"])
def test_timeout_is_a_time(timeout):
    with pytest.raises(InvalidValue):
        KnowledgeBase(Model("x")).query("SELECT ?x { ?x a :Action }", timeout=timeout)


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
        assert kb.query("SELECT (COUNT(?f) AS ?n) { ?f a :Failure }", timeout=20.0) == [(expected,)]
        kb.component_failed("camera")
        kb.close()
