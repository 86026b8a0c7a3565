"""What the store and the base took from here before; it goes when they take it from `kb.model`."""

from kb.model import Model, Serials

__all__ = ["Serials", "individuals", "plain_json"]


def individuals(model: Model) -> Model:
    return model


def plain_json(model: Model) -> list[object]:
    return model.plain()
