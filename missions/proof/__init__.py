"""Explore what tree, knowledge base and manager do, and check what must hold."""

from missions.proof.properties import always, eventually, leads_to, never
from missions.proof.setup import Leaf
from missions.proof.verification import Proof, verify

__all__ = ["Leaf", "Proof", "always", "eventually", "leads_to", "never", "verify"]
