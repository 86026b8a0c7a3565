"""A model that is written to a file is read back as it was, and files are replaced whole."""

import copy
import json
import pickle
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import KINDS, OPERATORS

from kb import Expression, Model, ModelError, ModelFileError
from kb import elements as stated
from kb.elements import Rate

ODD = st.sampled_from(("'", '"', "\\", "\\n", "# no comment", "$x", "é", "\U0001f916"))
PRINTABLE = st.characters(exclude_categories=("C", "Z")) | st.just(" ")
TEXTS = st.text(PRINTABLE, max_size=8) | st.lists(ODD, max_size=3).map("".join)
NAMES = TEXTS.filter(str.strip)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
SPANS = st.just(0.0) | st.floats(0.0, 1e9)
TIMES = st.none() | st.floats(-1e10, 1e10)
SCALARS = (st.booleans(), st.integers(), FLOATS, TEXTS)
PARAMETERS = st.one_of(*SCALARS, *(st.lists(scalar, max_size=3) for scalar in SCALARS))
PRIORITIES = st.none() | st.integers(-(2**63), 2**63 - 1) | FLOATS
RESULTS = st.sampled_from((None, "completed", "failed", "abandoned"))
RATES = st.lists(st.builds(Rate, FLOATS, TEXTS, st.booleans()), max_size=2)


@st.composite
def odd_models(draw):
    """Any model that the builder makes, whatever things are called."""
    model = Model(draw(NAMES))

    def names(*needed):
        return draw(st.lists(NAMES, unique=True, max_size=3)) if all(needed) else []

    def some(table, most=3):
        return draw(st.lists(st.sampled_from(list(table)), max_size=most)) if table else []

    def choice(*options):
        return draw(st.sampled_from(options))

    for name in names():
        choice(model.quality_attribute, model.environmental_attribute)(
            name,
            max_age=draw(st.just(float("inf")) | st.floats(0.001, 1e9)),
            when_stale=choice("not evaluated", "violated"),
            agreement=choice((1, 1), (2, 3), (5, 5)),
            forecasting=choice("", "constant", "trend"),
            unit=draw(TEXTS),
            rates=draw(RATES),
        )
    for name in names():
        model.component(
            name,
            kind=choice("plain", "process", "ros_node", "lifecycle"),
            always_improve=draw(st.booleans()),
            package=draw(TEXTS),
        )
    for name in names(model.components):
        values = draw(st.dictionaries(TEXTS, PARAMETERS, max_size=3))
        component = model.components[choice(*model.components)]
        component.configuration(name, values, priority=draw(PRIORITIES))
    for name in names():
        model.function(name, always_improve=draw(st.booleans()))
    for name in names(model.functions):
        function = model.functions[choice(*model.functions)]
        function.design(name, some(model.components), priority=draw(PRIORITIES))
    for name in names():
        restored = [model.components[name] for name in some(model.components)]
        model.action(name, requires=some(model.functions), restores=restored)
    causers = [*model.designs.values(), *model.components.values(), *model.configurations.values()]
    targets = [*model.actions.values(), *causers]
    for attribute in some(model.attributes) if targets else []:
        expression = Expression(attribute, choice(*OPERATORS), draw(FLOATS))
        steady = expression.steady(hysteresis=draw(SPANS), dwell=draw(SPANS))
        model.constrain([choice(*targets), *some(targets)], steady)
        for causer in some(causers, 1):
            sense = choice("positive", "negative", "absolute")
            model.add_estimation(causer, attribute, draw(FLOATS), sense)
    for fact in draw(st.permutations(list(odd_facts(draw, model, some)))):
        model.add_fact(fact)
    return model


def odd_facts(draw, model, some):
    """Yield facts about a model, of each kind that its elements allow."""
    for name in some(model.attributes):
        yield stated.MeasurementFact(name, draw(FLOATS), draw(TIMES), draw(st.booleans()))
    for name in some(model.components):
        yield stated.ActiveFact(name)
    for name in some(model.actions):
        weights = dict.fromkeys(some(model.attributes), draw(FLOATS)) or None
        yield stated.RequiredActionFact(name, weights, draw(TIMES), draw(TIMES), draw(RESULTS))
    tables = {
        "action": model.actions,
        "function": model.functions,
        "component": model.components,
        "design": model.designs,
        "configuration": model.configurations,
        "constraint": dict(enumerate(model.constraints)),
    }
    for kind, table in tables.items():
        for name in some(table, 1):
            yield stated.StatusFact(table[name], draw(st.sampled_from(KINDS[kind])))
            if kind in ("action", "function", "component"):
                yield stated.RequiredFact(table[name])
            if kind in ("design", "configuration"):
                yield stated.SelectedFact(table[name])


@given(model=odd_models())
@settings(max_examples=30)
def test_random_model_is_equal_after_json_and_copies(model):
    assert Model.from_plain(json.loads(json.dumps(model.plain()))) == model
    for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert other == model
    for component in model.components.values():
        twin = copy.deepcopy(component)
        assert twin is not component
        assert (twin.name, twin.model) == (component.name, model)


def test_save_leaves_nothing_but_the_file(tmp_path):
    for _ in range(2):
        Model("rover").save(tmp_path / "rover.owl")
    assert [path.name for path in tmp_path.iterdir()] == ["rover.owl"]


LOAD = Model.load
SAVE = Model("rover").save


@pytest.mark.parametrize(
    ("act", "name", "message"),
    [
        (SAVE, "rover.tql", r"saved as \.owl; TypeQL files are only read"),
        (SAVE, "folder.owl", "cannot be written"),
        (SAVE, "nowhere/rover.owl", "cannot be written: there is no such folder"),
        (SAVE, "rover.doc", r"ends in \.tql or \.owl, not in '\.doc'"),
        (LOAD, "rover.doc", r"ends in \.tql or \.owl, not in '\.doc'"),
        (LOAD, "rovr.owl", r"did you mean 'rover\.owl'"),
        (LOAD, "nowhere/rover.owl", "there is no such file"),
        (LOAD, "folder", "not in ''"),
        (LOAD, "folder.owl", "cannot be read.*directory"),
        (LOAD, "long" * 100 + ".tql", "cannot be read"),
        (LOAD, "nul\0.tql", "cannot be read"),
        (lambda _: Model.load([]), "", "not from none"),
    ],
)
def test_path_that_cannot_be_used_is_an_error(act, name, message, tmp_path):
    SAVE(tmp_path / "rover.owl")
    (tmp_path / "folder.owl").mkdir()
    with pytest.raises(ModelError, match=message):
        act(tmp_path / name)
    assert len(list(tmp_path.rglob("*"))) == 2


def test_wrong_encoding_is_an_error(tmp_path):
    path = tmp_path / "rover.tql"
    path.write_bytes("insert $a has name 'é';".encode("latin-1"))
    with pytest.raises(ModelFileError, match=r"UTF-8.*byte 0xe9 in position 20"):
        Model.load(path)


def test_byte_order_mark_and_line_ends_of_windows_are_read(tmp_path):
    path = tmp_path / "rover.tql"
    path.write_bytes("\ufeffinsert # c\r\n$a isa Action,\r\n  has action-name 'é';\r\n".encode())
    assert list(Model.load(path).actions) == ["é"]


def test_threads_that_save_one_file_leave_one_of_theirs(tmp_path):
    models = [Model(f"model {number}") for number in range(8)]
    threads = [threading.Thread(target=each.save, args=(tmp_path / "m.owl",)) for each in models]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert Model.load(tmp_path / "m.owl") in models
    assert len(list(tmp_path.iterdir())) == 1
