"""Proof: a tree, the knowledge base and the manager, as they are, against everything that can happen."""

from missions.proof.properties import always, eventually, leads_to, never
from missions.proof.surroundings import Leaf
from missions.proof.verification import Proof, verify

__all__ = ["Leaf", "Proof", "always", "eventually", "leads_to", "never", "verify"]
