"""Metacontrol: adaptation by an ontology of functions, their designs and objectives, as SUAVE comes with it."""

from missions.managers.metacontrol.manager import Metacontrol

__all__ = ["Metacontrol"]
