; A ground vehicle drives through a building; places, ways, modes and all numbers come from Python.
; Costs are whole thousandths; switching the mode and crossing a corridor are steps of their own.
(define (domain agv)
  (:requirements :typing :adl :durative-actions :numeric-fluents)

  (:types
    action       ; one object per ROSA action: to switch, and to cross each corridor
    place
    way          ; a corridor in one direction
    setup - object
    mode - setup
  )

  (:constants
    switch - action
    within - place                       ; where the robot is in a corridor
    now - setup                          ; how it is configured, if that is no mode
  )

  (:predicates
    (action_feasible ?a - action)        ; set from the knowledge base
    (switch_action ?a - action)
    (crosses ?a - action ?w - way)       ; which action crosses the corridor of a way
    (leads ?w - way ?from ?to - place)
    (at ?p - place)
    (configured ?s - setup)
    (possible ?w - way ?m - mode)        ; asked of the knowledge base for each question
  )

  (:functions
    (switching ?now - setup ?next - mode)
    (switching_energy ?now - setup ?next - mode)
    (crossing ?w - way ?m - mode)
    (crossing_energy ?w - way ?m - mode)
    (energy_used_mj)
    (energy_left_mj)
    (total-cost)
  )

  (:durative-action switch
    :parameters (?a - action ?now - setup ?next - mode)
    :duration (= ?duration 1)
    :condition (and
      (at start (configured ?now))
      (over all (switch_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (not (configured ?now)))
      (at end (configured ?next))
      (at end (increase (total-cost) (switching ?now ?next)))
      (at end (increase (energy_used_mj) (switching_energy ?now ?next)))
    )
  )

  (:durative-action cross
    :parameters (?a - action ?w - way ?from ?to - place ?m - mode)
    :duration (= ?duration 60)
    :condition (and
      (at start (at ?from))
      (at start (leads ?w ?from ?to))
      (at start (configured ?m))
      (over all (crosses ?a ?w))
      (over all (action_feasible ?a))
      (over all (possible ?w ?m))
    )
    :effect (and
      (at end (not (at ?from)))
      (at end (at ?to))
      (at end (increase (total-cost) (crossing ?w ?m)))
      (at end (increase (energy_used_mj) (crossing_energy ?w ?m)))
    )
  )
)
