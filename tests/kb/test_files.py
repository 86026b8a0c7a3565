"""A model that is written to a file is read back as it was, and files are replaced whole or not at all."""

import copy
import json
import os
import pickle
import threading
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import KINDS, OPERATORS

from kb import Model, ModelError
from kb.elements import Rate
from kb.facts import (
    ActiveFact,
    MeasurementFact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.files import ModelFileError

ODD = st.sampled_from(
    (
        "'",
        '"',
        "\\",
        "\\n",
        "\n",
        "\r\n",
        "# no comment",
        "a >= b",
        "$x",
        "; insert",
        "é",
        "\U0001f916",
    )
)
TEXTS = st.text(max_size=8) | st.lists(ODD, max_size=3).map("".join)
NAMES = TEXTS.filter(str.strip)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
TIMES = st.none() | st.floats(-1e10, 1e10) | st.integers(0, 2 * 10**12).map(lambda ms: ms / 1000)
SCALARS = (st.booleans(), st.integers(), FLOATS, TEXTS)
PARAMETERS = st.one_of(*SCALARS, *(st.lists(one, max_size=3) for one in SCALARS))
PRIORITIES = st.none() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
RESULTS = st.sampled_from((None, "completed", "failed", "abandoned"))


def some(draw, options, **limits):
    return draw(st.lists(st.sampled_from(list(options)), **limits)) if options else []


def unique(draw, most=3):
    return draw(st.lists(NAMES, unique=True, max_size=most))


@st.composite
def odd_models(draw):
    """Any model that the builder makes, whatever things are called."""
    model = Model(draw(NAMES))
    for name in unique(draw):
        declare = draw(st.sampled_from((model.quality_attribute, model.environmental_attribute)))
        age = draw(st.just(float("inf")) | st.floats(0.001, 1e9))
        declare(
            name,
            max_age=age,
            when_stale=draw(st.sampled_from(("not evaluated", "violated"))),
            agreement=draw(st.sampled_from(((1, 1), (2, 3), (5, 5)))),
            forecasting=draw(st.sampled_from(("", "constant", "trend"))),
            rates=[
                Rate(draw(FLOATS), draw(TEXTS), draw(st.booleans()))
                for _ in range(draw(st.integers(0, 2)))
            ],
        )
    for name in unique(draw):
        model.component(
            name,
            kind=draw(st.sampled_from(("plain", "process", "lifecycle"))),
            always_improve=draw(st.booleans()),
            stops_to_configure=draw(st.booleans()),
            package=draw(TEXTS),
            executable=draw(TEXTS),
        )
    for name in unique(draw) if model.components else []:
        values = draw(st.dictionaries(TEXTS, PARAMETERS, max_size=3))
        (component,) = some(draw, model.components, min_size=1, max_size=1)
        model.components[component].configuration(name, values, priority=draw(PRIORITIES))
    for name in unique(draw):
        model.function(name, always_improve=draw(st.booleans()))
    for name in unique(draw) if model.functions else []:
        (function,) = some(draw, model.functions, min_size=1, max_size=1)
        parts = some(draw, model.components, max_size=3)
        model.functions[function].design(name, parts, priority=draw(PRIORITIES))
    for name in unique(draw):
        model.action(name, requires=some(draw, model.functions, max_size=3))
    relate(draw, model)
    state(draw, model)
    return model


def relate(draw, model):
    causers = [*model.designs.values(), *model.components.values(), *model.configurations.values()]
    constrained = [*model.actions.values(), *causers]
    for _ in range(draw(st.integers(0, 3))):
        attributes = some(draw, model.attributes, min_size=1, max_size=1)
        targets = some(draw, constrained, min_size=1, max_size=4)
        if attributes and targets:
            attribute, value = model.attributes[attributes[0]], draw(FLOATS)
            compare = {
                ">=": attribute.__ge__,
                ">": attribute.__gt__,
                "<=": attribute.__le__,
                "<": attribute.__lt__,
            }
            bound = compare[draw(st.sampled_from(OPERATORS))](value)
            spans = st.just(0.0) | st.floats(0.0, 1e9)
            model.constrain(targets, bound.steady(hysteresis=draw(spans), dwell=draw(spans)))
        for causer in some(draw, causers, max_size=1) if attributes else []:
            model.add_estimation(
                causer,
                attributes[0],
                draw(FLOATS),
                draw(st.sampled_from(("positive", "negative", "absolute"))),
            )


def state(draw, model):
    makers = fact_makers(draw, model)
    for _ in range(draw(st.integers(0, 6)) if makers else 0):
        model.add_fact(draw(st.sampled_from(makers))())


def fact_makers(draw, model):
    pick = partial(_pick, draw)
    components, configurations = model.components, model.configurations
    makers = [
        lambda: PlanFact(
            tuple(some(draw, components, max_size=2)),
            tuple(some(draw, components, max_size=2)),
            tuple(some(draw, configurations, max_size=2)),
            draw(TIMES),
            draw(TIMES),
            draw(RESULTS),
        )
    ]
    if model.attributes:
        makers.append(
            lambda: MeasurementFact(
                pick(model.attributes), draw(FLOATS), draw(TIMES), draw(st.booleans())
            )
        )
    if components:
        makers.append(lambda: ActiveFact(pick(components)))
        makers.append(
            lambda: ProcessFact(
                pick(components), draw(st.integers(1, 2**63 - 1)), draw(TIMES), draw(TIMES)
            )
        )
    if model.actions:
        makers.append(
            lambda: RequiredActionFact(
                pick(model.actions),
                preference(draw, model),
                draw(TIMES),
                draw(TIMES),
                draw(RESULTS),
            )
        )
    tables = {
        "action": model.actions,
        "function": model.functions,
        "component": components,
        "design": model.designs,
        "configuration": configurations,
        "constraint": dict(enumerate(model.constraints)),
    }
    for kind, table in tables.items():
        if table:
            makers.append(lambda t=table, k=kind: StatusFact(t[pick(t)], pick(KINDS[k])))
            if kind in ("action", "function", "component"):
                makers.append(lambda t=table: RequiredFact(t[pick(t)]))
            if kind in ("design", "configuration"):
                makers.append(lambda t=table: SelectedFact(t[pick(t)]))
    return makers


def _pick(draw, options):
    return draw(st.sampled_from(list(options)))


def preference(draw, model):
    weights = FLOATS | st.integers(-5, 5)
    return draw(
        st.none()
        | st.fixed_dictionaries(dict.fromkeys(some(draw, model.attributes, max_size=2), weights))
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("models")


@given(model=odd_models())
def test_random_model_is_equal_after_plain_json(model):
    assert Model.from_plain(json.loads(json.dumps(model.plain()))) == model


@given(model=odd_models())
@settings(max_examples=10)
def test_random_model_is_pickled_and_copied(model):
    for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert other == model
    for component in model.components.values():
        twin = copy.deepcopy(component)
        assert twin is not component
        assert (twin.name, twin.model) == (component.name, model)


def test_typeql_is_only_read(tmp_path):
    with pytest.raises(ModelFileError, match=r"saved as \.owl; TypeQL files are only read"):
        Model("rover").save(tmp_path / "rover.tql")


def test_saving_leaves_nothing_but_the_file(tmp_path):
    Model("rover").save(tmp_path / "rover.owl")
    Model("rover").save(tmp_path / "rover.owl")
    assert [one.name for one in tmp_path.iterdir()] == ["rover.owl"]


def test_save_that_fails_leaves_nothing_half_written(tmp_path):
    path = tmp_path / "rover.owl"
    path.mkdir()
    with pytest.raises(ModelFileError, match="cannot be written"):
        Model("rover").save(path)
    assert [one.name for one in tmp_path.rglob("*")] == ["rover.owl"]


def test_save_into_a_folder_that_is_not_there_is_an_error(tmp_path):
    path = tmp_path / "nowhere" / "rover.owl"
    with pytest.raises(ModelFileError) as caught:
        Model("rover").save(path)
    assert str(caught.value) == f"{path}: the file cannot be written: there is no such folder"


def test_unknown_suffix_is_an_error_that_lists_the_formats(tmp_path):
    for act in (Model("rover").save, Model.load):
        with pytest.raises(ModelFileError, match=r"ends in \.tql or .*, this one in '\.doc'"):
            act(tmp_path / "rover.doc")


def test_missing_file_is_an_error_that_names_those_beside_it(tmp_path):
    Model("rover").save(tmp_path / "rover.owl")
    with pytest.raises(ModelFileError, match=r"did you mean 'rover\.owl'"):
        Model.load(tmp_path / "rovr.owl")
    with pytest.raises(ModelFileError, match="there is no such file"):
        Model.load(tmp_path / "nowhere" / "rover.owl")


def test_folder_is_no_model(tmp_path):
    with pytest.raises(ModelFileError, match=r"ends in \.tql or \.owl, this one without a suffix"):
        Model.load(tmp_path / "models")
    (tmp_path / "models.tql").mkdir()
    with pytest.raises(ModelFileError, match="this is a folder"):
        Model.load(tmp_path / "models.tql")


def test_no_file_at_all_is_an_error():
    with pytest.raises(ModelError, match="no file is given"):
        Model.load([])


@pytest.mark.parametrize("stem", ["long" * 100, "nul\0"])
def test_file_that_cannot_be_opened_is_an_error(tmp_path, stem):
    with pytest.raises(ModelFileError, match="cannot be read"):
        Model.load(tmp_path / f"{stem}.tql")


@pytest.mark.parametrize(
    ("content", "line", "column", "hint"),
    [
        (
            "insert\n$a isa Action, has action-name 'é';".encode("latin-1"),
            2,
            33,
            r"byte 0xe9 at offset 39.*Latin-1",
        ),
        ("insert".encode("utf-16"), 1, 1, "UTF-16"),
        (b"\xef\xbb\xbfinsert # \xff", 1, 10, "byte 0xff at offset 12"),
    ],
)
def test_wrong_encoding_is_an_error_with_its_place(tmp_path, content, line, column, hint):
    path = tmp_path / "rover.tql"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=hint) as caught:
        Model.load(path)
    assert (caught.value.file, caught.value.line, caught.value.column) == (str(path), line, column)


def test_byte_order_mark_and_line_ends_of_windows_are_read(tmp_path):
    path = tmp_path / "rover.tql"
    path.write_bytes("\ufeffinsert # c\r\n$a isa Action,\r\n  has action-name 'é';\r\n".encode())
    assert list(Model.load(path).actions) == ["é"]


def test_threads_that_save_one_file_leave_one_of_theirs(tmp_path):
    models = [Model(f"model {number}") for number in range(8)]
    path, diary = tmp_path / "m.owl", tmp_path / "diary"
    diary.write_text("dear")
    for name in (".m.owl.part", f".m.owl.{os.getpid()}.part"):
        (tmp_path / name).symlink_to(diary)
    failed = []

    def save(model):
        for _ in range(5):
            try:
                model.save(path)
            except ModelError as error:
                failed.append(error)

    threads = [threading.Thread(target=save, args=(model,)) for model in models]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert Model.load(path) in models
    assert diary.read_text() == "dear"
    assert len(list(tmp_path.iterdir())) == 4
