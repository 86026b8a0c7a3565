(define (domain shelf)
  (:requirements :typing :adl :numeric-fluents)
  (:types action thing)
  (:predicates (action_feasible ?a - action) (fetch_action ?a - action) (fetched ?x - thing))
  (:functions (far ?x - thing) (total-cost))
  (:action fetch
    :parameters (?a - action ?x - thing)
    :precondition (and (fetch_action ?a) (action_feasible ?a))
    :effect (and (fetched ?x) (increase (total-cost) (far ?x)))))
