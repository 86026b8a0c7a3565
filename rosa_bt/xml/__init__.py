"""Trees in the XML of BehaviorTree.CPP 4: reading them, with its semantics, and writing them."""

from rosa_bt.xml.reader import BehaviourRegistry, load_xml
from rosa_bt.xml.writer import NumberedTree, export_xml

__all__ = ["BehaviourRegistry", "NumberedTree", "export_xml", "load_xml"]
