"""Trees in the XML of BehaviorTree.CPP 4: reading them, with its semantics, and writing them."""

from rosa_bt.xml import controls
from rosa_bt.xml.reader import load_xml
from rosa_bt.xml.registry import BehaviourRegistry
from rosa_bt.xml.writer import NumberedTree, export_xml

__all__ = ["BehaviourRegistry", "NumberedTree", "controls", "export_xml", "load_xml"]
