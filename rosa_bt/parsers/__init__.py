"""Trees in the XML of BehaviorTree.CPP 4: read with its semantics, and written."""

from rosa_bt.parsers.exceptions import ExportError, RegistryError, XmlError
from rosa_bt.parsers.loading import load_xml
from rosa_bt.parsers.ports import Port
from rosa_bt.parsers.registry import BehaviourRegistry
from rosa_bt.parsers.writing import export_xml

__all__ = ["BehaviourRegistry", "ExportError", "Port", "RegistryError", "XmlError", "export_xml", "load_xml"]
